"""Random scenarios: what people do to many tasks while things go wrong.

A scenario is drawn from a number: the world and the faults at once, what people do while they do it. The rules are checked after
each pause and each cancellation, and at the end; the simulation itself checks its own all the time.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias
from uuid import UUID

from planner_bridge.model.plan import read_plan
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.tasks.task_manager import TaskLimits
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.logic.computed_values import MISSING, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.knowledge.source import Asker, SourceError
from pnm.language.plan import HandWrittenPlan
from pnm.language.runner import Program
from pnm.tasks import Code, OnConflict, TaskRefused, TaskState
from tests.support.tasks.scenarios.scenario_worlds import ScenarioWorld, scenario_worlds, uncertain
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

Tell: TypeAlias = Callable[[str], None]

_PATIENCE: Final = 5000.0
"""Virtual seconds within which a pause, or a cancellation, must be over."""
_OFTEN: Final = 12
"""Whoever makes way for others more often than that does nothing else."""


def run_scenario(
    number: int, tell: Tell = lambda text: None, journal: Path | None = None, end: Callable[[TaskSimulation], None] = lambda end: None
) -> Counter[Code]:
    """Run the scenario of this number to its end, and look at what is left then; return how many tasks have ended how.

    In two of five scenarios no binding says what robots have for themselves: there only facts keep two tasks from commanding one robot.
    """
    rng = random.Random(number)
    scenario = draw(rng, is_exclusive=number % 5 not in (2, 3))
    codes: Counter[Code] = Counter()

    async def course(simulation: TaskSimulation) -> None:
        people = People(scenario, simulation, rng, tell)
        people.begin()
        if rng.random() < 0.15:
            await people.interfere()
            tell("close")
            return
        await asyncio.gather(people.interfere(), people.interfere())
        tell("resume all")
        await simulation.master.resume(None)
        codes.update(await simulation.ended_with(*people.tasks))
        for task in people.tasks:
            ending = simulation.endings[task]
            tell(f"{ending.code.word}: {simulation.goals[task]!r}: {ending.message}")
            check_end(simulation, task)
        end(simulation)

    simulate_tasks(
        course,
        scenario.world.problem,
        faults=scenario.faults,
        chosen=scenario.settings,
        limits=scenario.limits,
        programs=scenario.programs,
        source=scenario.person,
        journal=journal,
    )
    return codes


# --- a scenario -----------------------------------------------------------------------------------


class RandomPerson:
    """Answers what it is asked after a while, or not at all."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    async def query(self, question: Question, asker: Asker, /) -> object:
        if question.name != "word":
            return MISSING
        kind = self._rng.random()
        await asyncio.sleep(self._rng.choice([0.0, 1.0, 7.0, 30.0]) if kind < 0.8 else 61.0)
        if kind > 0.9:
            raise SourceError("nobody has answered")
        return "please"

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        await asyncio.sleep(self._rng.choice([0.0, 1.0]))

    async def close(self) -> None:
        pass


@dataclass(frozen=True)
class Scenario:
    """A world, who acts in it and how, and what goes wrong by itself."""

    world: ScenarioWorld
    settings: Settings
    programs: Mapping[str, Program]
    limits: TaskLimits
    faults: Faults
    person: RandomPerson | None


def draw(rng: random.Random, *, is_exclusive: bool = True) -> Scenario:
    """Draw all of a script but what people do."""
    world = rng.choice(scenario_worlds())
    world = world if is_exclusive else replace(world, resources={})
    if copy(rng).random() < 0.2:  # so that the others are drawn as if there were none of these
        world = uncertain(world)
    asks = rng.random() < 0.3
    settings = Settings(
        bindings=_bindings(rng, world, asks=asks),
        on_change=rng.choice([OnChange.EAGER, OnChange.EAGER, OnChange.LAZY]),
        on_failure=rng.choice([OnFailure.CONTINUE_OTHERS, OnFailure.CONTINUE_OTHERS, OnFailure.DRAIN, OnFailure.CANCEL]),
        limits=Limits(seconds=2000.0, forbid_after=rng.choice([1, 2])),
    )
    return Scenario(
        world,
        settings,
        programs=_programs(rng, world, settings.bindings),
        limits=TaskLimits(active=rng.choice([20, 20, 2]), on_conflict=rng.choice([*OnConflict][1:])),
        faults=_faults(rng, world),
        person=RandomPerson(rng) if asks or rng.random() < 0.2 else None,
    )


def _bindings(rng: random.Random, world: ScenarioWorld, *, asks: bool) -> Bindings:
    """Bind actions to what they need; one of them may have to ask for a word before it is sent."""
    asking = rng.choice([*world.problem.domain.actions])
    retries = rng.choice([0, 0, 1])
    found = {name: Binding(resources=world.resources.get(name, ()), retries=retries) for name in world.problem.domain.actions}
    if asks:
        found[asking] = replace(found[asking], ask={"word": "please?"}, goal={"action": asking, "word": "$word"})
    return Bindings(found, lag=0.1)


def _programs(rng: random.Random, world: ScenarioWorld, bindings: Bindings) -> dict[str, Program]:
    found = {}
    for name in ("loaded0", "loaded1"):
        graph = plan_graph(world.problem, read_plan(world.plan(rng), world.problem))
        found[name] = Program.of(HandWrittenPlan(name, graph, bindings, on_failure=rng.choice([*OnFailure])))
    return found


def _faults(rng: random.Random, world: ScenarioWorld) -> Faults:
    names = [*world.problem.domain.actions]
    kinds = [FaultKind.ABORT, FaultKind.ABORT, FaultKind.REJECT, FaultKind.HANG, FaultKind.NO_EFFECT, FaultKind.SLOW, FaultKind.LOSE_SERVER]
    faults = [
        Fault(
            rng.choice(names), rng.choice(kinds), after=rng.randrange(15), times=rng.choice([1, 1, 2]), ignores_cancel=rng.random() < 0.15
        )
        for _ in range(rng.choice([0, 0, 1, 3, 5]))
    ]
    changes = [HiddenChange(world.change(rng), at=rng.uniform(0.0, 30.0)) for _ in range(rng.choice([0, 0, 1, 3]))]
    return Faults(tuple(faults), tuple(changes))


# --- what people do -------------------------------------------------------------------------------


@dataclass
class People:
    """Want tasks done, and interfere with them. The mutable state is what has a default."""

    scenario: Scenario
    simulation: TaskSimulation
    rng: random.Random
    tell: Tell
    tasks: list[UUID] = field(default_factory=list)
    """All that were wanted."""
    deeds: int = 0

    def begin(self) -> None:
        """Want a few tasks."""
        for _ in range(self.rng.randrange(1, 5)):
            self.want()

    async def interfere(self) -> None:
        """Do one thing after the other."""
        for _ in range(self.rng.randrange(3, 12)):
            try:
                await self.act()
            except TaskRefused as refused:
                self.tell(f"refused: {refused}")
            await asyncio.sleep(self.rng.choice([0.0, 0.0, self.rng.uniform(0, 1), self.rng.uniform(0, 5)]))

    async def act(self) -> None:
        """Do something to all tasks, to one of them, or to the world."""
        kind = self.rng.random()
        going_on = [one for one in self.tasks if one not in self.simulation.endings]
        chosen = self.rng.choice([None, *going_on])
        self.deeds += 1
        if kind < 0.35:
            self.want()
        elif kind < 0.6:
            await self.pause(chosen, going_on)
        elif kind < 0.8:
            await self.resume(chosen)
        elif kind < 0.87 and chosen:
            await self.cancel(chosen)
        else:
            self.change()

    def want(self) -> None:
        rng, world, programs = self.rng, self.scenario.world, self.scenario.programs
        kind = rng.random()
        how: dict[str, object] = {
            "priority": rng.choice([0, 0, 0, 1, 2]),
            "deadline": rng.choice([None, None, None, rng.uniform(0.0, 30.0)]),
            "on_conflict": rng.choice([OnConflict.DEFAULT, *OnConflict]),
        }
        if kind < 0.75:
            text = world.goal(rng)
        elif kind < 0.9:
            text, how["is_plan"] = world.plan(rng), True
        else:
            text, how["is_plan"] = rng.choice([*programs]), True
        self.tell(f"want {text!r} {how}")
        self.tasks.append(self.simulation.want(text, **how))

    async def pause(self, chosen: UUID | None, going_on: Sequence[UUID]) -> None:
        at_once = self.rng.random() < 0.5
        self.tell(f"pause {chosen} {at_once}")
        deeds = self.deeds
        async with asyncio.timeout(_PATIENCE):
            await self.simulation.master.pause(chosen, at_once=at_once)
        if deeds == self.deeds:  # nobody has said anything else meanwhile
            for task in going_on if chosen is None else [chosen]:
                check_pause(self.simulation, task)

    async def resume(self, chosen: UUID | None) -> None:
        self.tell(f"resume {chosen}")
        await self.simulation.master.resume(chosen)

    async def cancel(self, chosen: UUID) -> None:
        self.tell(f"cancel {chosen}")
        async with asyncio.timeout(_PATIENCE):
            await self.simulation.master.cancel(chosen)
        check_cancellation(self.simulation, chosen)

    def change(self) -> None:
        change = self.scenario.world.change(self.rng)
        self.tell(f"change {change}")
        self.simulation.backend.robots.world.change(change)


# --- what is against the rules --------------------------------------------------------------------


def check_pause(simulation: TaskSimulation, id: UUID) -> None:
    """Nothing of a task that is paused goes on."""
    task = simulation.master._tasks.get(id)
    if task is None or not task.is_held:
        return
    if task.control.state is not TaskState.PAUSED:
        simulation.wrong.append(f"{task.name} is {task.control.state.name} after a pause")
    run = task.control.run
    if run and run.open_requests and not run.over and not run.stopped:
        simulation.wrong.append(f"{task.name} is paused and {[*run.open_calls.values()]} go on")


def check_cancellation(simulation: TaskSimulation, task: UUID) -> None:
    """A task that has been cancelled is over."""
    if task not in simulation.endings:
        simulation.wrong.append("cancelled, and not over")


def check_end(simulation: TaskSimulation, task: UUID) -> None:
    """No task ends by an error, and none is driven to and fro."""
    if simulation.endings[task].code is Code.ERROR:
        simulation.wrong.append(str(simulation.endings[task]))
    made = simulation.seen(task, "conflict")
    if len(made) > _OFTEN:
        simulation.wrong.append(f"{len(made)} times: {made[0]}")
