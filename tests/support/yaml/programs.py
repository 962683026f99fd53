"""Programs of the language made by hypothesis, and a world that answers them as it likes."""

from __future__ import annotations

from functools import cache
from typing import Any

import yaml
from hypothesis import strategies as st

from pnm.language import HandWrittenPlan, parse_plans

Json = Any
"""What YAML is written from."""

DOMAIN = """
types: robot place
constants: r1 r2 - robot hall kitchen - place
predicates: ["(at ?r - robot ?p - place)", (powered), (free)]
actions:
  plain: {}
  given: {params: [x]}
  asked: {params: [y], ask: {y: "Which one?"}, retries: 1}
  checked: {preconditions: {Comparison: [eq, [{LocalQuery: v}, 1]]}}
  looked: {effects: {Exists: [Query: seen]}}
  moved:
    params: "?r - robot ?p - place"
    preconditions: {not: "(at ?r ?p)"}
    effects: ["(at ?r ?p)", {when: {condition: (powered), effects: [{not: (free)}]}}]
  lasting:
    duration: 3
    preconditions: {at_start: (free), over_all: (powered), at_end: {Query: v}}
    effects: {at_start: [{not: (free)}], at_end: [(free)]}
  arm: {resources: [arm]}
  both: {resources: [arm, leg], retries: 2}
  mended:
    recoveries:
      during: {aborted: [{arm: {}}, retry], lost: [{note: {operation: {RemoteUpdate: [v, 1]}}}, restart_plan]}
  note: {type: kb_action, params: [operation]}
"""
FREE = frozenset({"plain", "given", "asked", "checked", "looked", "moved", "lasting", "arm", "note"})
"""Actions without recoveries."""
COMMANDS = ("retry", "restart_action", "restart_plan", "skip_action", "fail", "replan")
OUTCOMES = ("aborted", "preempted", "rejected", "unavailable", "timed_out", "lost")

QUERIES = st.sampled_from([{one: name} for one in ("Query", "LocalQuery", "RemoteQuery", "PersonQuery") for name in ("v", "w")])
VALUES: st.SearchStrategy[Json] = st.one_of(st.sampled_from([0, 1, 2, "text", True, None, [1, 2]]), QUERIES)
CONDITIONS: st.SearchStrategy[Json] = st.recursive(
    st.one_of(
        st.sampled_from(["(powered)", "(free)", "(at r1 hall)", True]),
        QUERIES,
        st.builds(lambda query: {"Exists": [query]}, QUERIES),
        st.builds(lambda op, a, b: {"Comparison": [op, [a, b]]}, st.sampled_from(["eq", "ne", "<", ">="]), VALUES, VALUES),
    ),
    lambda inner: st.one_of(
        st.builds(lambda one: {"not": one}, inner),
        st.builds(lambda word, parts: {word: parts}, st.sampled_from(["and", "or"]), st.lists(inner, max_size=3)),
    ),
    max_leaves=3,
)
OPERATIONS: st.SearchStrategy[Json] = st.one_of(
    st.builds(
        lambda word, name, value: {word: [name, value]},
        st.sampled_from(["LocalUpdate", "RemoteUpdate", "Update", "PersonUpdate"]),
        st.sampled_from(["v", "w", "seen"]),
        st.one_of(VALUES, st.builds(lambda op, a, b: {"Operation": [op, [a, b]]}, st.sampled_from(["+", "mul"]), VALUES, VALUES)),
    ),
    QUERIES,
)
CALLS: st.SearchStrategy[Json] = st.one_of(
    st.sampled_from(
        [{name: {}} for name in ("plain", "asked", "checked", "looked", "lasting", "arm", "both", "mended", "given")]
        + [{"moved": {"r": "r1", "p": "kitchen"}}, {"moved": {"r": "r2", "p": "hall"}}]
    ),
    st.builds(lambda value: {"given": {"x": value}}, VALUES),
    st.builds(lambda operation: {"note": {"operation": operation}}, OPERATIONS),
)


@cache
@st.composite
def _recoveries(draw: st.DrawFn, depth: int) -> Json:
    def chain(commands: tuple[str, ...] = COMMANDS) -> Json:
        found = [*draw(st.lists(_program_steps(depth - 1), max_size=2)), draw(st.sampled_from(commands))]
        if draw(st.booleans()):
            return found
        return {"do": found, "times": draw(st.integers(1, 2))}

    found: Json = {}
    for check in draw(st.sets(st.sampled_from(["before", "after"]))):
        one = chain()
        found[check] = {**one, "when": draw(CONDITIONS)} if isinstance(one, dict) else one
    during = draw(st.sets(st.sampled_from(OUTCOMES), max_size=2))
    if during:
        again, any_end = ("retry", "restart_action", "restart_plan"), (*COMMANDS, "continue")
        listed = [one if isinstance(one, dict) else {"do": one} for one in (chain(again), chain(any_end))]
        found["during"] = {outcome: listed if draw(st.booleans()) else chain(any_end) for outcome in during}
    return found


@cache
@st.composite
def _call(draw: st.DrawFn, depth: int) -> Json:
    step = dict(draw(CALLS))
    if draw(st.integers(0, 3)) == 0 and depth > 0:
        step["recoveries"] = draw(_recoveries(depth))
    if draw(st.integers(0, 4)) == 0:
        step["resources"] = draw(st.lists(st.sampled_from(["arm", "leg", "eye"]), unique=True))
    if draw(st.integers(0, 4)) == 0:
        step["retries"] = draw(st.integers(0, 2))
    if draw(st.integers(0, 9)) == 0:
        step[draw(st.sampled_from(["release", "deadline"]))] = draw(st.sampled_from([0.0, 1.0, 30.0]))
    return step


@cache
@st.composite
def _list(draw: st.DrawFn, depth: int, least: int = 0) -> Json:
    """A list of steps, which may say themselves what they wait for."""
    steps = draw(st.lists(_program_steps(depth), min_size=least, max_size=3))
    if draw(st.integers(0, 3)) == 0:
        for number, step in enumerate(steps):
            if isinstance(step, dict):
                step["id"] = f"s{number}"
        known = [step["id"] for step in steps if isinstance(step, dict)]
        for number, step in enumerate(steps):
            if isinstance(step, dict) and draw(st.booleans()):
                earlier = [name for name in known if int(name[1:]) < number]
                step["after"] = draw(_waits(earlier, steps))
                if _is_free(step) and draw(st.booleans()):
                    step["end_after"] = [wait for wait in draw(_waits(earlier, steps)) if "delay" not in wait]
    return steps


def _waits(names: list[str], steps: list[Json]) -> st.SearchStrategy[Json]:
    """Some of the steps with these names: their ends, in time or later, or the starts of calls that may be waited for."""
    ends = [wait for name in names for wait in (name, {"end": name}, {"end": name, "delay": 0.5})]
    starts = [{"start": name} for name in names if _is_free(steps[int(name[1:])])]
    return st.lists(st.sampled_from([*ends, *starts]), max_size=2) if names else st.just([])


def _is_free(step: Json) -> bool:
    """Return whether this is a call without recoveries."""
    return not FREE.isdisjoint(step) and step.keys().isdisjoint({"recoveries"})


@cache
def _program_steps(depth: int) -> st.SearchStrategy[Json]:
    if depth <= 0:
        return _call(0)
    inner = depth - 1
    return st.one_of(
        _call(depth),
        _call(depth),
        st.builds(lambda steps: {"concurrent_actions": steps}, _list(inner)),
        st.builds(lambda steps: {"sequence": steps}, _list(inner)),
        _list(inner),
        st.builds(
            lambda condition, steps, limit: {"while": {"condition": condition, "actions": steps, "limit": limit}},
            CONDITIONS,
            _list(inner, 1),
            st.integers(1, 3),
        ),
        st.builds(lambda condition, then, other: {"if": condition, "then": then, "else": other}, CONDITIONS, _list(inner), _list(inner)),
    )


@st.composite
def programs(draw: st.DrawFn, depth: int = 3) -> str:
    """The text of a file with a domain and a plan."""
    plan = {
        "initial_knowledge": draw(st.dictionaries(st.sampled_from(["v", "w"]), st.integers(0, 2))),
        "facts": draw(st.lists(st.sampled_from(["(powered)", "(free)", "(at r1 hall)"]), unique=True)),
        "restarts": draw(st.integers(1, 2)),
        "on_failure": draw(st.sampled_from(["drain", "cancel", "continue_others"])),
        "resources": {"arm": draw(st.integers(1, 2))},
        "goal": draw(st.one_of(st.just(True), CONDITIONS)),
        "plan": draw(_list(depth)),
    }
    return f"{DOMAIN}---\n{as_yaml(plan)}"


def as_yaml(data: Json) -> str:
    """Return the data as YAML."""
    return yaml.dump(data, sort_keys=False, default_flow_style=False, Dumper=_Plain)


class _Plain(yaml.SafeDumper):
    """Writes no aliases: the file says everything where it stands."""

    def ignore_aliases(self, data: object) -> bool:
        return True


# --- a world that answers as it likes ------------------------------------------------------


def only_plan(text: str) -> HandWrittenPlan:
    """Read a text with one plan."""
    (plan,) = parse_plans(text).values()
    return plan
