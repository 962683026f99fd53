"""Tasks that are over leave no objects behind, with a journal and without."""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.tasks.result import TASKS, Stopwatch
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.backend import ClientBackend
from pnm.core.logic.conditions import Holds
from pnm.core.machine.plan_graph import GroundAction
from pnm.journal import journal as journals
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner
from pnm.tasks import REMEMBERED, Wanted
from tests.support.e2e.page.busy_run import AtOnce
from tests.support.pddl.problems import fleet

FIRST, MORE = 2 * REMEMBERED, 5 * REMEMBERED
"""Tasks after which all is there that is kept for a while, such as those that are listed as past; and others."""
PLACES = 4


class Robots(AtOnce):
    """Robots that do everything at once."""

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None


def ours() -> Counter[str]:
    """Count the objects of our classes that are alive."""
    while gc.collect():  # what machines were executed by is let go when they are, and refers to itself as well
        pass
    classes = map(type, gc.get_objects())
    return Counter(kind.__qualname__ for kind in classes if str(kind.__module__).startswith(("pnm.", "planner_bridge.")))


@pytest.mark.parametrize("is_kept", [False, True], ids=["", "with a journal"])
def test_a_task_that_is_over_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_kept: bool) -> None:
    monkeypatch.setattr(journals, "_LONG", 1)  # what it keeps of the runs of a segment is let go when each task is over

    async def soak() -> tuple[Counter[str], Counter[str]]:
        problem, counts = fleet(robots=1, parcels=1, places=PLACES), list[Counter[str]]()
        world = initial_knowledge(problem)
        journal = journals.WrittenJournal(JournalFile(tmp_path / "journal", 0.0), TASKS) if is_kept else journals.NO_JOURNAL
        runner = PlanRunner({}, ClientBackend(Robots()), world, None, journal)
        manager = TaskManager(problem, runner, Settings(improve=0.0), lambda text: Holds(tuple(text.split())))
        journal.begin(world, runner.resources)
        for number in range(1, FIRST + MORE + 1):
            result = await manager.run(Wanted(UUID(int=number), f"at r0 a{number % PLACES}"), TaskObserver(), Stopwatch())
            assert result.goal_reached, result.reason
            del result
            if number in (FIRST, FIRST + MORE):
                counts.append(ours())
        before, after = counts
        return before, after

    before, after = asyncio.run(soak())
    assert after - before == Counter()
