"""Random scripts of what people do to many tasks while things go wrong; a number is always the same script."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations
from uuid import UUID

from planner_bridge.loading import load
from planner_bridge.model import Problem
from planner_bridge.plan_text import read_plan
from planner_bridge.plans import plan_graph
from planner_bridge.replanning import Limits
from planner_bridge.tasking import Room
from planner_bridge.tasks import OnChange, Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.bindings import Binding, Bindings
from pnm.expressions import Fluent, Value
from pnm.language.plan import HandWrittenPlan
from pnm.machine import OnFailure
from pnm.performing import Program
from pnm.queries import MISSING, Question
from pnm.sources.base import Asker, SourceError
from pnm.tasking import Code, OnConflict, TaskRefused, TaskState
from tests.conftest import ROOT
from tests.domains import fleet, matches, rooms, tanks
from tests.task_stage import Stage, play

Choose = Callable[[random.Random], str]


@dataclass(frozen=True)
class Setting:
    """A world, what robots there have for themselves, and what may be wanted and happen in it."""

    problem: Problem
    resources: Mapping[str, tuple[str, ...]]
    goal: Choose
    plan: Choose
    change: Callable[[random.Random], Mapping[Fluent, Value]]


def _fleet_plan(rng: random.Random) -> str:
    r, p, a, b = f"r{rng.randrange(3)}", f"p{rng.randrange(4)}", (n := rng.randrange(4)), (n + rng.choice([1, 3])) % 4
    return rng.choice(
        [
            f"(move {r} a{a} a{b})\n(move {r} a{b} a{a})",
            f"(pick {r} {p} a{a})\n(drop {r} {p} a{a})",
            f"(move {r} a{a} a{b})",
        ]
    )


def _fleet_goal(rng: random.Random) -> str:
    one = f"(in p{rng.randrange(4)} a{rng.randrange(4)})"
    other = f"(at r{rng.randrange(3)} a{rng.randrange(4)})"
    return rng.choice([one, one, other, f"(and {one} {other})", f"(not {other})", f"(or {one} {other})"])


def _fleet_change(rng: random.Random) -> Mapping[Fluent, Value]:
    r, a, b = f"r{rng.randrange(3)}", f"a{rng.randrange(4)}", f"a{rng.randrange(4)}"
    moved = {("at", r, f"a{n}"): f"a{n}" == a for n in range(4)}
    return rng.choice([moved, {("way", a, b): rng.random() < 0.5}, {("in", f"p{rng.randrange(4)}", a): True}])


def _rooms_goal(rng: random.Random) -> str:
    one, other = f"(clean {rng.choice('abcd')})", f"(at r{rng.choice('12')} {rng.choice('abcd')})"
    return rng.choice([one, other, f"(and {one} {other})", f"(not {other})"])


def _rooms_plan(rng: random.Random) -> str:
    return rng.choice(["(move r1 a b)\n(sweep r1 b)", "(sweep r2 a)", "(move r2 a d)\n(move r2 d c)"])


def _rooms_change(rng: random.Random) -> Mapping[Fluent, Value]:
    a, b = rng.choice([*permutations("abcd", 2)])
    return rng.choice(
        [{("way", a, b): rng.random() < 0.7}, {("clean", a): rng.random() < 0.5}, {("at", "r1", a): True, ("at", "r1", b): False}]
    )


def _matches_goal(rng: random.Random) -> str:
    return rng.choice([f"(mended f{rng.randrange(5)})", f"(and (mended f{rng.randrange(5)}) (mended f{rng.randrange(5)}))"])


def _matches_change(rng: random.Random) -> Mapping[Fluent, Value]:
    n = rng.randrange(5)
    return rng.choice(
        [{("light", f"m{n}"): False}, {("unused", f"m{n}"): True}, {("free",): rng.random() < 0.8}, {("mended", f"f{n}"): True}]
    )


def _tanks_goal(rng: random.Random) -> str:
    return rng.choice([f"(>= (level {rng.choice('ab')}) {rng.choice([2, 4, 6])})", f"(open {rng.choice('ab')})", "(= (level b) 4)"])


def _tanks_change(rng: random.Random) -> Mapping[Fluent, Value]:
    return rng.choice([{("level", rng.choice("ab")): float(rng.randrange(9))}, {("open", rng.choice("ab")): False}])


_PLACES = ["store", "yard", "hall", "corridor", "kitchen"]


def _delivery_goal(rng: random.Random) -> str:
    one = f"(at parcel{rng.choice('12')} {rng.choice(['hall', 'kitchen'])})"
    other = f"(at r{rng.choice('12')} {rng.choice(_PLACES)})"
    return rng.choice([one, one, other, f"(and {one} {other})", "(open door1)"])


def _delivery_change(rng: random.Random) -> Mapping[Fluent, Value]:
    a, b = rng.choice([("hall", "kitchen"), ("store", "hall"), ("hall", "store"), ("yard", "hall")])
    return rng.choice(
        [{("open", "door1"): rng.random() < 0.5}, {("connected", a, b): rng.random() < 0.6}, {("at", "parcel1", "hall"): True}]
    )


@cache
def _settings() -> tuple[Setting, ...]:
    folder = ROOT / "problems" / "delivery"
    delivery = load(ROOT / "domains" / "delivery" / "domain.pddl", folder / "p01.pddl")
    robots = dict.fromkeys(delivery.domain.actions, ("{robot}",))
    robots["load"] = ("{robot}", "lift")
    return (
        Setting(fleet(3), dict.fromkeys(("move", "pick", "drop"), ("{r}",)), _fleet_goal, _fleet_plan, _fleet_change),
        Setting(fleet(3), {"move": ("{r}",), "pick": ("{r}", "lift"), "drop": ("lift",)}, _fleet_goal, _fleet_plan, _fleet_change),
        Setting(rooms(), {"move": ("{r}", "floor"), "sweep": ("floor",)}, _rooms_goal, _rooms_plan, _rooms_change),
        Setting(
            matches(5),
            {"mend": ("hand",)},
            _matches_goal,
            lambda rng: f"0: (strike m{rng.randrange(5)}) [8]\n1: (mend f{rng.randrange(5)} m{rng.randrange(5)}) [5]",
            _matches_change,
        ),
        Setting(
            tanks("8"),
            {"pour": ("{from}", "{to}")},
            _tanks_goal,
            lambda rng: "(unlock b)\n(pour a b)",
            _tanks_change,
        ),
        Setting(delivery, robots, _delivery_goal, lambda rng: "(move r1 store hall)\n(move r1 hall store)", _delivery_change),
    )


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


def _programs(rng: random.Random, setting: Setting, bindings: Bindings) -> dict[str, Program]:
    found = {}
    for number in range(2):
        graph = plan_graph(setting.problem, read_plan(setting.plan(rng), replace(setting.problem, goal=setting.problem.goal)))
        graph = replace(graph, goal=replace(graph, goal=graph.goal).goal)
        chosen = HandWrittenPlan(f"loaded{number}", graph, bindings, on_failure=rng.choice([*OnFailure]))
        found[chosen.name] = Program.of(chosen)
    return found


def play_script(number: int, tell: Callable[[str], None] = lambda text: None) -> dict[Code, int]:
    """Play the script of this number; return how many tasks have ended how."""
    rng = random.Random(number)
    setting = rng.choice(_settings())
    asks = {"word": "please?"} if rng.random() < 0.3 else {}
    asking = rng.choice([*setting.problem.domain.actions])
    retries = rng.choice([0, 0, 1])
    bindings = Bindings(
        {
            name: Binding(
                resources=setting.resources.get(name, ()),
                retries=retries,
                **({"ask": asks, "goal": {"action": name, "word": "$word"}} if asks and name == asking else {}),  # type: ignore[arg-type]
            )
            for name in setting.problem.domain.actions
        },
        lag=0.1,
    )
    chosen = Settings(
        bindings=bindings,
        on_change=rng.choice([OnChange.EAGER, OnChange.EAGER, OnChange.LAZY]),
        on_failure=rng.choice([OnFailure.CONTINUE_OTHERS, OnFailure.CONTINUE_OTHERS, OnFailure.DRAIN, OnFailure.CANCEL]),
        limits=Limits(seconds=2000.0, forbid_after=rng.choice([1, 2])),
    )
    try:
        programs = _programs(rng, setting, bindings)
    except Exception as error:
        tell(f"no programs: {error}")
        programs = {}
    counts: dict[Code, int] = {}
    stage_deeds = [0]

    def want(stage: Stage) -> UUID:
        kind = rng.random()
        how: dict[str, object] = {
            "priority": rng.choice([0, 0, 0, 1, 2]),
            "deadline": rng.choice([None, None, None, rng.uniform(0.0, 30.0)]),
            "on_conflict": rng.choice([None, None, *OnConflict]),
        }
        if kind < 0.75:
            text = setting.goal(rng)
        elif kind < 0.9 or not programs:
            text, how["is_plan"] = setting.plan(rng), True
        else:
            text, how["is_plan"] = rng.choice([*programs]), True
        tell(f"want {text!r} {how}")
        return stage.want(text, **how)

    async def act(stage: Stage, tasks: list[UUID]) -> None:
        kind = rng.random()
        going_on = [one for one in tasks if one not in stage.endings]
        chosen = rng.choice([None, *going_on])
        stage_deeds[0] += 1
        deeds = stage_deeds[0]
        try:
            if kind < 0.35:
                tasks.append(want(stage))
            elif kind < 0.6:
                at_once = rng.random() < 0.5
                tell(f"pause {chosen} {at_once}")
                async with asyncio.timeout(5000.0):
                    await stage.master.pause(chosen, at_once=at_once)
                if deeds == stage_deeds[0]:  # nobody has said anything else meanwhile
                    _check_pause(stage, going_on if chosen is None else [chosen])
            elif kind < 0.8:
                tell(f"resume {chosen}")
                await stage.master.resume(chosen)
            elif kind < 0.87 and chosen:
                tell(f"cancel {chosen}")
                async with asyncio.timeout(5000.0):
                    await stage.master.cancel(chosen)
                if chosen not in stage.endings:
                    stage.wrong.append("cancelled, and not over")
            else:
                change = setting.change(rng)
                tell(f"change {change}")
                stage.site.robots.world.change(change)
        except TaskRefused as refused:
            tell(f"refused: {refused}")

    async def person(stage: Stage, tasks: list[UUID]) -> None:
        for _ in range(rng.randrange(3, 12)):
            await act(stage, tasks)
            await asyncio.sleep(rng.choice([0.0, 0.0, rng.uniform(0, 1), rng.uniform(0, 5)]))

    async def scene(stage: Stage) -> None:
        tasks = [want(stage) for _ in range(rng.randrange(1, 5))]
        if rng.random() < 0.15:
            await person(stage, tasks)
            tell("close")
            return
        await asyncio.gather(person(stage, tasks), person(stage, tasks))
        tell("resume all")
        await stage.master.resume(None)
        for code in await stage.ended_with(*tasks):
            counts[code] = counts.get(code, 0) + 1
        for task in tasks:
            ending = stage.endings[task]
            tell(f"{ending.code.word}: {stage.goals[task]!r}: {ending.message}")
            if ending.code is Code.ERROR:
                stage.wrong.append(str(ending))
            made = stage.seen(task, "conflict")
            if len(made) > 12:
                stage.wrong.append(f"{len(made)} times: {made[0]}")

    room = Room(active=rng.choice([20, 20, 2]), on_conflict=rng.choice([*OnConflict]))
    play(
        scene,
        setting.problem,
        faults=_faults(rng, setting),
        chosen=chosen,
        room=room,
        programs=programs,
        source=Person(rng) if asks or rng.random() < 0.2 else None,
    )
    return counts


def _check_pause(stage: Stage, tasks: list[UUID]) -> None:
    for id in tasks:
        task = stage.master._tasks.get(id)
        if task and task.is_held:
            if task.state is not TaskState.PAUSED:
                stage.wrong.append(f"{task.name} is {task.state.name} after a pause")
            run = task.doing.run if task.doing else None
            if run and run.open_requests and not run.over and not run.stopped:
                stage.wrong.append(f"{task.name} is paused and {[*run.open_calls.values()]} go on")
