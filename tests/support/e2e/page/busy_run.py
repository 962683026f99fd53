"""A run that is as busy as can be: its requests are answered at once, with a journal and without."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar
from uuid import UUID

from planner_bridge.tasks.result import TASKS
from pnm.core.execution.events import Begin, Command, Event, Fired, Observer, Send
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Report, Request
from pnm.core.resources import Resources
from pnm.executor import Executor
from pnm.journal.journal import NO_JOURNAL, Journal, RunOptions, WrittenJournal
from pnm.journal.store import JournalFile
from tests.support.runs.simulated import move


def rounds(calls: int, robots: int = 4) -> PlanGraph:
    """Robots that go to and fro; each of their calls waits for the one before."""
    places = ("hall", "kitchen")
    acts = tuple(
        ActionCall(index, move(f"r{index % robots}", places[index // robots % 2], places[1 - index // robots % 2]))
        for index in range(calls)
    )
    pairs = (Ordering(PlanEvent(index, Moment.END), PlanEvent(index + robots, Moment.START)) for index in range(calls - robots))
    return PlanGraph(acts, tuple(pairs))


AT_HOME = {("at", f"r{robot}", place): place == "hall" for robot in range(50) for place in ("hall", "kitchen")}


class Count(Observer):
    """The number of firings."""

    count = 0

    def fired(self, fired: Fired, now: float) -> None:
        self.count += 1


def answered(machine: PetriNetMachine, journal: Journal, world: KnowledgeBase, run_id: UUID = UUID(int=1)) -> int:
    """Execute a machine, and answer every request at once; return how many transitions have fired."""
    world.update(AT_HOME)
    resources, count, waiting = Resources(), Count(), list[Command]()
    options = RunOptions(id=run_id, bindings=Bindings(), goal_fields=lambda _: None, observer=count, resources=resources)
    run = journal.make_run(machine, Layered(world), **options)

    def handle(event: Event) -> None:
        journal.handle(run, event, 0.0, waiting.extend)

    handle(Begin())
    while waiting:
        command = waiting.pop()
        if isinstance(command, Send):
            handle(Accepted(command.request.id))
            handle(Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED)))
    assert run.result().goal, run.result()
    journal.retired(run)
    run.retire()
    return count.count


class AtOnce:
    """Servers that carry everything out in the next round of the event loop."""

    def send(self, request: Request, report: Callable[[Report], object], /) -> None:
        """Take a request."""
        asyncio.get_running_loop().call_soon(self._carry_out, request.id, report)

    def cancel(self, request: UUID, /) -> None:
        """Do nothing: it is over, or about to be."""

    @staticmethod
    def _carry_out(request: UUID, report: Callable[[Report], object]) -> None:
        report(Accepted(request))
        report(Ended(request, Outcome(OutcomeKind.SUCCEEDED)))


async def executed(machine: PetriNetMachine, journal: Journal, world: KnowledgeBase) -> None:
    """Execute a machine as a runner does, with servers that answer at once."""
    world.update(AT_HOME)
    options = RunOptions(id=UUID(int=1), bindings=Bindings(), goal_fields=lambda _: None, resources=Resources())
    run = journal.make_run(machine, Layered(world), **options)
    assert (await Executor(run, AtOnce(), journal=journal).execute()).goal
    journal.retired(run)
    run.retire()


Done = TypeVar("Done")


def without_journal(work: Callable[[Journal, KnowledgeBase], Done]) -> Done:
    """Do some work in a world of its own."""
    return work(NO_JOURNAL, KnowledgeBase())


@contextmanager
def kept(file: Path, *, is_durable: bool = False) -> Iterator[tuple[Journal, KnowledgeBase]]:
    """A journal in this file, and a world of its own; in an event loop."""
    journal, world = WrittenJournal(JournalFile(file, 0.0, is_durable=is_durable), TASKS), KnowledgeBase()
    journal.begin(world, Resources())
    try:
        yield journal, world
    finally:
        journal.close()


def with_journal(work: Callable[[Journal, KnowledgeBase], Done], file: Path, *, is_durable: bool = False) -> Done:
    """Do the same with a journal in this file."""

    async def do() -> Done:
        with kept(file, is_durable=is_durable) as (journal, world):
            return work(journal, world)

    return asyncio.run(do())
