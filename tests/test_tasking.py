"""Several goals at once, over shared robots, in simulation."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from uuid import UUID, uuid4

import pytest

from planner_bridge.model import Problem
from planner_bridge.pddl import parse_problem
from planner_bridge.replanning import Limits
from planner_bridge.sites import SimulatedSite
from planner_bridge.state import initial_knowledge
from planner_bridge.tasking import Room, TaskMaster
from planner_bridge.tasks import OnChange, Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.bindings import Binding, Bindings
from pnm.clock import run_async
from pnm.conditions import Condition
from pnm.errors import InputError
from pnm.machine import OnFailure
from pnm.tasking import Code, Moment, OnConflict, TaskEnding, TaskListener, TaskRefused, TaskState, Wanted
from tests.domains import fleet

BINDINGS = Bindings({name: Binding(resources=("{r}",), retries=0) for name in ("move", "pick", "drop")})
EAGER = Settings(bindings=BINDINGS, on_change=OnChange.EAGER, on_failure=OnFailure.CONTINUE_OTHERS, limits=Limits(seconds=2000.0))
LIMIT = 5000.0


class Stage(TaskListener):
    """A master of tasks over simulated robots; what is wanted of it and what has come of that."""

    def __init__(self, problem: Problem, faults: Faults, chosen: Settings, room: Room) -> None:
        self.problem = problem
        self.site = SimulatedSite(problem, chosen.bindings, faults)
        self.knowledge = initial_knowledge(problem)
        self.master = TaskMaster(problem, self.knowledge, self.site, chosen, self.read, room=room)
        self.master.listen(self)
        self.goals: dict[UUID, str] = {}
        self.moments: list[Moment] = []
        self.endings: dict[UUID, TaskEnding] = {}
        self._news = asyncio.Event()

    def read(self, text: str) -> Condition:
        if not text.startswith("("):
            raise InputError(f"not a goal: {text!r}")
        return parse_problem(
            f"(define (problem q) (:domain fleet) {_objects(self.problem)} (:init) (:goal {text}))", self.problem.domain
        ).goal

    def happened(self, moment: Moment) -> None:
        if moment.kind != "fired":
            self.moments.append(moment)
        self._stir()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        assert task not in self.endings
        self.endings[task] = ending
        self._stir()

    def _stir(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    def want(self, text: str, **how: object) -> UUID:
        wanted = Wanted(uuid4(), text, **how)  # type: ignore[arg-type]
        self.goals[wanted.id] = text
        self.master.begin(wanted)
        return wanted.id

    async def until(self, happens: Callable[[], object]) -> None:
        async with asyncio.timeout(LIMIT):
            while not happens():
                await self._news.wait()

    async def ended_with(self, *tasks: UUID) -> list[Code]:
        await self.until(lambda: all(task in self.endings for task in tasks))
        return [self.endings[task].code for task in tasks]

    async def sees(self, task: UUID, kind: str, subject: str = "", times: int = 1) -> None:
        await self.until(lambda: len(self.seen(task, kind, subject)) >= times)

    def seen(self, task: UUID, kind: str, subject: str = "") -> list[Moment]:
        return [one for one in self.moments if one.task == task and one.kind == kind and subject in one.subject + one.text]

    def state(self, task: UUID) -> TaskState:
        return next(one.state for one in self.master.status() if one.id == task)

    def sent(self, task: UUID) -> list[str]:
        return [one.subject for one in self.seen(task, "sent")]

    def holds(self, text: str) -> bool:
        return self.site.robots.world.holds(self.read(text))


def _objects(problem: Problem) -> str:
    return f"(:objects {' '.join(f'{name} - {kinds[0]}' for name, kinds in problem.own_objects.items())})"


def play(
    scene: Callable[[Stage], Awaitable[None]],
    problem: Problem | None = None,
    *,
    faults: Faults = NO_FAULTS,
    chosen: Settings = EAGER,
    room: Room | None = None,
) -> None:
    async def whole() -> None:
        stage = Stage(problem or fleet(), faults, chosen, room or Room())
        await stage.site.open(stage.knowledge)
        try:
            await scene(stage)
        finally:
            await asyncio.wait_for(stage.master.close(), LIMIT)
            await stage.site.close()
        assert stage.goals.keys() == stage.endings.keys(), "every task has an end"
        assert not stage.site.robots.clashes

    run_async(whole(), virtual=True)


# --- what is wrong with a goal -------------------------------------------------------------------


def test_a_goal_that_cannot_be_read_ends_at_once_with_the_reason():
    async def scene(stage: Stage) -> None:
        task = stage.want("nonsense")
        assert await stage.ended_with(task) == [Code.INVALID_GOAL]
        assert "nonsense" in stage.endings[task].message

    play(scene)


def test_an_unreachable_goal_has_no_plan():
    async def scene(stage: Stage) -> None:
        assert await stage.ended_with(stage.want("(and (has r0 p0) (has r0 p1))")) == [Code.NO_PLAN]

    play(scene)


def test_a_goal_that_holds_is_reached_without_any_call():
    async def scene(stage: Stage) -> None:
        task = stage.want("(at r0 a0)")
        assert await stage.ended_with(task) == [Code.GOAL_REACHED]
        assert stage.sent(task) == []

    play(scene)


def test_a_full_queue_takes_no_more():
    async def scene(stage: Stage) -> None:
        first, second, third = (stage.want(f"(in p{n} a{n + 1})") for n in range(3))
        assert await stage.ended_with(third) == [Code.QUEUE_FULL]
        assert await stage.ended_with(first, second) == [Code.GOAL_REACHED] * 2
        assert await stage.ended_with(stage.want("(in p2 a3)")) == [Code.GOAL_REACHED]

    play(scene, room=Room(active=1, queue=1))


def test_a_task_of_the_same_id_is_refused_and_the_first_goes_on():
    async def scene(stage: Stage) -> None:
        first = stage.want("(in p0 a1)")
        ended: list[Code] = []
        stage.master.listen(type("Ears", (TaskListener,), {"ended": lambda self, task, ending: ended.append(ending.code)})())
        stage.ended = lambda task, ending: None  # type: ignore[method-assign]
        stage.master.begin(Wanted(first, "(in p1 a2)"))
        assert ended == [Code.ERROR]
        del stage.ended
        assert await stage.ended_with(first) == [Code.GOAL_REACHED]

    play(scene)


# --- several goals ------------------------------------------------------------------------------


def test_goals_of_different_robots_are_pursued_at_the_same_time():
    async def scene(stage: Stage) -> None:
        one, two = stage.want("(at r0 a2)"), stage.want("(at r1 a3)")
        assert await stage.ended_with(one, two) == [Code.GOAL_REACHED] * 2
        assert stage.seen(two, "sent")[0].time < stage.endings[one].trace[-1].time

    play(scene)


def test_a_goal_that_can_be_reached_by_another_robot_does_not_wait():
    async def scene(stage: Stage) -> None:
        tasks = [stage.want(f"(in p{n} a3)") for n in range(2)]
        assert await stage.ended_with(*tasks) == [Code.GOAL_REACHED] * 2
        robots = [{subject.split("(")[1].split(",")[0] for subject in stage.sent(task)} for task in tasks]
        assert robots[0].isdisjoint(robots[1])
        assert not any(stage.seen(task, "state", "waits") for task in tasks)

    play(scene)


def test_a_goal_that_another_task_would_undo_waits_until_that_is_over():
    async def scene(stage: Stage) -> None:
        one, two = stage.want("(at r0 a2)"), stage.want("(at r0 a1)")
        await stage.sees(two, "state", "waits for (at r0 a2)")
        assert stage.state(two) is TaskState.QUEUED
        assert await stage.ended_with(one, two) == [Code.GOAL_REACHED] * 2
        assert stage.seen(two, "sent")[0].time >= stage.endings[one].trace[-1].time
        assert stage.holds("(at r0 a1)")

    play(scene)


def test_a_goal_in_conflict_is_refused_if_that_is_the_policy():
    async def scene(stage: Stage) -> None:
        one = stage.want("(at r0 a2)")
        await stage.sees(one, "sent")
        two = stage.want("(at r0 a1)", on_conflict=OnConflict.REFUSE)
        assert await stage.ended_with(two, one) == [Code.CONFLICT, Code.GOAL_REACHED]
        assert "(at r0 " in stage.endings[two].message

    play(scene)


def test_a_goal_in_conflict_waits_if_that_is_the_policy_even_if_there_is_a_way_around():
    async def scene(stage: Stage) -> None:
        one = stage.want("(in p0 a3)")
        await stage.sees(one, "sent")
        two = stage.want("(in p1 a3)", on_conflict=OnConflict.QUEUE)
        assert await stage.ended_with(one, two) == [Code.GOAL_REACHED] * 2
        assert bool(stage.seen(two, "state", "waits")) == bool(_robots(stage, one) & _robots(stage, two))

    play(scene)


def _robots(stage: Stage, task: UUID) -> set[str]:
    return {subject.split("(")[1].split(",")[0] for subject in stage.sent(task)}


# --- deadlines and cancelling -------------------------------------------------------------------


@pytest.mark.parametrize("deadline", [0.0, 0.5, 1.5])
def test_a_goal_that_is_not_reached_in_time_is_given_up(deadline: float):
    async def scene(stage: Stage) -> None:
        task = stage.want("(in p0 a2)", deadline=deadline)
        assert await stage.ended_with(task) == [Code.DEADLINE_MISSED]
        assert await stage.ended_with(stage.want("(in p0 a2)")) == [Code.GOAL_REACHED]

    play(scene)


def test_a_goal_that_waits_can_be_cancelled_and_misses_its_deadline():
    async def scene(stage: Stage) -> None:
        one, two, three = stage.want("(at r0 a2)"), stage.want("(at r0 a1)"), stage.want("(at r0 a3)", deadline=1.0)
        await stage.sees(two, "state", "waits")
        await stage.master.cancel(two)
        assert await stage.ended_with(one, two, three) == [Code.GOAL_REACHED, Code.CANCELLED, Code.DEADLINE_MISSED]

    play(scene)


def test_a_task_is_cancelled_only_when_the_servers_have_confirmed_it():
    async def scene(stage: Stage) -> None:
        task = stage.want("(at r0 a2)")
        await stage.sees(task, "sent")
        await stage.master.cancel(task)
        assert stage.endings[task].code is Code.CANCELLED
        assert not stage.site.robots.busy

    play(scene)


def test_a_server_that_does_not_confirm_is_given_up_after_its_limit():
    faults = Faults((Fault("move", FaultKind.HANG, ignores_cancel=True, times=1),))

    async def scene(stage: Stage) -> None:
        task = stage.want("(at r0 a2)")
        await stage.sees(task, "sent")
        await stage.master.cancel(task)
        assert stage.endings[task].code is Code.CANCELLED

    play(scene, faults=faults)


def test_what_is_not_there_cannot_be_paused_resumed_or_cancelled():
    async def scene(stage: Stage) -> None:
        task = stage.want("(at r0 a0)")
        await stage.ended_with(task)
        for deed in (stage.master.cancel, stage.master.resume, lambda one: stage.master.pause(one, at_once=True)):
            with pytest.raises(TaskRefused, match="is over"):
                await deed(task)
            with pytest.raises(TaskRefused, match="there is no task"):
                await deed(uuid4())

    play(scene)
