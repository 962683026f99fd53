"""A goal, or a hand-written plan, from its files to its result: a task manager with one task. What `pnm run` does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast
from uuid import uuid4

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.model.world import names_of_world, simulated_backend
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.pipeline.goal_handle import KEPT_NOWHERE, GivenPlan, GoalHandle, TaskJournal
from planner_bridge.pipeline.loading import bindings_for, load
from planner_bridge.tasks.result import PlanResult, Stopwatch, TaskResult
from planner_bridge.tasks.settings import DEFAULTS, Settings, TaskObserver
from pnm.actions.backend import Backend, ClientBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import ActionClient
from pnm.core.readiness import Readiness
from pnm.errors import InputError, Tolerated, check_kinds, suggestion
from pnm.journal.kept import JournalChoice
from pnm.knowledge.sources import Sources, Surroundings, open_sources
from pnm.language.plan import HandWrittenPlan, called_plans, chosen_plan, merge_bindings, read_plans, sources_of
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Wanted

Actions: TypeAlias = Literal["simulated", "ros2"] | ActionClient
"""The performer of actions: simulated robots under virtual time, the action servers of ROS 2, or a client in Python."""


def achieve(
    domain: Path | str | Domain | None,
    problem: Path | str | Problem | Any,
    *,
    actions: Actions = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
    stopwatch: Stopwatch | None = None,
    journal: JournalChoice | Path | str | None = None,
) -> TaskResult:
    """Pursue the goal of the problem until it holds or cannot be reached.

    Args:
        domain: a file or a Domain; not needed when `problem` is a Problem.
        problem: a file, a Problem, or a Problem of unified-planning.
        actions: simulated robots under virtual time, the action servers of ROS 2, or an action client.
        faults: what goes wrong in simulation.
        settings: planner, bindings and limits; without bindings those of ``bindings.yaml`` beside the domain file.
        observer: notified of every event.
        stopwatch: measures the phases; one that has run before goes on.
        journal: the file that the goal is kept in: if the process dies, the next call with the same problem and file goes on.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    _check_no_loop_runs("`await planner_bridge.achieve_async(...)` in place of achieve")
    handle = _goal_handle(domain, problem, actions, faults, settings, observer, stopwatch or Stopwatch(), journal)
    return run_async(handle.run(), virtual=actions == "simulated")


def achieve_async(
    domain: Path | str | Domain | None,
    problem: Path | str | Problem | Any,
    *,
    actions: Actions = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
) -> GoalHandle:
    """Begin to pursue the goal of the problem on the event loop that runs here, in a notebook or a program of one's own.

    The arguments are those of `achieve`, simulated robots take their time, and the result is awaited: `await achieve_async(...)`.

    Raises:
        InputError: an input is wrong, or no event loop is running; nothing was started.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError as error:
        raise InputError("no event loop is running here: call `achieve`, which has one of its own") from error
    return _goal_handle(domain, problem, actions, faults, settings, observer, Stopwatch()).begin()


def _check_no_loop_runs(instead: str) -> None:
    with suppress(RuntimeError):
        asyncio.get_running_loop()
        raise InputError(f"an event loop is running here: {instead}")


def _goal_handle(
    domain: Path | str | Domain | None,
    problem: Path | str | Problem | Any,
    actions: Actions,
    faults: Faults,
    settings: Settings | None,
    observer: TaskObserver | None,
    stopwatch: Stopwatch,
    journal: JournalChoice | Path | str | None = None,
) -> GoalHandle:
    settings, observer = settings or Settings(), observer or TaskObserver()
    check_kinds("achieve", {"settings": (settings, Settings), "observer": (observer, TaskObserver), "faults": (faults, Faults)})
    with stopwatch.of("parse"):
        loaded = load(domain, problem)
        if settings.bindings == DEFAULTS.bindings and isinstance(domain, Path | str):
            settings = replace(settings, bindings=bindings_for(Path(domain), None, loaded.vocabulary))
    for name in sorted(settings.bindings.actions.keys() - loaded.domain.actions.keys()):
        hint = suggestion(name, loaded.domain.actions)
        raise InputError(f"there is no action {name!r} in the domain, but the bindings name it{hint and f'; {hint}'}")
    kept = TaskJournal.of(journal, write_domain(loaded.domain), write_problem(loaded)) if journal else KEPT_NOWHERE
    return GoalHandle(backend_of(actions, loaded, settings, faults), loaded, settings, observer, stopwatch, kept)


async def achieve_at(backend: Backend, problem: Problem, settings: Settings, observer: TaskObserver) -> TaskResult:
    """Pursue the goal of a problem on a backend; `achieve` does this with an event loop of its own.

    Cancelling this stops the task: what is under way is cancelled and waited for; cancelling it again leaves it alone.
    """
    return await GoalHandle(backend, problem, settings, observer, Stopwatch()).run()


def readiness(problem: Problem, settings: Settings, wait: float = 0.0) -> tuple[Readiness, ...]:
    """Return the readiness of the action servers and sensors for a problem in the ROS graph; `wait` gives them seconds to appear."""
    backend = backend_of("ros2", problem, settings, NO_FAULTS)
    return run_async(readiness_of(backend, initial_knowledge(problem), (), wait))


async def readiness_of(backend: Backend, world: KnowledgeBase, actions: Iterable[GroundAction], wait: float) -> tuple[Readiness, ...]:
    """Return how ready a backend is for actions in a world; `wait` seconds are given to what is missing to appear."""
    try:
        await backend.open(world)
        return await backend.check(actions, wait)
    finally:
        await backend.close()


def backend_of(
    actions: Actions, described: Problem | HandWrittenPlan, settings: Settings, faults: Faults, plans: tuple[HandWrittenPlan, ...] = ()
) -> Backend:
    """Return the backend of a problem or a plan, which may call the others; raise an `InputError` if it would ignore faults or sensors."""
    if faults != NO_FAULTS and actions != "simulated":
        raise InputError("faults belong to simulated robots; expected none with other actions")
    if settings.sim_time and actions != "ros2":
        raise InputError("simulation time comes from ROS 2; expected actions 'ros2'")
    if settings.sensing != DEFAULTS.sensing and actions != "ros2":
        raise InputError("sensing is about topics and services of ROS 2; expected actions 'ros2'")
    match actions:
        case "simulated":
            return simulated_backend(described, settings.bindings, faults)
        case "ros2":
            from pnm.ros.backend import Ros2Backend  # here, because loading ROS 2 takes as long as a simulated run

            names = names_of_world(described if isinstance(described, Problem) else None, plans)
            return Ros2Backend(settings.bindings, settings.sensing, names, sim_time=settings.sim_time)
        case ActionClient() if not isinstance(actions, type):
            return ClientBackend(actions)
        case _:
            hint = suggestion(actions, ("simulated", "ros2")) if isinstance(actions, str) else ""
            raise InputError(f"expected actions 'simulated', 'ros2' or an ActionClient, found {actions!r}{hint and f'; {hint}'}")


# --- hand-written plans ---------------------------------------------------------------------------
# What `pnm run --plan` does.


def readiness_for_plan(
    file: Path, name: str | None, settings: Settings, wait: float = 0.0, parameters: Mapping[str, object] | None = None
) -> tuple[Readiness, ...]:
    """Return the readiness of the action servers and sensors for a hand-written plan and the plans it calls; see `readiness`."""
    plans = {plan: _with_settings(described, settings, None) for plan, described in read_plans(file).items()}
    chosen = chosen_plan(plans, name)
    bound = replace(settings, bindings=merge_bindings(plans.values()))
    backend, world = backend_of("ros2", plans[chosen], bound, NO_FAULTS, tuple(plans.values())), initial_knowledge(plans[chosen])
    programs = {called: Program.of(plans[called]) for called in called_plans(plans, chosen)}
    return run_async(readiness_of(backend, world, PlanRunner(programs, backend, world).actions_with(chosen, parameters or {}), wait))


def carry_out(
    file: Path,
    name: str | None = None,
    parameters: Mapping[str, object] | None = None,
    *,
    actions: Actions = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
    on_failure: OnFailure | None = None,
    knowledge: Path | None = None,
    answers: Iterable[tuple[str, object]] = (),
    warn: Callable[[Iterable[Tolerated]], None] | None = None,
    journal: JournalChoice | Path | str | None = None,
) -> PlanResult:
    """Carry out a hand-written plan of a file.

    Args:
        file: a plan file of the language.
        name: of the plan, if there are several.
        parameters: variables that the run knows from the beginning.
        actions: simulated robots under virtual time, the action servers of ROS 2, or an action client.
        faults: what goes wrong in simulation.
        settings: bindings that come before those of the files, limits, and the planner, for when the plan asks for one.
        observer: notified of every event.
        on_failure: what running actions do when one has failed, in place of the plans' own policy.
        knowledge: the file in which global knowledge is kept, in place of what the plan chose.
        answers: names of questions and what people would answer, who are not asked then.
        warn: called with the warnings about the files.
        journal: the file that the run is kept in: if the process dies, the next call with the same plan and file goes on.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    _check_no_loop_runs("call carry_out by `await asyncio.to_thread(...)`")
    settings, observer, stopwatch = settings or Settings(), observer or TaskObserver(), Stopwatch()
    check_kinds("carry_out", {"settings": (settings, Settings), "observer": (observer, TaskObserver), "faults": (faults, Faults)})
    with stopwatch.of("parse"):
        plans = {name: _with_settings(plan, settings, on_failure) for name, plan in read_plans(file).items()}
        chosen = chosen_plan(plans, name)
    if warn:
        warn(plans[chosen].warnings)
    with stopwatch.of("translate"):
        programs = {name: Program.of(plans[name]) for name in called_plans(plans, chosen)}
    bound = replace(settings, bindings=merge_bindings(plans.values()))
    backend = backend_of(actions, plans[chosen], bound, faults, tuple(plans.values()))
    wanted = Wanted(uuid4(), chosen, parameters=parameters or {}, is_plan=True)
    origin = file.read_text(encoding="utf-8"), chosen, repr(sorted(wanted.parameters.items()))
    kept = TaskJournal.of(journal, *origin) if journal else KEPT_NOWHERE

    def opened(ros: Any) -> Sources:
        return open_sources(sources_of(plans.values()), Surroundings(ros, file.parent, tuple(answers)), knowledge)

    plan, nothing = GivenPlan(programs, wanted, opened), Problem(chosen, Domain(chosen))
    handle = GoalHandle(backend, nothing, bound, observer, stopwatch, kept, plan)
    return cast("PlanResult", run_async(handle.run(), virtual=actions == "simulated"))


def _with_settings(plan: HandWrittenPlan, settings: Settings, on_failure: OnFailure | None) -> HandWrittenPlan:
    """Return the plan with settings that come before its own; of two time limits the shorter one counts."""
    limits = [limit for limit in (plan.timeout, settings.limits.seconds) if limit is not None]
    bindings = settings.bindings.before(plan.bindings)
    return replace(plan, bindings=bindings, timeout=min(limits, default=None), on_failure=on_failure or plan.on_failure)
