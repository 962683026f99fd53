"""A hand-written plan, from its file to its result: a task manager with one task. What `pnm run --plan` does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pipeline.achieve import Actions, backend_of, readiness_of
from planner_bridge.pipeline.goal_handle import KEPT_NOWHERE, GivenPlan, GoalHandle, TaskJournal
from planner_bridge.tasks.result import PlanResult, Stopwatch
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async
from pnm.core.machine.machine import OnFailure
from pnm.core.readiness import Readiness
from pnm.errors import InputError, Tolerated, check_kinds
from pnm.journal.kept import JournalChoice
from pnm.knowledge.sources import Sources, Surroundings, open_sources
from pnm.language.plan import HandWrittenPlan, called_plans, chosen_plan, merge_bindings, read_plans, sources_of
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Wanted


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
    with suppress(RuntimeError):
        asyncio.get_running_loop()
        raise InputError("an event loop is running here, and this needs one of its own: call it by `await asyncio.to_thread(...)`")
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
