"""A task that does not end, in a process that dies, and its journal, which another one takes up."""

from __future__ import annotations

import asyncio
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import UUID

from planner_bridge.tasks.result import TASKS
from pnm.core.knowledge_base import Layered
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, Loop, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Reporter, Request
from pnm.core.resources import Resources
from pnm.executor import Executor
from pnm.journal.journal import RunOptions
from pnm.journal.resume import replayed
from tests.support.benchmarks.peers.worker import each
from tests.support.e2e.page.busy_run import AtOnce, kept
from tests.support.runs.simulated import move


class Tired(AtOnce):
    """Servers that answer so many requests, and no more."""

    def __init__(self, calls: int) -> None:
        self.calls = calls
        self.are_tired = asyncio.Event()

    def send(self, request: Request, report: Reporter, /) -> None:
        self.calls -= 1
        if self.calls >= 0:
            super().send(request, report)
        else:
            self.are_tired.set()


async def patrol(file: Path, calls: int) -> None:
    """Execute a loop that does not end, in a process that dies after so many calls."""
    there, back = move("r0", "hall", "kitchen"), move("r0", "kitchen", "hall")
    body = Flow((ActionCall(0, there), ActionCall(1, back)), (Ordering(PlanEvent(0, Moment.END), PlanEvent(1, Moment.START)),))
    machine, client = generate(PlanGraph((Loop(2, TRUE, body, 10**6),))), Tired(calls)
    with kept(file) as (journal, world):
        world.update({("at", "r0", "hall"): True})
        options = RunOptions(id=UUID(int=1), bindings=Bindings(), goal_fields=lambda _: None, resources=Resources())
        run = journal.make_run(machine, Layered(world), **options)
        execution = asyncio.ensure_future(Executor(run, client, journal=journal).execute())
        await client.are_tired.wait()
    execution.cancel()
    execution.cancel()


def taken_up(calls: int) -> float:
    """Return the microseconds in which the journal of a run is taken up that has not ended after so many calls."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "journal"
        asyncio.run(patrol(file, calls))
        return each(lambda: replayed(file, TASKS), 1)
