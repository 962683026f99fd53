"""Random scripts of what people do to many tasks while things go wrong.

A script is drawn from a number: how the stage is set at once, what people do while they do it. The judge looks after each
pause and each cancellation, and at the end; the stage itself looks all the time.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias
from uuid import UUID

from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.plan_text import read_plan
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.scheduling.task_manager import TaskLimits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.logic.computed_values import MISSING, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.knowledge.sources.source import Asker, SourceError
from pnm.language.plan import HandWrittenPlan
from pnm.language.runner import Program
from pnm.tasks import Code, OnConflict, TaskRefused, TaskState
from tests.support.tasks.task_settings import Setting, all_settings
from tests.support.tasks.task_stage import Stage, play

Tell: TypeAlias = Callable[[str], None]

_PATIENCE: Final = 5000.0
"""Virtual seconds within which a pause, or a cancellation, must be over."""
_OFTEN: Final = 12
"""Whoever makes way for others more often than that does nothing else."""


def play_script(number: int, tell: Tell = lambda text: None) -> Counter[Code]:
    """Play the script of this number to its end; return how many tasks have ended how."""
    rng = random.Random(number)
    script = draw(rng)
    codes: Counter[Code] = Counter()

    async def scene(stage: Stage) -> None:
        people = People(script, stage, rng, tell)
        people.begin()
        if rng.random() < 0.15:
            await people.interfere()
            tell("close")
            return
        await asyncio.gather(people.interfere(), people.interfere())
        tell("resume all")
        await stage.master.resume(None)
        codes.update(await stage.ended_with(*people.tasks))
        for task in people.tasks:
            ending = stage.endings[task]
            tell(f"{ending.code.word}: {stage.goals[task]!r}: {ending.message}")
            judge_end(stage, task)

    play(
        scene,
        script.setting.problem,
        faults=script.faults,
        chosen=script.settings,
        limits=script.limits,
        programs=script.programs,
        source=script.person,
    )
    return codes


# --- how the stage is set -------------------------------------------------------------------------


class Person:
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
class Script:
    """A world, who acts in it and how, and what goes wrong by itself."""

    setting: Setting
    settings: Settings
    programs: Mapping[str, Program]
    limits: TaskLimits
    faults: Faults
    person: Person | None


def draw(rng: random.Random) -> Script:
    """Draw all of a script but what people do."""
    setting = rng.choice(all_settings())
    asks = rng.random() < 0.3
    settings = Settings(
        bindings=_bindings(rng, setting, asks=asks),
        on_change=rng.choice([OnChange.EAGER, OnChange.EAGER, OnChange.LAZY]),
        on_failure=rng.choice([OnFailure.CONTINUE_OTHERS, OnFailure.CONTINUE_OTHERS, OnFailure.DRAIN, OnFailure.CANCEL]),
        limits=Limits(seconds=2000.0, forbid_after=rng.choice([1, 2])),
    )
    return Script(
        setting,
        settings,
        programs=_programs(rng, setting, settings.bindings),
        limits=TaskLimits(active=rng.choice([20, 20, 2]), on_conflict=rng.choice([*OnConflict])),
        faults=_faults(rng, setting),
        person=Person(rng) if asks or rng.random() < 0.2 else None,
    )


def _bindings(rng: random.Random, setting: Setting, *, asks: bool) -> Bindings:
    """Bind actions to what they need; one of them may have to ask for a word before it is sent."""
    asking = rng.choice([*setting.problem.domain.actions])
    retries = rng.choice([0, 0, 1])
    found = {name: Binding(resources=setting.resources.get(name, ()), retries=retries) for name in setting.problem.domain.actions}
    if asks:
        found[asking] = replace(found[asking], ask={"word": "please?"}, goal={"action": asking, "word": "$word"})
    return Bindings(found, lag=0.1)


def _programs(rng: random.Random, setting: Setting, bindings: Bindings) -> dict[str, Program]:
    found = {}
    for name in ("loaded0", "loaded1"):
        graph = plan_graph(setting.problem, read_plan(setting.plan(rng), setting.problem))
        found[name] = Program.of(HandWrittenPlan(name, graph, bindings, on_failure=rng.choice([*OnFailure])))
    return found


def _faults(rng: random.Random, setting: Setting) -> Faults:
    names = [*setting.problem.domain.actions]
    kinds = [FaultKind.ABORT, FaultKind.ABORT, FaultKind.REJECT, FaultKind.HANG, FaultKind.NO_EFFECT, FaultKind.SLOW, FaultKind.LOSE_SERVER]
    faults = [
        Fault(
            rng.choice(names), rng.choice(kinds), after=rng.randrange(15), times=rng.choice([1, 1, 2]), ignores_cancel=rng.random() < 0.15
        )
        for _ in range(rng.choice([0, 0, 1, 3, 5]))
    ]
    changes = [HiddenChange(setting.change(rng), at=rng.uniform(0.0, 30.0)) for _ in range(rng.choice([0, 0, 1, 3]))]
    return Faults(tuple(faults), tuple(changes))


# --- what people do -------------------------------------------------------------------------------


@dataclass
class People:
    """Want tasks done, and interfere with them. The mutable state is what has a default."""

    script: Script
    stage: Stage
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
        going_on = [one for one in self.tasks if one not in self.stage.endings]
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
        rng, setting, programs = self.rng, self.script.setting, self.script.programs
        kind = rng.random()
        how: dict[str, object] = {
            "priority": rng.choice([0, 0, 0, 1, 2]),
            "deadline": rng.choice([None, None, None, rng.uniform(0.0, 30.0)]),
            "on_conflict": rng.choice([None, None, *OnConflict]),
        }
        if kind < 0.75:
            text = setting.goal(rng)
        elif kind < 0.9:
            text, how["is_plan"] = setting.plan(rng), True
        else:
            text, how["is_plan"] = rng.choice([*programs]), True
        self.tell(f"want {text!r} {how}")
        self.tasks.append(self.stage.want(text, **how))

    async def pause(self, chosen: UUID | None, going_on: Sequence[UUID]) -> None:
        at_once = self.rng.random() < 0.5
        self.tell(f"pause {chosen} {at_once}")
        deeds = self.deeds
        async with asyncio.timeout(_PATIENCE):
            await self.stage.master.pause(chosen, at_once=at_once)
        if deeds == self.deeds:  # nobody has said anything else meanwhile
            for task in going_on if chosen is None else [chosen]:
                judge_pause(self.stage, task)

    async def resume(self, chosen: UUID | None) -> None:
        self.tell(f"resume {chosen}")
        await self.stage.master.resume(chosen)

    async def cancel(self, chosen: UUID) -> None:
        self.tell(f"cancel {chosen}")
        async with asyncio.timeout(_PATIENCE):
            await self.stage.master.cancel(chosen)
        judge_cancellation(self.stage, chosen)

    def change(self) -> None:
        change = self.script.setting.change(self.rng)
        self.tell(f"change {change}")
        self.stage.backend.robots.world.change(change)


# --- what is against the rules --------------------------------------------------------------------


def judge_pause(stage: Stage, id: UUID) -> None:
    """Nothing of a task that is paused goes on."""
    task = stage.master._tasks.get(id)
    if task is None or not task.is_held:
        return
    if task.control.state is not TaskState.PAUSED:
        stage.wrong.append(f"{task.name} is {task.control.state.name} after a pause")
    run = task.control.run
    if run and run.open_requests and not run.over and not run.stopped:
        stage.wrong.append(f"{task.name} is paused and {[*run.open_calls.values()]} go on")


def judge_cancellation(stage: Stage, task: UUID) -> None:
    """A task that has been cancelled is over."""
    if task not in stage.endings:
        stage.wrong.append("cancelled, and not over")


def judge_end(stage: Stage, task: UUID) -> None:
    """No task ends by an error, and none is driven to and fro."""
    if stage.endings[task].code is Code.ERROR:
        stage.wrong.append(str(stage.endings[task]))
    made = stage.seen(task, "conflict")
    if len(made) > _OFTEN:
        stage.wrong.append(f"{len(made)} times: {made[0]}")
