"""A plan that is carried out as it is written, as a task among others.

`pnm run --plan`: a hand-written plan, carried out on simulated robots or through ROS 2.

A recovery may end with `replan`: the plan has failed then, and a planner finds the way to its goal from there.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from math import isfinite
from pathlib import Path

from planner_bridge.model.forbidden_actions import ForbiddenCall
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.interference import Footprint, footprint
from planner_bridge.pipeline import Where, pursue_on
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.control import Over, Standing
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.result import Episode, Stopwatch, TaskResult, code_of_run
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task import Task
from planner_bridge.yaml.reader import read
from pnm.actions.backend import Backend, schedule
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import Unknown
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import CallOutcome, OnFailure
from pnm.core.machine.plan_graph import ActionCall, Cause
from pnm.errors import InputError, Tolerated
from pnm.knowledge.sources.registry import Choice, Surroundings, open_sources
from pnm.knowledge.sources.router import Sources
from pnm.language.plan import HandWrittenPlan, read_plans
from pnm.language.runner import Performance, Performer, Program
from pnm.ros.backend import Ros2Backend
from pnm.tasks import Code, TaskEnding, TaskState


class Recital:
    """One run of a hand-written plan.

    When it is paused at once, a plan that it calls is cancelled and begins anew later.

    Args:
        performer: carries out the plan.
        task: what is told how it goes.

    Raises:
        InputError: there is no such plan, or it has no such parameter.
    """

    def __init__(self, performer: Performer, task: Task) -> None:
        wanted = task.wanted
        self._performer = performer
        self._task = task
        self._performance: Performance = performer.perform(wanted.text, wanted.parameters, task, task=wanted.id, priority=wanted.priority)
        self._standing = Standing(task, TaskState.RUNNING)

    async def perform(self) -> TaskEnding:
        """Carry the plan out and return how it ended."""
        program = self._performance.program
        try:
            await self._performer.check(self._performance)
        except InputError as error:
            return TaskEnding(Code.INVALID_GOAL, str(error))
        self._task.generated(program.machine, program.proof)
        self._standing.enter(TaskState.RUNNING)
        return self._ending(await self._performer.execute(self._performance))

    @property
    def run(self) -> Run:
        """The run of the plan."""
        return self._performance.executor.run

    @property
    def running(self) -> tuple[str, ...]:
        """The calls that are under way, those in plans that it calls as well."""
        return self._performance.running

    @property
    def footprint(self) -> Footprint:
        """What the plan needs and changes: all that it may still reach."""
        plan = self._performance.program.plan.graph
        is_flat = len(plan.every_step) == len(plan.calls)
        over = {one.call.index for one in self.run.interim_result().calls if one.ended is not None} if is_flat else set()
        calls = [call for call in plan.calls if call.index not in over]
        return footprint(calls, plan.goal, self._performer.world)

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return self._standing.is_paused

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._performance.awaits_answers

    def stop(self, code: Code, reason: str) -> None:
        """End it; what is under way is cancelled, and confirms it or is given up after its limit."""
        if self._standing.stop(Over(code, reason)):
            self._standing.enter(TaskState.CANCELLING, reason)
            self._performance.executor.stop(reason=reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way."""
        if not self._standing.stopped:
            self._performance.limit.pause()
        await self._standing.pause(reason, self._performance.executor, at_once=at_once)

    def resume(self) -> None:
        """Go on."""
        if self.is_paused:
            self._performance.limit.go_on()
            self._standing.go_on()
            self._performance.executor.resume()

    def _ending(self, result: RunResult) -> TaskEnding:
        over = self._standing.stopped or Over(Code.TIMED_OUT, result.reason)  # who else stops it is its own limit
        reason = over.reason if result.stopped and not result.goal else result.reason
        cause = "" if result.goal or result.stopped else result.failures[0].cause if result.failures else Cause.GOAL_FALSE
        return TaskEnding(code_of_run(result, over.code), reason, results=self._performance.results, cause=cause)


@dataclass(frozen=True)
class PlanResult:
    """How a hand-written plan ended, what it gives back, and all that its run then knew by itself."""

    task: TaskResult
    results: Mapping[str, object] = field(default_factory=dict)
    variables: Mapping[str, object] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """Return the result as `pnm run --json` prints it."""
        return {**self.task.as_json(), "results": _sayable(dict(self.results)), "variables": _sayable(dict(self.variables))}


def _sayable(value: object) -> object:
    """Return the value as JSON can say it: there is no NaN, and no infinity, but servers may answer with them."""
    match value:
        case float() if not isfinite(value):
            return str(value)
        case dict():
            return {name: _sayable(one) for name, one in value.items()}
        case list() | tuple():
            return [_sayable(one) for one in value]
        case _:
            return value


def chosen_plan(plans: Mapping[str, HandWrittenPlan], name: str | None) -> str:
    """Return the name of the plan that is meant: the only one that no other calls, if none is named.

    Raises:
        InputError: there is no such plan, or none is named and there are several.
    """
    called = frozenset(other for plan in plans.values() for other in plan.calls)
    candidates = [one for one in plans if one not in called] if name is None else [name]
    if len(candidates) != 1 or candidates[0] not in plans:
        asked = "there are several plans" if name is None else f"there is no plan {name!r}"
        raise InputError(f"{asked}; expected --name and one of {', '.join(plans)}")
    return candidates[0]


def calling(plans: Mapping[str, HandWrittenPlan], name: str) -> tuple[str, ...]:
    """Return the name of a plan and of all that it calls, or that these call."""
    found = [name]
    for one in found:
        found += [other for other in sorted(plans[one].calls) if other not in found]
    return tuple(found)


def carry_out(
    file: Path,
    name: str | None = None,
    parameters: Mapping[str, object] | None = None,
    *,
    actions: Where = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
    on_failure: OnFailure | None = None,
    knowledge: Path | None = None,
    warn: Callable[[Iterable[Tolerated]], None] | None = None,
) -> PlanResult:
    """Carry out a plan of a file.

    Args:
        file: a plan file of the language.
        name: of the plan, if there are several.
        parameters: variables that the run knows from the beginning.
        actions: simulated robots under virtual time, or the action servers of ROS 2.
        faults: what goes wrong in simulation.
        settings: bindings that come before those of the files, limits, and the planner, for when the plan asks for one.
        observer: is told what happens.
        on_failure: what running actions do when one has failed, in place of what the plans say.
        knowledge: the file in which global knowledge is kept, in place of what the plan chose.
        warn: is told what in the files was not as it should be.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    seconds = Stopwatch()
    with seconds.of("parse"):
        settings = settings or Settings()
        plans = {name: _settled(plan, settings, on_failure) for name, plan in read_plans(file).items()}
        chosen = chosen_plan(plans, name)
    if warn:
        warn(plans[chosen].warnings)
    with seconds.of("translate"):
        programs = {name: Program.of(plans[name]) for name in calling(plans, chosen)}
    bindings = merge_bindings(plans.values())
    site: Backend = (
        Ros2Backend(bindings, sensing=settings.sensing) if actions == "ros2" else simulated_backend(plans[chosen], bindings, faults)
    )
    choices = sources_of(plans.values())
    task = _WrittenTask(
        programs,
        chosen,
        site,
        replace(settings, bindings=bindings),
        observer or TaskObserver(),
        seconds,
        lambda: open_sources(choices, Surroundings(getattr(site, "ros", None), file.parent), knowledge),
    )
    return run_async(task.perform(parameters or {}), virtual=actions == "simulated")


def _settled(plan: HandWrittenPlan, settings: Settings, on_failure: OnFailure | None) -> HandWrittenPlan:
    """Return the plan with what is said besides its files; of two limits of time the shorter one counts."""
    limits = [limit for limit in (plan.timeout, settings.limits.seconds) if limit is not None]
    bindings = settings.bindings.before(plan.bindings)
    return replace(plan, bindings=bindings, timeout=min(limits, default=None), on_failure=on_failure or plan.on_failure)


@dataclass(frozen=True)
class _WrittenTask:
    """A plan, and what it is carried out with."""

    programs: Mapping[str, Program]
    name: str
    site: Backend
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    open_sources: Callable[[], Sources]
    """Who is asked what the run does not know; called once the site is open."""

    @property
    def _program(self) -> Program:
        return self.programs[self.name]

    async def perform(self, parameters: Mapping[str, object]) -> PlanResult:
        plan = self._program.plan
        world = initial_knowledge(plan)
        try:
            await self.site.open(world)
            sources = self.open_sources()
            try:
                return await self._perform(Performer(self.programs, self.site, world, sources), parameters)
            finally:
                await sources.close()
        finally:
            await self.site.close()

    async def _perform(self, performer: Performer, parameters: Mapping[str, object]) -> PlanResult:
        performance = performer.perform(self.name, parameters, self.observer)
        await performer.check(performance)
        self.observer.generated(self._program.machine, self._program.proof)
        await self.site.share(performer.prefix, performer.knowledge_of, performer.source or Sources())
        await performer.prepare()
        began = asyncio.get_running_loop().time()
        stop_time = schedule(performer.world, self._program.plan.timed, began)
        try:
            with self.seconds.of("execute"):
                result = await performer.execute(performance)
        finally:
            stop_time()
        code = code_of_run(result, Code.TIMED_OUT if performance.limit.is_used_up else Code.CANCELLED)
        task = TaskResult(code, result.reason, 0, (Episode(self._program.machine, result),), self.seconds.seconds, began)
        if any(failure.replan for failure in result.failures):
            task = await self._replanned(task, performer.world)
        return PlanResult(task, performance.results, performance.variables)

    async def _replanned(self, task: TaskResult, world: KnowledgeBase) -> TaskResult:
        """Have a planner find the rest of the way from the world as it is now."""
        self.observer.resigned(task.reason)
        try:
            problem = problem_of(self._program.plan, world)
        except InputError as error:
            return replace(task, reason=f"{task.reason}; no planner can be asked: {error}")
        calls = [failure.call for failure in task.failures if failure.replan and isinstance(failure.call, ActionCall)]
        given_up = {ForbiddenCall.of(call.action): self.settings.limits.forbid_after for call in calls}
        unconfirmed = (one.call.action for one in task.calls if one.kind is CallOutcome.UNCONFIRMED)
        history = History(given_up, frozenset(map(ForbiddenCall.of, unconfirmed)))
        rest = await pursue_on(problem, self.site, self.settings, self.observer, self.seconds, knowledge=world, history=history)
        return replace(rest, episodes=(*task.episodes, *rest.episodes), began=task.began)


def problem_of(plan: HandWrittenPlan, world: KnowledgeBase) -> Problem:
    """Return the problem of reaching the plan's goal from the world as it is.

    Raises:
        InputError: the plan has no goal, or its domain says what PDDL cannot.
    """
    if plan.goal == TRUE:
        raise InputError(f"the plan {plan.name} has no goal")
    if not plan.domain_file:
        raise InputError(f"the plan {plan.name} has no domain")
    contents = read(Path(plan.domain_file))
    described = contents.problem or Problem(plan.name, contents.domain)
    init = {fluent: value for fluent, value in world.facts().items() if not isinstance(value, Unknown)}
    return replace(described, init=init, timed=(), goal=plan.goal)


def merge_bindings(plans: Iterable[HandWrittenPlan]) -> Bindings:
    """Return the bindings of all plans, which are those of their domains."""
    return reduce(Bindings.before, (plan.bindings for plan in plans), Bindings())


def sources_of(plans: Iterable[HandWrittenPlan]) -> tuple[Choice, ...]:
    """Return the sources of knowledge that any of the plans chose, each once."""
    found: dict[str, Choice] = {}
    for choice in (choice for plan in plans for choice in plan.sources):
        found.setdefault(f"{choice.name} {choice.options}", choice)
    return tuple(found.values())
