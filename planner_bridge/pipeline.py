"""The story: problem → plan → plan graph → machine → run, and again from the world as it then is."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast
from uuid import uuid4

from planner_bridge.loading import load
from planner_bridge.model import Domain, Problem
from planner_bridge.plan import Plan, PlanningResult
from planner_bridge.planning import DEFAULT_PLANNER, solve
from planner_bridge.plans import plan_graph
from planner_bridge.replanning import GiveUp, History, Limits, PlanAgain, Resume, decide
from planner_bridge.sites import Ros2Site, SimulatedSite, Site
from planner_bridge.state import initial_knowledge, problem_now
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.analysis import Proof, verify
from pnm.bindings import Bindings
from pnm.clock import run_async
from pnm.executor import Executor
from pnm.generation import generate
from pnm.knowledge import KnowledgeBase, Layered
from pnm.machine import OnFailure, PetriNetMachine
from pnm.observer import Observer
from pnm.plan_graph import PlanGraph
from pnm.results import CallResult, Failure, RunResult
from pnm.run import Run

Where: TypeAlias = Literal["simulated", "ros2"]


class TaskObserver(Observer):
    """Listens to a whole task: one more empty method per moment."""

    def planning(self, planner: str) -> None:
        """Note that a planner is being asked."""

    def planned(self, plan: Plan) -> None:
        """Note that a plan was found."""

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Note that a machine is ready to run, and proved sound."""

    def replanning(self, decision: Resume | PlanAgain, result: RunResult) -> None:
        """Note that a run failed and what follows."""


@dataclass(frozen=True)
class Settings:
    """How a task is pursued."""

    planner: str = DEFAULT_PLANNER
    planner_timeout: float = 30.0
    bindings: Bindings = field(default_factory=Bindings)
    limits: Limits = field(default_factory=Limits)
    on_failure: OnFailure = OnFailure.DRAIN


@dataclass(frozen=True)
class Episode:
    """One machine and its run; `decision` is what followed if the goal was not reached."""

    machine: PetriNetMachine
    result: RunResult
    decision: Resume | PlanAgain | GiveUp | None = None


@dataclass(frozen=True)
class TaskResult:
    """How a task ended, episode by episode."""

    goal_reached: bool
    reason: str
    plans: int
    """How often a planner found a plan."""
    episodes: tuple[Episode, ...]
    seconds: dict[str, float]
    """Where the time went: parse, plan, translate, verify, execute."""
    began: float = 0.0
    """When the task began, on the clock of its calls."""

    @property
    def calls(self) -> tuple[CallResult, ...]:
        """What became of the calls of all episodes."""
        return tuple(call for episode in self.episodes for call in episode.result.calls)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Everything that failed in all episodes."""
        return tuple(failure for episode in self.episodes for failure in episode.result.failures)

    @property
    def replans(self) -> int:
        """How many new machines followed the first."""
        return max(0, len(self.episodes) - 1)

    def as_json(self) -> dict[str, Any]:
        """Return the result as `pnm run --json` prints it."""
        return {
            "goal_reached": self.goal_reached,
            "reason": self.reason,
            "plans": self.plans,
            "replans": self.replans,
            "calls": [_call_as_json(call, self.began) for call in self.calls],
            "failures": [
                {"call": str(one.call), "cause": one.cause, "expected": one.expected, "observed": one.observed} for one in self.failures
            ],
            "decisions": [_decision_as_json(episode.decision) for episode in self.episodes if episode.decision],
            "seconds": {name: round(seconds, 6) for name, seconds in self.seconds.items()},
        }


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
    site: Site = Ros2Site(chosen.bindings) if actions == "ros2" else SimulatedSite(loaded, chosen.bindings, faults)
    task = pursue(loaded, site, chosen, observer or TaskObserver(), seconds)
    return run_async(task, virtual=actions == "simulated")


async def pursue(problem: Problem, site: Site, settings: Settings, observer: TaskObserver, seconds: Stopwatch) -> TaskResult:
    """Plan, execute and replan at a site; `achieve` does this with a loop of its own."""
    knowledge = initial_knowledge(problem)
    await site.open(knowledge)
    try:
        return await _Task(problem, site, settings, observer, seconds, knowledge).pursue()
    finally:
        await site.close()


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
    """A goal with its episodes. The mutable state is `episodes`, `history` and `plans`."""

    problem: Problem
    site: Site
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    knowledge: KnowledgeBase
    episodes: list[Episode] = field(default_factory=list)
    history: History = field(default_factory=History)
    plans: int = 0
    began: float = 0.0

    async def pursue(self) -> TaskResult:
        try:
            return await self._pursue()
        except asyncio.CancelledError:  # while no run was there to be stopped
            cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
            return self._ended(False, "cancelled")

    async def _pursue(self) -> TaskResult:
        self.began = began = asyncio.get_running_loop().time()
        graph: PlanGraph | None = None
        forbidden: PlanAgain | None = None
        while True:
            elapsed = asyncio.get_running_loop().time() - began
            if graph is None:
                now = problem_now(self.problem, self.knowledge, elapsed, forbidden.forbidden if forbidden else frozenset())
                found = await self._plan(now)
                if found.plan is None:
                    return self._ended(False, _no_plan(found, forbidden))
                with self.seconds.of("translate"):
                    graph = plan_graph(now, found.plan)
            machine, result = await self._run(graph)
            if result.goal or result.stopped:
                self.episodes.append(Episode(machine, result))
                return self._ended(result.goal, result.reason)
            self.history = self.history.after(result.calls, result.failures)
            elapsed = asyncio.get_running_loop().time() - began
            decision = decide(
                graph, result.calls, self.knowledge, self.history, self.settings.limits, elapsed, timed=bool(self.problem.timed)
            )
            self.episodes.append(Episode(machine, result, decision))
            match decision:
                case GiveUp(reason):
                    return self._ended(False, f"{reason}; last failure: {result.reason}")
                case Resume(rest):
                    graph = rest
                case PlanAgain():
                    graph, forbidden = None, decision
            self.observer.replanning(decision, result)
            await asyncio.sleep(self.history.pause(self.settings.limits))

    async def _plan(self, problem: Problem) -> PlanningResult:
        self.observer.planning(self.settings.planner)
        cancel = threading.Event()
        with self.seconds.of("plan"):
            try:
                found = await asyncio.to_thread(
                    solve, problem, planner=self.settings.planner, timeout=self.settings.planner_timeout, cancel=cancel
                )
            except asyncio.CancelledError:
                cancel.set()
                raise
        if found.plan is not None:
            self.plans += 1
            self.observer.planned(found.plan)
        return found

    async def _run(self, graph: PlanGraph) -> tuple[PetriNetMachine, RunResult]:
        with self.seconds.of("translate"):
            machine = generate(graph, self.settings.bindings, on_failure=self.settings.on_failure)
        with self.seconds.of("verify"):
            proof = verify(machine)
        self.observer.generated(machine, proof)
        await self.site.prepare({call.action: None for call in graph.calls})
        run = Run(
            machine,
            Layered(self.knowledge),
            id=uuid4(),
            bindings=self.settings.bindings,
            goal_fields=self.site.client.goal_fields,
            observer=self.observer,
        )
        with self.seconds.of("execute"):
            return machine, await Executor(run, self.site.client).execute()

    def _ended(self, goal_reached: bool, reason: str) -> TaskResult:
        return TaskResult(goal_reached, reason, self.plans, tuple(self.episodes), self.seconds.seconds, self.began)


def _no_plan(found: PlanningResult, again: PlanAgain | None) -> str:
    without = f" without {', '.join(sorted(map(str, again.forbidden)))}, which failed too often" if again and again.forbidden else ""
    return f"no plan{without}: {found.reason}"


def _call_as_json(result: CallResult, began: float) -> dict[str, Any]:
    return {
        "action": result.call.action.name,
        "arguments": list(result.call.action.arguments),
        "outcome": result.outcome,
        "attempts": result.attempts,
        "started": None if result.started is None else round(result.started - began, 4),
        "ended": None if result.ended is None else round(result.ended - began, 4),
        "assumed": result.assumed,
    }


def _decision_as_json(decision: Resume | PlanAgain | GiveUp) -> dict[str, Any]:
    match decision:
        case Resume(rest):
            return {"decision": "resume", "calls": [str(call.action) for call in rest.calls]}
        case PlanAgain(forbidden, why):
            return {"decision": "plan again", "why": why, "forbidden": sorted(map(str, forbidden))}
        case GiveUp(reason):
            return {"decision": "give up", "why": reason}
