"""Blocks of one shape share what is known of their transitions, and nothing is different for it: a run does what it does without blocks."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, strategies as st

from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Begin, Observer
from pnm.core.execution.machine_index import index_of
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import Rule
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.verification.verify import verify
from tests.support.benchmarks.workloads import in_a_row, inline
from tests.support.runs.commands import RUN
from tests.support.runs.mutation.machines import random_machine, written_out
from tests.support.yaml.chaos import Chaos


class Firings(Observer):
    """Writes down which transitions have fired, and by which rules."""

    def __init__(self) -> None:
        self.found: list[tuple[str, Rule]] = []

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        self.found.append((transition, rule))


def executed(machine: PetriNetMachine, seed: int) -> tuple[list[tuple[str, Rule]], list[str], tuple[CallResult, ...]]:
    """Execute a machine in a world that answers as it likes; return what has fired, what was sent, and the results of its calls."""
    random, firings = Random(seed), Firings()
    knowledge = Layered(KnowledgeBase({("powered",): True, ("free",): random.random() < 0.5}, sensed={"free": 1.0}))
    run = Run(machine, knowledge, id=RUN, observer=firings)
    chaos = Chaos(run, knowledge, random)
    for _ in chaos.drive(3_000):
        pass
    return firings.found, chaos.sent, run.results


@given(st.integers(0, 10_000), st.integers(0, 10_000))
def test_a_machine_of_blocks_is_executed_as_the_same_machine_without_any(number: int, seed: int) -> None:
    machine = random_machine(number)
    assert executed(machine, seed) == executed(written_out(machine), seed)


def test_what_is_known_of_a_shape_does_not_grow_with_its_calls() -> None:
    machine = generate(in_a_row(100))
    inline(Run(machine, Layered(KnowledgeBase()), id=RUN))
    shapes = {id(site.shape): site.shape for site in index_of(machine).sites}
    made = sum(len(shape.firings) for shape in shapes.values())
    assert len(shapes) == 3, "of all calls, of the frame before them, and of the frame after them"
    assert made < 40


def test_a_machine_is_proved_and_executed_without_its_names() -> None:
    machine = generate(in_a_row(3))
    verify(machine)
    inline(Run(machine, Layered(KnowledgeBase()), id=RUN))
    assert vars(machine).keys().isdisjoint(("net", "rules", "initial"))
    assert machine.rules is machine.rules
    with pytest.raises(AttributeError, match="a machine has no 'ruels'"):
        assert machine.ruels  # type: ignore[attr-defined]


def test_each_block_of_a_shape_asks_for_its_own_condition() -> None:
    calls = (ActionCall(index, GroundAction(f"a{index}", precondition=Holds((f"p{index}",)))) for index in range(3))
    known = KnowledgeBase({("p0",): True, ("p1",): True})
    run = Run(generate(PlanGraph(tuple(calls))), Layered(known), id=RUN)
    run.handle(Begin(), 0.0)
    assert [call.action.name for call in run.open_calls.values()] == ["a0", "a1"]
