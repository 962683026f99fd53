"""Tasks one after the other in one world, as many as are wanted: what they leave behind."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.tasks.result import TASKS, Stopwatch
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.backend import ClientBackend
from pnm.core.logic.conditions import Holds
from pnm.core.machine.plan_graph import GroundAction
from pnm.journal.journal import NO_JOURNAL, WrittenJournal
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.e2e.page.busy_run import AtOnce
from tests.support.pddl.problems import fleet

PLACES = 4


class Robots(AtOnce):
    """Robots that do everything at once."""

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None


async def tasks_in_a_row(file: Path | None) -> AsyncIterator[int]:
    """Carry out one task after the other, with a journal if there is a file for it; yield their number after each."""
    problem = fleet(robots=1, parcels=1, places=PLACES)
    world, journal = initial_knowledge(problem), WrittenJournal(JournalFile(file, 0.0), TASKS) if file else NO_JOURNAL
    runner = PlanRunner({}, ClientBackend(Robots()), world, None, journal)
    manager = TaskManager(problem, runner, Settings(improve=0.0), lambda text: Holds(tuple(text.split())))
    journal.begin(world, runner.resources)
    number = 0
    while True:
        number += 1
        result = await manager.run(Wanted(UUID(int=number), f"at r0 a{number % PLACES}"), TaskObserver(), Stopwatch())
        assert result.goal_reached, result.reason
        del result
        yield number


def ours() -> Counter[str]:
    """Count the objects of our classes that are alive."""
    while gc.collect():  # what machines were executed by is let go when they are, and refers to itself as well
        pass
    classes = map(type, gc.get_objects())
    return Counter(kind.__qualname__ for kind in classes if str(kind.__module__).startswith(("pnm.", "planner_bridge.")))


def memory() -> float:
    """Return the megabytes of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
