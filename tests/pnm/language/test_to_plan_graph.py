"""The orderings of a plan graph against what the nesting of its blocks says, read off the steps: all that hypothesis makes."""

from __future__ import annotations

import re
from itertools import count, product

from hypothesis import given, strategies as st

from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, Junction
from pnm.language.plan import HandWrittenPlan
from tests.support.runs.plan_graphs import closure
from tests.support.yaml.programs import Json, as_yaml, only_plan

# --- what comes before what in a step, as it stands in the file ----------------------------


def parts_of(step: Json) -> list[Json] | None:
    """The parts of a block that is done in sequence or at the same time; None for a call, a loop and a choice."""
    found: list[Json] | None = step.get("sequence", step.get("concurrent_actions"))
    return found


def size(step: Json) -> int:
    """How many steps of the same flow the step becomes."""
    parts = parts_of(step)
    return 1 if parts is None else sum(map(size, parts))


def earlier(block: Json) -> set[tuple[int, int]]:
    """Which parts of the block come before which: as it is said, and all that follows from it.

    In a sequence, a part of which nothing is said comes after all before it that come after none from there on, as it is said.
    """
    parts = parts_of(block) or []
    numbers = range(len(parts))
    said = closure({(int(one[1:]), number) for number, part in enumerate(parts) for one in part.get("after", ())})
    unsaid = [number for number in numbers if "after" not in parts[number] and "sequence" in block]
    usual = {(one, number) for number in unsaid for one in range(number) if not any((later, one) in said for later in numbers[number:])}
    return closure(said | usual)


def before(step: Json, start: int = 0) -> set[tuple[int, int]]:
    """Which steps come before which, numbered from `start` as they stand in the file."""
    parts = parts_of(step) or []
    starts = [start + sum(map(size, parts[:number])) for number in range(len(parts))]
    places = [range(first, first + size(part)) for first, part in zip(starts, parts, strict=True)]
    inside = [before(part, first) for first, part in zip(starts, parts, strict=True)]
    return set().union(*inside, *(product(places[one], places[two]) for one, two in earlier(step)))


def held(step: Json) -> list[Json]:
    """The only steps of the flows inside of loops and choices, outer ones first, in the order of the file."""
    match step:
        case {"while": {"actions": inner}}:
            own = inner
        case {"if": _, "then": then, "else": otherwise}:
            own = [*then, *otherwise]
        case _:
            return [inner for part in parts_of(step) or () for inner in held(part)]
    return [*own, *(inner for part in own for inner in held(part))]


# --- in the graph --------------------------------------------------------------------------


def plan_from(step: Json) -> HandWrittenPlan:
    """The plan of one step, whose calls are of actions with numbers in the order of the file."""
    numbers = count()
    text = re.sub("call", lambda _: f"a{next(numbers)}", as_yaml({"plan": [step]}))
    return only_plan(f"actions: {{{', '.join(f'a{number}: ' for number in range(next(numbers)))}}}\n{text}")


def in_flow(flow: Flow) -> set[tuple[int, int]]:
    """Which steps of the flow that are no junctions come before which, numbered as they stand."""
    numbers = {step.index: number for number, step in enumerate(flow.steps)}
    pairs = {(numbers[one.before.call], numbers[one.after.call]) for one in flow.orderings}
    real = [number for number, step in enumerate(flow.steps) if not isinstance(step, Junction)]
    return {(real.index(one), real.index(two)) for one, two in closure(pairs) if one in real and two in real}


# --- all steps -----------------------------------------------------------------------------

CALL: Json = {"call": {}}
TEST = {"Query": "x"}


@st.composite
def blocks(draw: st.DrawFn, parts: st.SearchStrategy[Json]) -> Json:
    """A block, half of them with an order of its own: any that has no cycle, whatever the order in the file."""
    length = draw(st.sampled_from((0, 1, 2, 2, 3, 3, 4)))
    inside = [dict(draw(parts)) for _ in range(length)]
    if draw(st.booleans()):
        ranks = draw(st.permutations(range(length)))
        for number, part in enumerate(inside):
            part["id"] = f"n{number}"
            if draw(st.booleans()):
                part["after"] = [f"n{one}" for one in range(length) if ranks[one] < ranks[number] and draw(st.booleans())]
    return {draw(st.sampled_from(("sequence", "concurrent_actions"))): inside}


STEPS: st.SearchStrategy[Json] = st.recursive(
    st.just(CALL),
    lambda parts: (
        blocks(parts)
        | st.builds(lambda part: {"while": {"condition": TEST, "actions": [{"sequence": [CALL, part]}]}}, parts)
        | st.builds(lambda then, otherwise: {"if": TEST, "then": [then], "else": [otherwise]}, parts, parts)
    ),
    max_leaves=20,
)


@given(STEPS)
def test_what_comes_before_what_is_what_the_nesting_says_and_is_said_once(step: Json) -> None:
    plan = plan_from(step)
    graph = plan.graph
    assert [call.action.name for call in graph.calls] == [f"a{number}" for number in range(len(graph.calls))]
    found = [graph.flow, *(one.flow for holder in graph.every_step if not isinstance(holder, ActionCall) for one in holder.held)]
    for flow, part in zip(found, [step, *held(step)], strict=True):
        assert sum(not isinstance(one, Junction) for one in flow.steps) == size(part)
        assert in_flow(flow) == before(part)
        assert len({(one.before.call, one.after.call) for one in flow.orderings}) == len(flow.orderings)
    assert generate(graph, plan.bindings).plan is graph


def test_wide_blocks_after_each_other_have_few_orderings() -> None:
    wide = {"concurrent_actions": [CALL] * 50}
    flow = plan_from({"sequence": [wide, wide, wide]}).graph.flow
    assert len(flow.orderings) == 200
    assert sum(isinstance(step, Junction) for step in flow.steps) == 2


def test_the_oracle_sees_what_is_ordered() -> None:
    """Guards the test above: an order that is said the other way round, through an empty part, is seen by both sides."""
    first, empty, last = (
        {**CALL, "id": "n0", "after": ["n1"]},
        {"sequence": [], "id": "n1", "after": ["n2"]},
        {**CALL, "id": "n2", "after": []},
    )
    assert before({"sequence": [first, empty, last]}) == {(1, 0)}
    assert in_flow(plan_from({"sequence": [first, empty, last]}).graph.flow) == {(1, 0)}
