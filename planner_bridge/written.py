"""`pnm run --plan`: a hand-written plan, carried out on simulated robots or through ROS 2."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from planner_bridge.pipeline import Stopwatch, Where
from planner_bridge.tasks import Episode, TaskObserver, TaskResult
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated import SimulatedRobots
from pnm.actions.world import World
from pnm.bindings import Bindings
from pnm.clock import run_async
from pnm.effects import names_written
from pnm.errors import InputError
from pnm.knowledge import KnowledgeBase
from pnm.language.plan import HandWrittenPlan, read_plans
from pnm.performing import Performer, Program
from pnm.sites import RobotsSite, Ros2Site, Site
from pnm.sources.chain import Sources
from pnm.sources.registry import Choice, Surroundings, open_sources


@dataclass(frozen=True)
class PlanResult:
    """How a hand-written plan ended, what it gives back, and all that its run then knew by itself."""

    task: TaskResult
    results: Mapping[str, object] = field(default_factory=dict)
    variables: Mapping[str, object] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """Return the result as `pnm run --json` prints it."""
        return {**self.task.as_json(), "results": dict(self.results), "variables": dict(self.variables)}


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
    observer: TaskObserver | None = None,
    knowledge: Path | None = None,
) -> PlanResult:
    """Carry out a plan of a file.

    Args:
        file: a plan file of the language.
        name: of the plan, if there are several.
        parameters: variables that the run knows from the beginning.
        actions: simulated robots under virtual time, or the action servers of ROS 2.
        faults: what goes wrong in simulation.
        observer: is told what happens.
        knowledge: the file in which global knowledge is kept, in place of what the plan chose.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    seconds = Stopwatch()
    with seconds.of("parse"):
        plans = read_plans(file)
        chosen = chosen_plan(plans, name)
    with seconds.of("translate"):
        programs = {name: Program.of(plans[name]) for name in calling(plans, chosen)}
    bindings = together(plans.values())
    site: Site = Ros2Site(bindings) if actions == "ros2" else simulated_site(plans[chosen], bindings, faults)

    def sources() -> Sources:
        return open_sources(sources_of(plans.values()), Surroundings(getattr(site, "ros", None), file.parent), knowledge)

    performing = _perform(programs, chosen, parameters or {}, site, observer or TaskObserver(), seconds, sources)
    return run_async(performing, virtual=actions == "simulated")


async def _perform(
    programs: Mapping[str, Program],
    name: str,
    parameters: Mapping[str, object],
    site: Site,
    observer: TaskObserver,
    seconds: Stopwatch,
    opened: Callable[[], Sources],
) -> PlanResult:
    program = programs[name]
    plan = program.plan
    world = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    began = asyncio.get_running_loop().time()
    try:
        await site.open(world)
        sources = opened()
        try:
            performer = Performer(programs, site, world, sources)
            performance = performer.perform(name, parameters, observer)
            observer.generated(program.machine, program.proof)
            await performer.prepare()
            with seconds.of("execute"):
                result = await performer.execute(performance)
        finally:
            await sources.close()
    finally:
        await site.close()
    task = TaskResult(result.goal, result.reason, 0, (Episode(program.machine, result),), seconds.seconds, began)
    return PlanResult(task, performance.results, performance.variables)


def together(plans: Iterable[HandWrittenPlan]) -> Bindings:
    """Return the bindings of all plans, which are those of their domains."""
    return Bindings({name: binding for plan in plans for name, binding in plan.bindings.actions.items()})


def sources_of(plans: Iterable[HandWrittenPlan]) -> tuple[Choice, ...]:
    """Return the sources of knowledge that any of the plans chose, each once."""
    found: dict[str, Choice] = {}
    for choice in (choice for plan in plans for choice in plan.sources):
        found.setdefault(f"{choice.name} {choice.options}", choice)
    return tuple(found.values())


def simulated_site(plan: HandWrittenPlan, bindings: Bindings, faults: Faults = NO_FAULTS) -> RobotsSite:
    """Return simulated robots in a world that starts as the plan says."""
    calls = plan.graph.calls
    written = (names_written((*call.action.start_effects, *call.action.end_effects)) for call in calls)
    changes = (*(change.changes for change in plan.timed), *(change.changes for change in faults.changes))
    timed = (frozenset(fluent[0] for fluent in change) for change in changes)
    truth = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    is_timed = bool(plan.timed) or any(call.action.duration is not None for call in calls)
    world = World(truth, frozenset().union(*written, *timed))
    return RobotsSite(SimulatedRobots(world, faults, bindings, plan.timed, 0.0 if is_timed else 1.0), bindings.assumed)
