"""Requests that a process has given up: the next one asks their servers until they are over, and their resources are free then."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import UUID

from planner_bridge.model.world import simulated_backend
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.machine.bindings import Binding, Bindings
from pnm.journal.records import EndConfirmed
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from pnm.tasks import TaskListener, TraceEvent, TraceKind, Wanted
from tests.support.pddl.problems import fleet
from tests.support.tasks.scenarios.successors import Successors

SLOW = Faults((Fault("move(r1, a1, a2)", FaultKind.SLOW, ignores_cancel=True),))
SETTINGS = Settings(improve=0.0, bindings=Bindings({"move": Binding(resources=("{r}",), timeout=2.0, cancel=1.0, retries=0)}))


class GivenUp(TaskListener):
    def __init__(self) -> None:
        self.is_so = asyncio.Event()

    def happened(self, event: TraceEvent) -> None:
        if event.kind is TraceKind.WITHHELD:
            self.is_so.set()


def test_the_next_process_frees_what_a_request_has_kept_when_its_server_says_that_it_is_over(tmp_path: Path) -> None:
    journal, problem = tmp_path / "journal", fleet(robots=2)

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings, SLOW)
        processes = Successors(problem, SETTINGS, robots, journal, {"there": ("at", "r1", "a2")})
        first, given_up_listener = await processes.first(), GivenUp()
        first.manager.listen(given_up_listener)
        first.manager.begin(Wanted(UUID(int=1), "there"))
        await given_up_listener.is_so.wait()
        await first.die()

        second, replay = await processes.next()
        (given_up,) = replay.withheld
        assert str(given_up.action) == "move(r1, a1, a2)"
        freed = asyncio.Event()
        replay.resources.listen(freed.set)
        second.manager.restore(replay)
        assert replay.resources.given_up, "nobody has said yet that it is over"
        async with asyncio.timeout(1000.0):
            while replay.resources.given_up:
                await freed.wait()
                freed.clear()
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)
    records = [step.record for step in replay_steps(journal, TASKS, Replay())]
    assert any(isinstance(record, EndConfirmed) for record in records)
