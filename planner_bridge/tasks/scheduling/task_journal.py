"""The journal of one task, of `pnm run` and `achieve`: an unfinished one that is in it goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from planner_bridge.tasks.result import TASKS, Stopwatch, TaskResult
from planner_bridge.tasks.scheduling.task_manager import TaskManager
from planner_bridge.tasks.settings import TaskObserver
from pnm.actions.backend import Backend, SimulatedBackend
from pnm.clock import continue_from
from pnm.core.knowledge_base import KnowledgeBase
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.journal.kept import Fenced, JournalChoice
from pnm.journal.replay import Replay
from pnm.knowledge.source import Source
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Wanted

if TYPE_CHECKING:
    from pnm.journal.resume import Taken


@dataclass(frozen=True)
class TaskJournal:
    """The journal of one task.

    Args:
        taken: the journal, which nobody else can write now; None for none.
        origin: what its world is made from.
        replay: of what goes on; None if the task begins.
    """

    taken: Taken | None = None
    origin: str = ""
    replay: Replay | None = None

    @staticmethod
    def of(choice: JournalChoice, origin: str) -> TaskJournal:
        """Return the journal with the task in it that is not finished, if there is one; raise an `InputError` if it cannot be used."""
        from pnm.journal.resume import take_up  # here, because it takes its time to import, for which runs without a journal need not wait

        taken = take_up(choice, TASKS, origin)
        return TaskJournal(taken, origin, taken.replay if taken.replay and taken.replay.unfinished else None)

    def world(self, initial: KnowledgeBase) -> KnowledgeBase:
        """Return what is known of the world: what another process knew, or the initial knowledge."""
        return self.replay.world if self.replay else initial

    @contextmanager
    def opened(self, backend: Backend) -> Iterator[Journal]:
        """Enter the journal; the time of what goes on in it goes on as well, and simulated robots begin in its world."""
        if self.taken is None:
            yield NO_JOURNAL
            return
        if self.replay:
            continue_from(self.replay.now)
            if isinstance(backend, SimulatedBackend):
                backend.robots.go_on_from(self.replay.world, self.replay.now - self.replay.began)
        fenced, task = list[Fenced](), asyncio.current_task()

        def end(why: Fenced) -> None:
            """Leave what runs alone: another process goes on with it."""
            fenced.append(why)
            if task is not None:
                task.cancel()
                task.get_loop().call_later(0.0, task.cancel)  # the first one only asks for an end, which this journal does not record

        journal = replace(self.taken, replay=self.replay).write(end)
        try:
            yield journal
        except asyncio.CancelledError:
            if not fenced:
                raise
            raise fenced[0] from None
        finally:
            journal.close()

    def runner(
        self,
        backend: Backend,
        world: KnowledgeBase,
        journal: Journal,
        programs: Mapping[str, Program] | None = None,
        source: Source | None = None,
    ) -> PlanRunner:
        """Return what carries plans out, with the resources of what goes on; or begin the journal."""
        runner = PlanRunner(programs or {}, backend, world, source, journal, self.replay.resources if self.replay else None)
        if self.replay is None:
            command, seal = (self.taken.choice.command, self.taken.choice.seal) if self.taken else ((), "")
            journal.begin(world, runner.resources, prefix=runner.prefix, origin=self.origin, command=command, seal=seal)
        elif self.replay.shared:
            runner.prefix = self.replay.shared.prefix
        return runner

    async def carry_out(self, manager: TaskManager, wanted: Wanted, observer: TaskObserver, stopwatch: Stopwatch) -> TaskResult:
        """Carry out the task that goes on, or the one that is wanted; see `TaskManager.run`."""
        if self.replay:
            return await manager.go_on(self.replay, observer, stopwatch)
        return await manager.run(wanted, observer, stopwatch)


KEPT_NOWHERE: Final = TaskJournal()
