"""A run that is as busy as can be: its requests are answered at once, with a journal and without."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias
from uuid import UUID

from planner_bridge.tasks.result import TASKS
from pnm.core.execution.events import Begin, Command, Event, Observer, Send
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import PetriNetMachine, Rule
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.journal.journal import NO_JOURNAL, Journal, RunOptions
from pnm.journal.kept import Durability
from pnm.journal.store import JournalFile
from pnm.journal.written_journal import WrittenJournal
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


AT_HOME = {("at", f"r{robot}", place): place == "hall" for robot in range(4) for place in ("hall", "kitchen")}


class Count(Observer):
    """The number of firings."""

    count = 0

    def fired(self, transition: str, rule: Rule, now: float) -> None:
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


Work: TypeAlias = Callable[[Journal, KnowledgeBase], int]


def without_journal(work: Work) -> int:
    """Do some work in a world of its own."""
    return work(NO_JOURNAL, KnowledgeBase())


def with_journal(work: Work, file: Path, durability: Durability = Durability.PROCESS_CRASH) -> int:
    """Do the same with a journal in this file."""

    async def do() -> int:
        journal, world = WrittenJournal(JournalFile(file, durability, 0.0), TASKS), KnowledgeBase()
        journal.begin(world, Resources())
        try:
            return work(journal, world)
        finally:
            journal.close()

    return asyncio.run(do())
