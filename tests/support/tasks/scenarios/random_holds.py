"""Random tasks whose plans are looked at again all the time, while calls fail, facts change, and people pause, resume and cancel.

A run is held meanwhile. That takes a moment of virtual time at each of its points, at which all of this may happen.
"""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from pathlib import Path

from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.machine.machine import OnFailure
from pnm.tasks import Code, TaskRefused, TraceEvent
from tests.support.tasks.scenarios.random_scenarios import People, Scenario, Tell, check_end, draw
from tests.support.tasks.scenarios.slow_work import SlowLoop, seconds_of, slow_backend
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks


def run_holds(number: int, tell: Tell = lambda text: None, journal: Path | None = None) -> list[TraceEvent]:
    """Run the script of this number to its end; return what has happened to its tasks."""
    rng = random.Random(f"{number}/holds")
    scenario = held(rng, draw(rng))
    seconds = seconds_of(random.Random(f"{number}/seconds"))
    happened: list[TraceEvent] = []

    async def course(simulation: TaskSimulation) -> None:
        people = People(scenario, simulation, rng, tell)
        for _ in range(rng.choice([1, 1, 2])):
            goals = {scenario.world.goal(rng) for _ in range(rng.choice([1, 2, 3]))}
            people.tasks.append(simulation.want(f"(and {' '.join(sorted(goals))})", priority=rng.choice([0, 0, 1])))
        await meddle(people, rng)
        await simulation.master.resume(None)
        codes = await simulation.ended_with(*people.tasks)
        for task in people.tasks:
            check_end(simulation, task)
        happened.extend(simulation.moments)
        assert Code.PLANNER_ERROR not in codes, "what is found can be carried out"

    simulate_tasks(
        course,
        scenario.world.problem,
        faults=scenario.faults,
        chosen=scenario.settings,
        limits=scenario.limits,
        programs=scenario.programs,
        source=scenario.person,
        make_backend=slow_backend(seconds),
        journal=journal,
        loop=lambda: SlowLoop(seconds),
    )
    return happened


def held(rng: random.Random, scenario: Scenario) -> Scenario:
    """Return a scenario in which more is tried again, fails, and changes."""
    bindings = scenario.settings.bindings
    retried = {name: replace(binding, retries=rng.choice([0, 1, 2, 3])) for name, binding in bindings.actions.items()}
    settings = replace(
        scenario.settings,
        improve=0.0,
        bindings=replace(bindings, actions=retried),
        on_change=rng.choice([OnChange.EAGER, OnChange.EAGER, OnChange.EAGER, OnChange.LAZY]),
        on_failure=rng.choice([OnFailure.CONTINUE_OTHERS, OnFailure.CONTINUE_OTHERS, OnFailure.CONTINUE_OTHERS, *OnFailure]),
        limits=Limits(seconds=2000.0, replans=rng.choice([3, 10]), forbid_after=rng.choice([1, 2, 5])),
    )
    kinds = [FaultKind.ABORT, FaultKind.ABORT, FaultKind.ABORT, FaultKind.NO_EFFECT, FaultKind.REJECT]
    faults = tuple(
        Fault(name, rng.choice(kinds), after=rng.randrange(3), times=rng.choice([1, 2, 3, 6]))
        for name in scenario.world.problem.domain.actions
        if rng.random() < 0.7
    )
    changes = tuple(HiddenChange(scenario.world.change(rng), at=rng.uniform(0.0, 30.0)) for _ in range(rng.randrange(16)))
    return replace(scenario, settings=settings, faults=Faults(faults, changes))


async def meddle(people: People, rng: random.Random) -> None:
    """Change facts, and pause, resume and cancel tasks."""
    for _ in range(rng.randrange(8)):
        await asyncio.sleep(rng.uniform(0.0, 4.0))
        going_on = [task for task in people.tasks if task not in people.simulation.endings]
        chosen = rng.choice([None, *going_on])
        try:
            match rng.choice(["change", "change", "change", "pause", "resume", "cancel"]):
                case "change":
                    people.change()
                case "pause":
                    await people.pause(chosen, going_on)
                case "resume":
                    await people.resume(chosen)
                case "cancel" if chosen and rng.random() < 0.3:
                    await people.cancel(chosen)
        except TaskRefused as refused:
            people.tell(f"refused: {refused}")
