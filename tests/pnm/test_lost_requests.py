"""Requests of which nobody knows any more how they have ended, and those that end as a person says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.execution.events import Begin, Cancel, Command, Reattach, Restarted, Settled
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.bindings import Binding, Bindings, WhenLost
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Report, Request
from pnm.core.resources import Resources
from pnm.executor import Executor
from pnm.journal.journal import NO_JOURNAL, Journal, WrittenJournal
from pnm.journal.records import TaskNoted
from pnm.journal.resume import replayed
from pnm.journal.store import JournalFile
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


# --- requests that end as a person says ---


BINDINGS = Bindings({"look": Binding(store={"place": "seen"}, retries=0)})
LOOK = PlanGraph((ActionCall(0, GroundAction("look")),), (), goal=TRUE)


class Client:
    """A robot that is at work until it is cancelled, and ends then in this way, with a result whose fields are as they begin."""

    def __init__(self, ends: OutcomeKind) -> None:
        self._ends = ends
        self._hear: dict[UUID, Callable[[Report], object]] = {}
        self.accepted = asyncio.Event()
        self.requests: list[UUID] = []

    def send(self, request: Request, hear: Callable[[Report], object]) -> None:
        self._hear[request.id] = hear
        self.requests.append(request.id)
        hear(Accepted(request.id))
        self.accepted.set()

    def cancel(self, request: UUID) -> None:
        self._hear.pop(request)(Ended(request, Outcome(self._ends, {"place": "nowhere"})))


@pytest.mark.parametrize(("ends", "seen"), [(OutcomeKind.CANCELED, None), (OutcomeKind.ABORTED, None), (OutcomeKind.SUCCEEDED, "nowhere")])
def test_what_a_server_gives_back_that_was_stopped_is_no_result(ends: OutcomeKind, seen: str | None) -> None:
    async def course() -> tuple[bool, object]:
        knowledge = Layered(KnowledgeBase(), KnowledgeBase())
        client = Client(ends)
        executor = Executor(Run(generate(LOOK, BINDINGS), knowledge, bindings=BINDINGS, id=UUID(int=1)), client)
        running = asyncio.ensure_future(executor.execute())
        await client.accepted.wait()
        executor.settle(client.requests[0], OutcomeKind.SUCCEEDED)
        result = await running
        value = knowledge.local.variable("seen")
        return result.goal, value if value == "nowhere" else None

    assert asyncio.run(asyncio.wait_for(course(), 60)) == (True, seen)


def settled_run(journal: Journal) -> tuple[Run, UUID]:
    """A run with a request that was accepted, and about which a person has said that it is done."""
    machine, knowledge = generate(LOOK, BINDINGS), Layered(KnowledgeBase(), KnowledgeBase())
    run = journal.make_run(machine, knowledge, id=UUID(int=1), bindings=BINDINGS, goal_fields=lambda _: None)
    done: list[Command] = []
    journal.handle(run, Begin(), 0.0, done.extend)
    (request,) = run.open_requests
    journal.handle(run, Accepted(request), 1.0, done.extend)
    journal.handle(run, Settled(request, OutcomeKind.SUCCEEDED), 2.0, done.extend)
    assert done[-1] == Cancel(request)
    return run, request


def test_what_a_person_has_said_is_known_to_the_next_process(tmp_path: Path) -> None:
    async def one_process() -> UUID:
        journal = WrittenJournal(JournalFile(tmp_path / "journal", 0.0), TASKS)
        journal.begin(KnowledgeBase(), Resources())
        return settled_run(journal)[1]  # and dies, before the server has confirmed the end

    request = asyncio.run(one_process())
    (again,) = replayed(tmp_path / "journal", TASKS).runs.values()
    commands = again.run.handle(Restarted(), 3.0)
    assert isinstance(commands[0], Reattach)
    assert commands[1] == Cancel(request), "the process before may have died when this was kept, and not done yet"
    end = again.run.as_settled(Ended(request, Outcome(OutcomeKind.CANCELED)))
    assert isinstance(end, Ended)
    assert end.outcome.kind is OutcomeKind.SUCCEEDED


def test_what_has_ended_is_not_settled_any_more() -> None:
    run, request = settled_run(NO_JOURNAL)
    run.handle(Ended(request, Outcome(OutcomeKind.SUCCEEDED)), 3.0)
    late = Ended(request, Outcome(OutcomeKind.ABORTED))
    assert run.as_settled(late) == late
    assert run.handle(Settled(request, OutcomeKind.ABORTED), 4.0) == []
    assert run.result().goal


def test_a_run_that_takes_over_a_request_knows_what_a_person_has_said() -> None:
    run, request = settled_run(NO_JOURNAL)
    (taken,) = run.under_way()
    plan = PlanGraph((replace(LOOK.calls[0], under_way=True),), (), goal=TRUE)
    successor = Run(generate(plan, BINDINGS), run.knowledge, id=UUID(int=2), bindings=BINDINGS, adopted={0: taken})
    successor.take_the_place_of(run, 3.0)
    end = successor.as_settled(Ended(request, Outcome(OutcomeKind.CANCELED)))
    assert isinstance(end, Ended)
    assert end.outcome.kind is OutcomeKind.SUCCEEDED
