"""A process of ours: it opens the journal, goes on with what is in it, and carries its tasks to their ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextvars import Context
from functools import lru_cache
from uuid import UUID

from pnm.core.execution.call_results import RunResult
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.expressions import Unknown, Value
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.resources import Resources
from pnm.errors import InputError
from pnm.executor import Executor
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import Fenced, HeldByAnother, Hold, JournalChoice, JournalError
from pnm.journal.replay import Replay, ReplayedTask
from pnm.journal.resume import take_up
from pnm.tasks import Code, TaskEnding, Wanted
from tests.support.runs.simulation.disk import Disk, DiskPlan, Folder
from tests.support.runs.simulation.fleet import LAG, Connection, Fleet
from tests.support.runs.simulation.plans import SHAPES, Job, Scenario, scenario
from tests.support.runs.simulation.processes import Process
from tests.support.runs.simulation.story import Story, Suffered


@lru_cache(maxsize=SHAPES)
def machines(number: int) -> tuple[PetriNetMachine, ...]:
    """Return the machines of the jobs of a scenario."""
    chosen = scenario(number)
    return tuple(generate(job.plan, chosen.bindings, on_failure=job.on_failure, capacities=chosen.capacities) for job in chosen.jobs)


class Node:
    """A process that does all tasks of a scenario.

    The mutable state is the disk, the executors of tasks that go on, the knowledge, and what was known when everything was done.
    """

    def __init__(
        self, process: Process, number: int, fleet: Fleet, folder: Folder, plan: DiskPlan, story: Story, done: asyncio.Event
    ) -> None:
        self.process = process
        self.executors: dict[UUID, Executor] = {}
        self.knowledge: KnowledgeBase | None = None
        self.beliefs: KnowledgeBase | None = None
        self.disk: Disk | None = None
        self._done = done
        self.replaced = asyncio.Event()
        """Set when another process is to go on."""
        self._number = number
        self._scenario: Scenario = scenario(number)
        self._fleet = fleet
        self._folder = folder
        self._plan = plan
        self._story = story
        self._forget: list[Callable[[], None]] = []

    async def main(self) -> None:
        """Do everything that is left to do."""
        try:
            await self._carry_out()
            assert self.knowledge is not None
            self.beliefs = KnowledgeBase(self.knowledge.facts())  # it ends here: what is reported from now on it does not hear
            self._done.set()
        finally:
            self.close()

    def failed(self, error: Exception) -> None:
        """Note an error that nothing has handled."""
        said = str(error).replace(str(self._folder.path), "journal")  # which is elsewhere each time
        self._story.failures.append(f"{self.process.name}: {type(error).__name__}: {said}")

    def close(self) -> None:
        """Hear nothing more of the world."""
        while self._forget:
            self._forget.pop()()

    async def _carry_out(self) -> None:
        journal, replay = await self._taken()
        knowledge = self.knowledge = replay.world if replay else KnowledgeBase({("calm",): True})
        resources = replay.resources if replay else Resources(self._scenario.capacities)
        if replay is None:
            journal.begin(knowledge, resources)
        self._sense(knowledge)
        tasks = [
            asyncio.ensure_future(self._carry(job, order, journal, replay, knowledge, resources))
            for order, job in enumerate(self._scenario.jobs)
        ]
        await asyncio.gather(*tasks)
        while journal.blocked:  # noqa: ASYNC110, a disk says nothing when there is space again
            await asyncio.sleep(1.0)
        journal.close()

    async def _taken(self) -> tuple[WrittenJournal, Replay | None]:
        """Take the journal as soon as no other process holds it."""
        while True:
            try:
                self._folder.check_free(self.process)
                taken = take_up(JournalChoice(self._folder.journal), RECORDS, "", self._take)
                return taken.write(self._fenced, self.process.loop.time), taken.replay
            except (HeldByAnother, InputError) as error:
                held = error if isinstance(error, HeldByAnother) else error.__cause__
                if not isinstance(held, HeldByAnother):
                    raise
                await asyncio.sleep(max(held.left, 0.25))

    def _take(self, choice: JournalChoice) -> tuple[Disk, Hold]:
        self._folder.check_free(self.process)
        if self._plan.opening:
            self.process.sleep(self._plan.opening)
            self._folder.check_free(self.process)
        self.disk = Disk(self._folder, self.process, self._plan, self._story, self.replaced.set)
        return self.disk, self.disk.hold

    def _fenced(self, why: Fenced) -> None:
        """End, a moment after another process has taken over."""
        self.process.loop.call_later(1.0, self._end)

    def _end(self) -> None:
        self._story.moments.append(Suffered(self.process.loop.time(), self.process.name, "ends, for another has taken over"))
        self.process.kill()

    async def _carry(
        self, job: Job, order: int, journal: WrittenJournal, replay: Replay | None, knowledge: KnowledgeBase, resources: Resources
    ) -> None:
        client = Connection(self.process, self._fleet, job.task)
        kept = replay.tasks.get(job.task) if replay else None
        if kept is not None and kept.ending is not None:
            return
        if kept is None:
            await self._accept(job, order, journal)
        live = _live(kept)
        if kept is not None and kept.runs and live is None:
            result = kept.runs[-1].result
            assert result is not None, "a run that is carried on no more has one"
            journal.over(job.task, _ending(result))
            return
        if live is not None:
            run = journal.go_on(live, None, client.goal_fields)
        else:
            run = journal.make_run(
                machines(self._number)[order],
                Layered(knowledge, KnowledgeBase(variables={"count": 0})),
                id=job.run,
                bindings=self._scenario.bindings,
                goal_fields=client.goal_fields,
                resources=resources,
                task=job.task,
                priority=job.priority,
            )
        executor = self.executors[job.task] = Executor(run, client, None, f"t{order}", journal)
        result = await executor.execute()
        del self.executors[job.task]
        journal.over(job.task, _ending(result))

    async def _accept(self, job: Job, order: int, journal: WrittenJournal) -> None:
        """Have the task accepted; its client asks again until it is."""
        while True:
            try:
                journal.accepted(Wanted(job.task, f"t{order}", job.priority), order)
                return
            except JournalError:
                await asyncio.sleep(1.5)

    # --- the world --------------------------------------------------------------------------------

    def _sense(self, knowledge: KnowledgeBase) -> None:
        """Have sensors report to this process, in the order of the changes and within their lag."""
        world, names, loop, rng = self._fleet.robots.world, self._scenario.sensed, self.process.loop, self._fleet.rng
        knowledge.sense(names, lag=LAG)
        knowledge.replace(names, world.report(frozenset(names)))
        latest = loop.time()

        def report(changes: Mapping[tuple[str, ...], Value | Unknown]) -> None:
            nonlocal latest
            latest = max(latest, loop.time() + rng.choice([0.0, 0.0, LAG]) * rng.random())
            seen = {fluent: value for fluent, value in changes.items() if fluent[0] in names}
            loop.call_at(latest, self.process.do, knowledge.update, seen, context=Context())

        self._forget.append(world.truth.listen(report))


def _live(kept: ReplayedTask | None):  # type: ignore[no-untyped-def]
    return next((entry for entry in reversed(kept.runs) if not entry.is_over), None) if kept is not None else None


def _ending(result: RunResult) -> TaskEnding:
    code = Code.GOAL_REACHED if result.goal else Code.CANCELLED if result.stopped else Code.ACTION_FAILED
    return TaskEnding(code, result.reason)
