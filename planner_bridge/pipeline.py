"""The story: problem → plan → plan graph → machine → run, and again from the world as it then is."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast
from uuid import uuid4

from planner_bridge.forbidding import ForbiddenCall, forbid
from planner_bridge.loading import load
from planner_bridge.model import Domain, Problem
from planner_bridge.monitoring import Monitor, Violation
from planner_bridge.plan import PlanningResult, PlanningStatus
from planner_bridge.planning import solve
from planner_bridge.plans import plan_graph
from planner_bridge.replanning import Decision, GiveUp, History, PlanAgain, Resume, decide
from planner_bridge.sites import SimulatedSite
from planner_bridge.state import initial_knowledge, problem_now
from planner_bridge.tasks import Episode, Settings, TaskObserver, TaskResult
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.analysis import verify
from pnm.clock import run_async
from pnm.conditions import evaluate
from pnm.errors import InputError
from pnm.executor import Executor
from pnm.generation import generate
from pnm.knowledge import KnowledgeBase, Layered
from pnm.machine import PetriNetMachine
from pnm.plan_graph import PlanGraph, PlanGraphError
from pnm.results import RunResult
from pnm.run import Run
from pnm.sites import Ros2Site, Site, schedule
from pnm.state_space import Unsound

Where: TypeAlias = Literal["simulated", "ros2"]


def achieve(
    domain: Path | str | Domain | None,
    problem: Path | str | Problem | Any,
    *,
    actions: Where = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
    stopwatch: Stopwatch | None = None,
) -> TaskResult:
    """Pursue the goal of the problem until it holds or cannot be reached.

    Args:
        domain: a file or a Domain; not needed when `problem` is a Problem.
        problem: a file, a Problem, or a Problem of unified-planning.
        actions: simulated robots under virtual time, or the action servers of ROS 2.
        faults: what goes wrong in simulation.
        settings: planner, bindings and limits.
        observer: is told what happens.
        stopwatch: measures where the time goes; one that has run before goes on.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    chosen = settings or Settings()
    seconds = stopwatch or Stopwatch()
    with seconds.of("parse"):
        loaded = load(domain, problem)
    site: Site = Ros2Site(chosen.bindings, sensing=chosen.sensing) if actions == "ros2" else SimulatedSite(loaded, chosen.bindings, faults)
    task = pursue(loaded, site, chosen, observer or TaskObserver(), seconds)
    return run_async(task, virtual=actions == "simulated")


async def pursue(problem: Problem, site: Site, settings: Settings, observer: TaskObserver, seconds: Stopwatch) -> TaskResult:
    """Plan, execute and replan at a site; `achieve` does this with a loop of its own."""
    knowledge = initial_knowledge(problem)
    try:
        return await _Task(problem, site, settings, observer, seconds, Layered(knowledge)).pursue()
    finally:
        await site.close()


async def pursue_on(
    problem: Problem,
    site: Site,
    settings: Settings,
    observer: TaskObserver,
    seconds: Stopwatch,
    *,
    knowledge: KnowledgeBase,
    history: History,
) -> TaskResult:
    """Plan, execute and replan at a site that is open and keeps the knowledge up to date, after what has happened before."""
    return await _Task(problem, site, settings, observer, seconds, Layered(knowledge), opens=False, history=history).pursue()


class Stopwatch:
    """Adds up where the time of a task goes, in seconds of the wall clock."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("parse", "plan", "translate", "verify", "execute"), 0.0)

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Measure one part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - began


@dataclass
class _Task:
    """A goal with its episodes. The mutable state is the monitor and what has a default."""

    problem: Problem
    site: Site
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    knowledge: Layered
    opens: bool = True
    """Whether the site is still to be opened."""
    episodes: list[Episode] = field(default_factory=list)
    history: History = field(default_factory=History)
    plans: int = 0
    began: float = 0.0
    executor: Executor | None = None
    """What executes the current machine."""
    violation: Violation | None = None
    """The constraint that was violated first: nothing makes that good, so the task is over."""
    is_over: asyncio.Event = field(default_factory=asyncio.Event)
    """Nothing needs to be waited for any more."""
    no_plan_needed: threading.Event = field(default_factory=threading.Event)
    next_look: asyncio.TimerHandle | None = None

    def __post_init__(self) -> None:
        self.monitor = Monitor(self.problem, self.knowledge)
        self.allowed = self.settings.limits.allowed()

    async def pursue(self) -> TaskResult:
        with ExitStack() as at_the_end:
            try:
                if self.opens:
                    await self.site.open(self.knowledge.world)
                self._watch_the_clock(at_the_end)
                self._watch_the_constraints(at_the_end)
                return await self._pursue()
            except asyncio.CancelledError:  # while no run was there to be stopped
                cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                return self._ended(False, "cancelled")
            except (PlanGraphError, Unsound) as error:  # a plan that is valid, but not by causes alone
                return self._ended(False, f"the plan cannot be executed: {error}")

    def _watch_the_clock(self, at_the_end: ExitStack) -> None:
        """Begin; let those timed facts come true by themselves that nobody reports."""
        self.began = asyncio.get_running_loop().time()
        at_the_end.callback(schedule(self.knowledge.world, self.problem.timed, self.began))

    def _watch_the_constraints(self, at_the_end: ExitStack) -> None:
        """Look at the initial state, and from now on whenever something changes or a moment comes that matters."""
        at_the_end.callback(self._look_again_at, inf)
        at_the_end.callback(self.knowledge.world.listen(self._look))
        self._look()

    def _look(self, _changes: object = None) -> None:
        now = self._elapsed()
        for violation in self.monitor.look(now):
            self.observer.violated(violation, asyncio.get_running_loop().time())
            if self.violation is None:
                self._stop(violation)
        self._look_again_at(self.monitor.next_look(now))

    def _look_again_at(self, time: float) -> None:
        if self.next_look:
            self.next_look.cancel()
        self.next_look = None if time == inf else asyncio.get_running_loop().call_at(self.began + time, self._look)

    def _stop(self, violation: Violation) -> None:
        """End whatever is going on."""
        self.violation = violation
        self.is_over.set()
        self.no_plan_needed.set()
        if self.executor:
            self.executor.stop(reason=str(violation))

    async def _pursue(self) -> TaskResult:
        forbidden = self.history.forbidden(self.settings.limits)
        graph: PlanGraph | None = None
        origin = self.began
        await self._settle()
        while True:
            if self.violation:
                return self._ended(False, str(self.violation))
            if graph is None:
                origin = asyncio.get_running_loop().time()
                now = self._now()
                found = await self._plan(forbid(now, forbidden))
                if found.plan is None:
                    return self._ended(False, str(self.violation or _no_plan(found, forbidden) + self._last_failure()))
                with self.seconds.of("translate"):
                    graph = plan_graph(now, found.plan)
            machine, result = await self._run(graph, origin)
            if not result.goal or not self.monitor.idle:  # reports about what has just happened may still be under way
                await asyncio.sleep(self.knowledge.world.longest_lag)
            await self._settle()
            if verdict := self._verdict(result):
                self.episodes.append(Episode(machine, result))
                return self._ended(*verdict)
            decision = self._decide(graph, result)
            self.episodes.append(Episode(machine, result, decision))
            match decision:
                case GiveUp(reason):
                    return self._ended(False, reason + self._last_failure())
                case Resume(rest):
                    graph = rest
                case PlanAgain():
                    graph, forbidden = None, decision.forbidden
            self.observer.replanning(decision, result)
            await self._wait(self.history.pause(self.settings.limits))

    def _verdict(self, result: RunResult) -> tuple[bool, str] | None:
        """Return whether the goal is reached, and why the task ends with this run; None if it does not."""
        if self.violation:
            return False, str(self.violation)
        carried_out = result.goal or not self.problem.network  # a network is more than its goal
        if carried_out and evaluate(self.problem.goal, self.knowledge) is True and not self.monitor.missing(self._elapsed()):
            return True, "the goal holds"
        return (False, result.reason) if result.stopped else None

    async def _settle(self) -> None:
        """Wait until it is known whether that is violated which looks violated now."""
        doubtful = self.monitor.doubtful_until() - self._elapsed()
        if doubtful > 0:
            await self._wait(doubtful)
            self._look()

    async def _wait(self, seconds: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self.is_over.wait()

    def _now(self) -> Problem:
        elapsed = self._elapsed()
        return self.monitor.rest_of(problem_now(self.problem, self.knowledge.world, elapsed), elapsed)

    def _elapsed(self) -> float:
        """Return how many seconds the task has taken so far."""
        return asyncio.get_running_loop().time() - self.began

    def _left(self) -> float:
        """Return how many seconds the task may still take."""
        return max(0.0, self.allowed - self._elapsed())

    def _decide(self, graph: PlanGraph, result: RunResult) -> Decision:
        """Decide from the world as it is now known to be."""
        self.history = self.history.after(result.calls, result.failures)
        if not self._left():
            return GiveUp(f"the limit of {self.allowed:g} s is reached")
        return decide(self._now(), graph, result.calls, self.knowledge.world, self.history, self.settings.limits)

    async def _plan(self, problem: Problem) -> PlanningResult:
        self.observer.planning(self.settings.planner)
        with self.seconds.of("plan"):
            found = await self._solve(problem)
        if found.plan is None:
            self.observer.unplanned(found)
        else:
            self.plans += 1
            self.allowed = max(self.allowed, self.settings.limits.allowed(found.plan.makespan if found.plan.temporal else 0.0))
            self.observer.planned(found.plan)
        return found

    async def _solve(self, problem: Problem) -> PlanningResult:
        timeout = max(0.01, min(self.settings.planner_timeout, self._left()))
        try:
            return await asyncio.to_thread(
                solve, problem, planner=self.settings.planner, timeout=timeout, cancel=self.no_plan_needed, executor=self.settings.executor
            )
        except asyncio.CancelledError:
            self.no_plan_needed.set()
            raise
        except InputError as error:
            if not self.episodes:
                raise
            return PlanningResult(PlanningStatus.INVALID, message=str(error))

    async def _run(self, graph: PlanGraph, origin: float) -> tuple[PetriNetMachine, RunResult]:
        with self.seconds.of("translate"):
            machine = generate(graph, self.settings.bindings, on_failure=self.settings.on_failure)
        with self.seconds.of("verify"):
            proof = verify(machine)
        self.observer.generated(machine, proof)
        await self.site.prepare({call.action: None for call in graph.calls})
        run = Run(
            machine,
            self.knowledge,
            id=uuid4(),
            bindings=self.settings.bindings,
            goal_fields=self.site.client.goal_fields,
            observer=self.observer,
            origin=origin,
        )
        self.executor = Executor(run, self.site.client)
        if self.violation:  # while the machine was being prepared
            self._stop(self.violation)
        over = partial(self.executor.stop, reason=f"the limit of {self.allowed:g} s is reached")
        timer = asyncio.get_running_loop().call_at(self.began + self.allowed, over)
        try:
            with self.seconds.of("execute"):
                return machine, await self.executor.execute()
        finally:
            timer.cancel()
            self.executor = None

    def _last_failure(self) -> str:
        if not self.episodes:
            return ""
        result, missing = self.episodes[-1].result, self.monitor.missing(self._elapsed())
        failure = "" if result.goal else f"; last failure: {result.reason}"
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        return failure + (f"; not fulfilled: {', '.join(map(str, missing[:3]))}{more}" if missing else "")

    def _ended(self, goal_reached: bool, reason: str) -> TaskResult:
        now = self._elapsed()
        return TaskResult(
            goal_reached,
            reason,
            self.plans,
            tuple(self.episodes),
            self.seconds.seconds,
            self.began,
            self.monitor.constraint_results(now),
            self.monitor.preference_results(now),
        )


def _no_plan(found: PlanningResult, forbidden: frozenset[ForbiddenCall]) -> str:
    without = f" without {', '.join(sorted(map(str, forbidden)))}, which failed too often" if forbidden else ""
    return f"no plan{without}: {found.reason}"
