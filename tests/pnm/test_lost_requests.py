"""Requests of which nobody knows any more how they have ended: failed, asked about, or the end of the task."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.logic.computed_values import Layer
from pnm.core.machine.bindings import Binding, Bindings, WhenLost
from pnm.journal.records import TaskNoted
from pnm.knowledge.people import HelpAsked, HelpEnded
from pnm.knowledge.source import SourceError
from pnm.tasks import Code
from tests.support.e2e.page.journals import steps
from tests.support.logic.people import DelayedSource, Person
from tests.support.pddl.problems import rooms
from tests.support.tasks.node import USUAL, carry, simulated
from tests.support.tasks.replanning import pursued
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

WAY = rooms(init="(at r1 a)", goal="(at r1 b)", ways="ab")
LOST = Faults((Fault("move", FaultKind.LOSE_SERVER),))


def when_lost(policy: WhenLost, retries: int = 0) -> Bindings:
    return Bindings({"move": Binding(resources=("{r}",), retries=retries, when_lost=policy)})


def test_the_task_ends_if_only_people_can_know_what_has_happened() -> None:
    result, _ = pursued(WAY, LOST, bindings=when_lost(WhenLost.ABORT, retries=3))
    assert (result.code, result.replans) == (Code.SERVER_UNAVAILABLE, 0)
    assert result.reason.startswith("nobody knows how move(r1, a, b) has ended, and its binding says 'when_lost: abort'")
    assert [call.attempts for call in result.episodes[0].result.calls] == [1]


def test_by_default_it_has_failed_and_is_planned_around() -> None:
    result, _ = pursued(WAY, LOST, bindings=when_lost(WhenLost.REPLAN))
    assert not result.goal_reached
    assert result.replans >= 1


@pytest.mark.parametrize(("answer", "code"), [("yes", Code.GOAL_REACHED), ("No.", Code.ACTION_FAILED)])
def test_a_person_says_whether_it_was_carried_out(answer: str, code: Code) -> None:
    person = Person(layer=Layer.PERSON)

    @simulated(WAY, faults=LOST, chosen=replace(USUAL, bindings=when_lost(WhenLost.ASK)), source=person)
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("(at r1 b)")
        assert await person.asked.get() == "carried_out"
        assert simulation.master._resources.held, "while nobody knows, nothing else is sent to the robot"
        if answer == "yes":
            carry(simulation, "r1", "a", "b")
        person.answer("carried_out", answer)
        (ended,) = await simulation.ended_with(task)
        assert ended in {code, Code.SERVER_UNAVAILABLE, Code.NO_PLAN} - ({Code.GOAL_REACHED} - {code})
        if answer != "yes":
            assert "no person says that it was carried out" in str(simulation.moments)

    scenario()


def test_what_a_person_is_asked_and_what_comes_of_it_are_in_the_journal(tmp_path: Path) -> None:
    person, journal = Person(layer=Layer.PERSON), tmp_path / "tasks.journal"

    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("(at r1 b)")
        for answer in ("perhaps", "yes"):
            assert await person.asked.get() == "carried_out"
            carry(simulation, "r1", "a", "b")
            person.answer("carried_out", answer)
        assert await simulation.ended_with(task) == [Code.GOAL_REACHED]

    chosen = replace(USUAL, bindings=when_lost(WhenLost.ASK))
    simulate_tasks(scenario, WAY, faults=LOST, chosen=chosen, source=person, journal=journal)
    first, again, over = [step.record.note for step in steps(journal) if is_about_help(step.record)]
    assert isinstance(first, HelpAsked)
    assert first.text.startswith("Nobody knows how move(r1, a, b) has ended")
    assert (first.choices, first.request) == (("yes", "no"), first.question)
    assert again.text.startswith("Expected 'yes' or 'no', found 'perhaps'. Nobody knows")
    assert again.question != first.question
    assert over == HelpEnded("a person says that it was carried out", first.request)


def is_about_help(record: object) -> bool:
    return isinstance(record, TaskNoted) and isinstance(record.note, HelpAsked | HelpEnded)


def test_a_person_who_cannot_be_asked_does_not_keep_the_task_waiting() -> None:
    @simulated(WAY, faults=LOST, chosen=replace(USUAL, bindings=when_lost(WhenLost.ASK)), source=DelayedSource(error=SourceError("away")))
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("(at r1 b)")
        assert await simulation.ended_with(task) != [Code.GOAL_REACHED]
        assert "a person was asked about it in vain: away" in str(simulation.moments)

    scenario()
