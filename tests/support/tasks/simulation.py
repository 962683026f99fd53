"""Many tasks in one simulated world under the virtual clock: what is wanted, what has come of it, and what went against the rules."""

from __future__ import annotations

import asyncio
import gc
import logging
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path
from uuid import UUID, uuid4

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import VirtualTimeLoop
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.bindings import Bindings
from pnm.journal.journal import NO_JOURNAL, Journal, WrittenJournal
from pnm.journal.store import JournalFile
from pnm.knowledge.source import Source
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Code, TaskEnding, TaskListener, TaskState, TraceEvent, TraceKind, Wanted
from tests.support.pddl.problems import fleet, read_goal
from tests.support.tasks.laws import QUIET, contradictory_requests, standing_still

LIMIT = 20000.0
"""Virtual seconds within which everything must be over."""

LATE = 10.0
"""Virtual seconds within which a search for a plan that nobody waits for any more has come to its end."""


class TaskSimulation(TaskListener):
    """A master of tasks over simulated robots; what is wanted of it and what has come of that."""

    def __init__(
        self,
        problem: Problem,
        faults: Faults,
        chosen: Settings,
        limits: TaskLimits,
        programs: Mapping[str, Program] | None = None,
        source: Source | None = None,
        make_backend: Callable[[Problem, Bindings, Faults], SimulatedBackend] = simulated_backend,
        helper: Source | None = None,
        journal: Journal = NO_JOURNAL,
    ) -> None:
        self.problem = problem
        self.backend = make_backend(problem, chosen.bindings, faults)
        self.knowledge = initial_knowledge(problem)
        self.runner = PlanRunner(programs or {}, self.backend, self.knowledge, source, journal)
        self.read = partial(read_goal, problem)
        self.master = TaskManager(problem, self.runner, chosen, self.read, helper=helper, limits=limits)
        self.master.listen(self)
        self.goals: dict[UUID, str] = {}
        self.moments: list[TraceEvent] = []
        self.endings: dict[UUID, TaskEnding] = {}
        self.wrong: list[str] = []
        """What is against the rules."""
        self._news = asyncio.Event()
        self._heard: dict[UUID, float] = {}
        """When something has happened to each task last."""

    # --- what is told ---------------------------------------------------------------------------

    def changed(self, task: UUID) -> None:
        self._is_not_over(task, "changed")

    def planned(self, task: UUID) -> None:
        self._is_not_over(task, "planned")

    def moved(self, task: UUID, moment: Callable[[], TraceEvent]) -> None:
        self.happened(moment())

    def happened(self, moment: TraceEvent) -> None:
        self._is_not_over(moment.task, str(moment))
        self._heard[moment.task] = asyncio.get_running_loop().time()
        if not moment.kind.is_frequent:
            self.moments.append(moment)
        if moment.kind is TraceKind.SENT:
            tasks = self.master._tasks
            self.wrong += contradictory_requests(tasks[moment.task], moment.subject, tasks.values(), self.knowledge)
        self._stir()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        self._is_not_over(task, "ended")
        self.endings[task] = ending
        if self.state(task) is not TaskState.OVER:
            self.wrong.append(f"the status of {self.goals[task]} does not say that it is over")
        text = self.goals[task]
        is_goal = text.startswith("(") and not any(text.startswith(f"({name}") for name in self.problem.domain.actions)
        if is_goal and ending.code is Code.GOAL_REACHED:
            for state in (self.knowledge, self.backend.robots.world.truth):
                if evaluate(self.read(text), state) is not True:
                    self.wrong.append(f"{text} is said to be reached, and is not")
        self.wrong += [f"{one} belongs to no task" for one in self.orphans()]
        self._stir()

    def _is_not_over(self, task: UUID, what: str) -> None:
        if task in self.endings:
            self.wrong.append(f"{what} of {self.goals.get(task, task)} after its end")

    def orphans(self) -> list[str]:
        """Return what robots do for no task."""
        runs = [one.control.run for one in self.master._tasks.values() if one.control.run]
        runs += [one.run for one in self.runner.going_on]
        wanted = {request for run in runs for request in run.open_requests}
        jobs = self.backend.robots._jobs
        return [str(job.request.action) for id, job in jobs.items() if id not in wanted and not (job.fault and job.fault.ignores_cancel)]

    def _stir(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    async def watch(self) -> None:
        """See that no task stands still."""
        while True:
            await asyncio.sleep(QUIET / 4.0)
            now, tasks = asyncio.get_running_loop().time(), self.master._tasks.values()
            self.wrong += standing_still(tasks, {task.id: now - self._heard[task.id] for task in tasks})

    # --- what scenarios do and wait for -----------------------------------------------------------

    def want(self, text: str, **how: object) -> UUID:
        wanted = Wanted(uuid4(), text, **how)  # type: ignore[arg-type]
        self.goals[wanted.id] = text
        self.master.begin(wanted)
        return wanted.id

    async def begun(self, text: str, **how: object) -> UUID:
        """Want a task, and wait until its first call is sent."""
        task = self.want(text, **how)
        await self.sees(task, "sent")
        return task

    async def until(self, happens: Callable[[], object]) -> None:
        async with asyncio.timeout(LIMIT):
            while not happens():
                await self._news.wait()

    async def ended_with(self, *tasks: UUID) -> list[Code]:
        await self.until(lambda: all(task in self.endings for task in tasks))
        return [self.endings[task].code for task in tasks]

    async def reaches(self, *tasks: UUID) -> None:
        """See that these tasks reach their goals."""
        codes = await self.ended_with(*tasks)
        assert set(codes) == {Code.GOAL_REACHED}, [(self.goals[task], self.endings[task].message) for task in tasks]

    async def sees(self, task: UUID, kind: str, subject: str = "", times: int = 1) -> None:
        await self.until(lambda: len(self.seen(task, kind, subject)) >= times)

    def seen(self, task: UUID, kind: str, subject: str = "") -> list[TraceEvent]:
        return [one for one in self.moments if one.task == task and one.kind.word == kind and subject in one.subject + one.text]

    def state(self, task: UUID) -> TaskState:
        return next(one.state for one in self.master.status() if one.id == task)

    def sent(self, task: UUID) -> list[str]:
        return [one.subject for one in self.seen(task, "sent")]

    def sent_at(self, task: UUID) -> float:
        return self.seen(task, "sent")[0].time

    def ended_at(self, task: UUID) -> float:
        return self.endings[task].trace[-1].time

    def holds(self, text: str) -> bool:
        return self.backend.robots.world.holds(self.read(text))


class _Errors(logging.Handler):
    """Keeps what is logged as an error."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.found.append(self.format(record))


def simulate_tasks(
    scenario: Callable[[TaskSimulation], Awaitable[None]],
    problem: Problem | None = None,
    *,
    faults: Faults = NO_FAULTS,
    chosen: Settings,
    limits: TaskLimits | None = None,
    programs: Mapping[str, Program] | None = None,
    source: Source | None = None,
    helper: Source | None = None,
    make_backend: Callable[[Problem, Bindings, Faults], SimulatedBackend] = simulated_backend,
    journal: Path | None = None,
    loop: Callable[[], VirtualTimeLoop] = VirtualTimeLoop,
) -> None:
    """Run a scenario, close the task manager, and check that nothing was against the rules; keep a journal in a file, if there is one."""
    errors = _Errors()

    async def whole() -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: errors.found.append(str(context)))
        written = WrittenJournal(JournalFile(journal, 0.0), TASKS) if journal else None
        kept = written or NO_JOURNAL
        simulation = TaskSimulation(
            problem or fleet(), faults, chosen, limits or TaskLimits(), programs, source, make_backend, helper, kept
        )
        await simulation.backend.open(simulation.knowledge)
        (written or NO_JOURNAL).begin(simulation.knowledge, simulation.master._resources)
        watching = asyncio.ensure_future(simulation.watch())
        try:
            await scenario(simulation)
        finally:
            watching.cancel()
            await asyncio.wait_for(simulation.master.close(), LIMIT)
            left = simulation.orphans()
            await simulation.backend.close()
            if written:
                written.close()
        assert simulation.goals.keys() == simulation.endings.keys(), "every task has an end"
        await asyncio.sleep(0)
        gc.collect()
        await asyncio.sleep(LATE)
        others = [one for one in asyncio.all_tasks() if one is not asyncio.current_task()]
        assert not simulation.wrong, simulation.wrong
        assert not left, f"{left} go on after the end"
        assert not others, others
        clashes = simulation.backend.robots.clashes
        assert not clashes, clashes

    logging.getLogger().addHandler(errors)
    try:
        with asyncio.Runner(loop_factory=loop) as runner:
            runner.run(whole())
    finally:
        logging.getLogger().removeHandler(errors)
    assert not errors.found, errors.found
