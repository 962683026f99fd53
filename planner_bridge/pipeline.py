"""A goal or a hand-written plan, from its files to its result: a task manager with one task."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast
from uuid import uuid4

from planner_bridge.loading import load
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.result import PlanResult, Stopwatch, TaskResult
from planner_bridge.tasks.scheduling.task_manager import TaskManager
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import Backend, schedule
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async
from pnm.core.logic.conditions import Condition
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError, Tolerated
from pnm.knowledge.sources.registry import Surroundings, open_sources
from pnm.knowledge.sources.router import Sources
from pnm.language.plan import HandWrittenPlan, called_plans, chosen_plan, merge_bindings, read_plans, sources_of
from pnm.language.runner import PlanRunner, Program
from pnm.ros.backend import Ros2Backend
from pnm.tasks import Code, Wanted

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
        observer: notified of every event.
        stopwatch: measures the phases; one that has run before goes on.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    chosen = settings or Settings()
    seconds = stopwatch or Stopwatch()
    with seconds.of("parse"):
        loaded = load(domain, problem)
    backend: Backend = (
        Ros2Backend(chosen.bindings, sensing=chosen.sensing) if actions == "ros2" else simulated_backend(loaded, chosen.bindings, faults)
    )
    task = achieve_at(backend, loaded, chosen, observer or TaskObserver(), seconds)
    return run_async(task, virtual=actions == "simulated")


async def achieve_at(
    backend: Backend, problem: Problem, settings: Settings, observer: TaskObserver | None = None, stopwatch: Stopwatch | None = None
) -> TaskResult:
    """Pursue the goal of a problem on a backend; `achieve` does this with an event loop of its own.

    Cancelling this stops the task: what is under way is cancelled and waited for; cancelling it again leaves it alone.
    """
    stopwatch, knowledge = stopwatch or Stopwatch(), initial_knowledge(problem)
    try:
        try:
            await backend.open(knowledge)
        except asyncio.CancelledError:
            cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
            return TaskResult(Code.CANCELLED, "cancelled", 0, (), stopwatch.seconds)
        manager = TaskManager(problem, knowledge, backend, settings, lambda _: problem.goal)
        return await manager.run(Wanted(uuid4(), ""), observer or TaskObserver(), stopwatch)
    finally:
        await backend.close()


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
    """Carry out a hand-written plan of a file.

    Args:
        file: a plan file of the language.
        name: of the plan, if there are several.
        parameters: variables that the run knows from the beginning.
        actions: simulated robots under virtual time, or the action servers of ROS 2.
        faults: what goes wrong in simulation.
        settings: bindings that come before those of the files, limits, and the planner, for when the plan asks for one.
        observer: notified of every event.
        on_failure: what running actions do when one has failed, in place of the plans' own policy.
        knowledge: the file in which global knowledge is kept, in place of what the plan chose.
        warn: called with the warnings about the files.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    stopwatch = Stopwatch()
    with stopwatch.of("parse"):
        settings = settings or Settings()
        plans = {name: _with_settings(plan, settings, on_failure) for name, plan in read_plans(file).items()}
        chosen = chosen_plan(plans, name)
    if warn:
        warn(plans[chosen].warnings)
    with stopwatch.of("translate"):
        programs = {name: Program.of(plans[name]) for name in called_plans(plans, chosen)}
    bindings = merge_bindings(plans.values())
    backend: Backend = (
        Ros2Backend(bindings, sensing=settings.sensing) if actions == "ros2" else simulated_backend(plans[chosen], bindings, faults)
    )

    async def task() -> PlanResult:
        plan = plans[chosen]
        world = initial_knowledge(plan)
        try:
            await backend.open(world)
            sources = open_sources(sources_of(plans.values()), Surroundings(getattr(backend, "ros", None), file.parent), knowledge)
            try:
                runner = PlanRunner(programs, backend, world, sources)
                wanted = Wanted(uuid4(), chosen, parameters=parameters or {}, is_plan=True)
                return await _carry_out_at(runner, wanted, replace(settings, bindings=bindings), observer or TaskObserver(), stopwatch)
            finally:
                await sources.close()
        finally:
            await backend.close()

    return run_async(task(), virtual=actions == "simulated")


async def _carry_out_at(runner: PlanRunner, wanted: Wanted, settings: Settings, observer: TaskObserver, stopwatch: Stopwatch) -> PlanResult:
    await runner.check(runner.prepare_run(wanted.text, wanted.parameters))  # before anything is prepared
    await runner.backend.share(runner.prefix, runner.knowledge_of, runner.source or Sources())
    await runner.prepare()
    nothing = Problem(wanted.text, Domain(wanted.text))
    manager = TaskManager(nothing, runner.world, runner.backend, settings, _no_goal, source=runner.source, runner=runner)
    stop_time = schedule(runner.world, runner.programs[wanted.text].plan.timed, asyncio.get_running_loop().time())
    try:
        return cast("PlanResult", await manager.run(wanted, observer, stopwatch))
    finally:
        stop_time()


def _no_goal(text: str) -> Condition:
    raise InputError(f"there are no goals here: {text}")


def _with_settings(plan: HandWrittenPlan, settings: Settings, on_failure: OnFailure | None) -> HandWrittenPlan:
    """Return the plan with settings that come before its own; of two time limits the shorter one counts."""
    limits = [limit for limit in (plan.timeout, settings.limits.seconds) if limit is not None]
    bindings = settings.bindings.before(plan.bindings)
    return replace(plan, bindings=bindings, timeout=min(limits, default=None), on_failure=on_failure or plan.on_failure)
