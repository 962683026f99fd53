"""Any program of the language: its machine is proved, it ends whatever the world answers, and no token is lost."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.verification.verify import verify
from tests.support.runs.commands import RUN
from tests.support.runs.direct import drive
from tests.support.runs.held_run import Unrest
from tests.support.yaml.chaos import Chaos, in_use
from tests.support.yaml.programs import DOMAIN, Json, as_yaml, only_plan, programs


def carry_out(text: str, seed: int, kind: type[Chaos | Unrest] = Chaos) -> None:
    plan = only_plan(text)
    machine = generate(plan.graph, plan.bindings, on_failure=plan.on_failure)
    verify(machine)
    world = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    knowledge = Layered(world, KnowledgeBase(variables=plan.variables))
    random = Random(seed)
    if random.random() < 0.3:
        world.sense({"at", "free"}, lag=0.5)
    run = Run(machine, knowledge, id=RUN, bindings=plan.bindings, asks=random.random() < 0.7)
    chaos = kind(run, knowledge, random)
    open_before: set[UUID] = set()
    was_pausing = False
    for _ in chaos.drive():
        for place, tokens in run.marking.items():
            most = machine.initial[place] if place in machine.resource_places else 1
            assert tokens <= most or place in machine.budget_places, f"{place} holds {tokens} tokens"
        used = in_use(chaos.requests)
        for name, count in used.items():
            assert count <= plan.graph.capacities.get(name, 1), f"{name} is used by {count} calls"
        assert {one for claim in run.resources.held for one in claim.names} >= used.keys()
        if isinstance(chaos, Unrest) and was_pausing and run.pausing:
            begun = set(run.open_requests) - open_before
            assert len(begun) <= chaos.has_stepped, "nothing starts during a pause but what a step lets leave"
        if run.paused:
            assert (run.resources.line, run.open_requests) == ((), ())
        open_before, was_pausing = set(run.open_requests), run.pausing is not None
    assert run.resources.line == ()
    assert {claim.request for claim in run.resources.held} <= chaos.requests.keys(), "only servers that may be at work keep any"
    ended = {place: tokens for place, tokens in run.marking.items() if place not in machine.record_places}
    result = run.result()
    assert ended == ({machine.goal_place: 1} if result.goal else {machine.failed_place: 1})
    assert all(run.marking[place] == machine.initial[place] for place in machine.resource_places)
    assert not run.open_requests
    assert not (result.goal and result.failures)
    assert result.reason


@pytest.mark.timeout(900)
@given(programs(), st.integers(0, 2**32), st.sampled_from([Chaos, Unrest]))
def test_any_program_is_proved_ends_and_loses_no_token_also_if_it_is_paused(text: str, seed: int, kind: type[Chaos | Unrest]) -> None:
    carry_out(text, seed, kind)


@pytest.mark.parametrize(
    "inner", ["[{arm: {}}, {arm: {}}]", "[{arm: {}}, [{plain: {}}, {while: {condition: true, actions: [{both: {}}], limit: 1}}]]"]
)
def test_steps_that_recover_at_the_same_time_take_turns_with_what_they_share(inner: str) -> None:
    chain = f"[{{concurrent_actions: {inner}}}, skip_action]"
    text = f"{DOMAIN}---\nplan: [{{plain: {{}}, recoveries: {{before: {{when: true, do: {chain}}}}}}}]"
    for seed in range(20):
        carry_out(text, seed)


# --- what programs without concurrency mean, in a few lines --------------------------------

COUNTING = """
actions:
  a: {}
  b: {}
  c: {}
  set: {type: kb_action, params: [operation]}
"""
NAMES = st.sampled_from(["x", "y"])
TERMS: st.SearchStrategy[Json] = st.one_of(st.integers(0, 3), st.builds(lambda name: {"LocalQuery": name}, NAMES))
SUMS: st.SearchStrategy[Json] = st.one_of(
    TERMS, st.builds(lambda op, a, b: {"Operation": [op, [a, b]]}, st.sampled_from(["add", "sub"]), TERMS, TERMS)
)
TESTS: st.SearchStrategy[Json] = st.recursive(
    st.builds(lambda op, a, b: {"Comparison": [op, [a, b]]}, st.sampled_from(["lt", "eq", "ge"]), SUMS, SUMS),
    lambda inner: st.one_of(
        st.builds(lambda one: {"not": one}, inner),
        st.builds(lambda word, parts: {word: parts}, st.sampled_from(["and", "or"]), st.lists(inner, max_size=3)),
    ),
    max_leaves=3,
)
BLOCKS: st.SearchStrategy[Json] = st.recursive(
    st.lists(
        st.one_of(
            st.sampled_from([{"a": {}}, {"b": {}}, {"c": {}}]),
            st.builds(lambda name, value: {"set": {"operation": {"LocalUpdate": [name, value]}}}, NAMES, SUMS),
        ),
        max_size=3,
    ),
    lambda inner: st.lists(
        st.one_of(
            inner,
            st.builds(lambda steps: {"sequence": steps}, inner),
            st.builds(lambda test, then, other: {"if": test, "then": then, "else": other}, TESTS, inner, inner),
            st.builds(
                lambda test, steps: {"while": {"condition": test, "actions": steps, "limit": 5}}, TESTS, inner.filter(lambda steps: steps)
            ),
        ),
        max_size=3,
    ),
    max_leaves=8,
)


@dataclass
class Interpreter:
    """Does what a program says, one step after the other. The mutable state is all fields."""

    variables: dict[str, int]
    done: list[str] = field(default_factory=list)

    def value(self, data: Json) -> int:
        match data:
            case {"LocalQuery": name}:
                return self.variables[name]
            case {"Operation": [operator, [left, right]]}:
                return self.value(left) + (self.value(right) if operator == "add" else -self.value(right))
            case _:
                return int(data)

    def holds(self, test: Json) -> bool:
        match test:
            case {"not": inner}:
                return not self.holds(inner)
            case {"and": parts}:
                return all(map(self.holds, parts))
            case {"or": parts}:
                return any(map(self.holds, parts))
            case {"Comparison": [operator, [left, right]]}:
                one, other = self.value(left), self.value(right)
                return {"lt": one < other, "eq": one == other, "ge": one >= other}[operator]
        raise AssertionError(test)

    def do(self, step: Json) -> bool:
        """Return whether it went well: only loops can fail, when they reach their limit."""
        match step:
            case list() | {"sequence": list()}:
                return all(map(self.do, step if isinstance(step, list) else step["sequence"]))
            case {"if": test, "then": then, "else": other}:
                return self.do(then if self.holds(test) else other)
            case {"while": {"condition": test, "actions": steps, "limit": limit}}:
                for _ in range(limit):
                    if not self.holds(test):
                        return True
                    if not self.do(steps):
                        return False
                return not self.holds(test)
            case {"set": {"operation": {"LocalUpdate": [name, value]}}}:
                self.variables[name] = self.value(value)
            case _:
                self.done += step
        return True


@given(BLOCKS, st.integers(0, 3), st.integers(0, 3))
def test_a_program_without_concurrency_does_what_it_says(steps: Json, x: int, y: int) -> None:
    plan = only_plan(f"{COUNTING}---\n{as_yaml({'initial_knowledge': {'x': x, 'y': y}, 'plan': steps})}")
    trace = drive(plan.graph, bindings=plan.bindings, variables=plan.variables)
    meant = Interpreter({"x": x, "y": y})
    assert trace.result.goal is meant.do(steps)
    assert trace.actions == meant.done
    assert trace.run.knowledge.local.variables() == meant.variables
