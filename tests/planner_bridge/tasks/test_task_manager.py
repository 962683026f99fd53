"""Several goals at once, over shared robots, in simulation."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import update_wrapper
from inspect import Signature, signature
from typing import Concatenate, ParamSpec
from uuid import UUID, uuid4

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.loading import load
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.scheduling.task_manager import TaskLimits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.knowledge.sources.source import Asker, Source
from pnm.tasks import Code, OnConflict, TaskListener, TaskRefused, TaskState, Wanted
from tests.support.files import ROOT
from tests.support.problems import fleet
from tests.support.tasks.task_stage import Stage, play

P = ParamSpec("P")

CALLS = ("move", "pick", "drop")


def needing(resource: str, **bindings: Binding) -> Settings:
    """Whatever a robot does needs this resource, and nothing is tried twice."""
    usual = {name: Binding(resources=(resource,), retries=0) for name in CALLS}
    return replace(EAGER, bindings=Bindings({**usual, **bindings}))


EAGER = Settings(on_change=OnChange.EAGER, on_failure=OnFailure.CONTINUE_OTHERS, limits=Limits(seconds=2000.0))
USUAL = needing("{r}")
ONCE = replace(USUAL, limits=Limits(forbid_after=1))
"""What has failed is not tried again in a new plan either."""


def on_stage(
    problem: Problem | None = None,
    *,
    faults: Faults = NO_FAULTS,
    chosen: Settings = USUAL,
    limits: TaskLimits | None = None,
    source: Source | None = None,
) -> Callable[[Callable[Concatenate[Stage, P], Awaitable[None]]], Callable[P, None]]:
    """Have a test played on a stage that is set like this."""

    def set_for(scene: Callable[Concatenate[Stage, P], Awaitable[None]]) -> Callable[P, None]:
        def test(*args: P.args, **kwargs: P.kwargs) -> None:
            play(lambda stage: scene(stage, *args, **kwargs), problem, faults=faults, chosen=chosen, limits=limits, source=source)

        _, *others = signature(scene).parameters.values()
        update_wrapper(test, scene)
        test.__signature__ = Signature(others)  # type: ignore[attr-defined]  # by which pytest knows what a test is given
        return test

    return set_for


def carry(stage: Stage, robot: str, origin: str, place: str) -> None:
    """Have somebody carry a robot from one place to another."""
    stage.backend.robots.world.change({("at", robot, origin): False, ("at", robot, place): True})


def robots_of(stage: Stage, task: UUID) -> set[str]:
    """Return the robots that have done something for a task."""
    return {call.split("(")[1].split(",")[0] for call in stage.sent(task)}


def delivery() -> Problem:
    """Robots that are at no place while they drive."""
    return load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")


DRIVING = replace(EAGER, bindings=Bindings({"move": Binding(resources=("{robot}",), retries=0)}))


# --- what is wrong with a goal -------------------------------------------------------------------


@on_stage()
async def test_a_goal_that_cannot_be_read_ends_at_once_with_the_reason(stage: Stage):
    task = stage.want("nonsense")
    assert await stage.ended_with(task) == [Code.INVALID_GOAL]
    assert "nonsense" in stage.endings[task].message


@on_stage()
async def test_the_goal_of_the_problem_is_told_in_pddl(stage: Stage):
    stage.master._read_goal = lambda _: stage.read("(at r0 a1)")
    task = stage.want("")
    assert stage.master.status()[0].goal == "(at r0 a1)"
    await stage.ended_with(task)


@on_stage()
async def test_a_plan_as_a_text_takes_no_parameters_and_a_plan_that_nobody_has_is_refused(stage: Stage):
    with_parameters = stage.want("(move r0 a0 a1)", is_plan=True, parameters={"speed": 1})
    unknown = stage.want("tour", is_plan=True)
    assert await stage.ended_with(with_parameters, unknown) == [Code.INVALID_GOAL] * 2
    assert stage.endings[with_parameters].message == "a plan that is sent as a text has no parameters; found speed"
    assert "expected a call such as (move r1 hall kitchen), found 'tour'" in stage.endings[unknown].message


@on_stage()
async def test_an_unreachable_goal_has_no_plan(stage: Stage):
    assert await stage.ended_with(stage.want("(and (has r0 p0) (has r0 p1))")) == [Code.NO_PLAN]


@on_stage()
async def test_a_goal_that_holds_is_reached_without_any_call(stage: Stage):
    task = stage.want("(at r0 a0)")
    await stage.reaches(task)
    assert stage.sent(task) == []


@on_stage(limits=TaskLimits(active=1, queue=1))
async def test_a_full_queue_takes_no_more(stage: Stage):
    first, second, third = (stage.want(f"(in p{n} a{n + 1})") for n in range(3))
    assert await stage.ended_with(third) == [Code.QUEUE_FULL]
    await stage.reaches(first, second)
    await stage.reaches(stage.want("(in p2 a3)"))


@on_stage()
async def test_a_task_of_the_same_id_is_refused_and_the_first_goes_on(stage: Stage):
    first = stage.want("(in p0 a1)")
    ended: list[Code] = []
    stage.master.listen(type("Ears", (TaskListener,), {"ended": lambda self, task, ending: ended.append(ending.code)})())
    stage.ended = lambda task, ending: None  # type: ignore[method-assign]
    stage.master.begin(Wanted(first, "(in p1 a2)"))
    assert ended == [Code.ERROR]
    del stage.ended
    assert [one.id for one in stage.master.status() if one.state is not TaskState.OVER] == [first]
    await stage.reaches(first)


# --- several goals ------------------------------------------------------------------------------


@on_stage()
async def test_goals_of_different_robots_are_pursued_at_the_same_time(stage: Stage):
    one, two = stage.want("(at r0 a2)"), stage.want("(at r1 a3)")
    await stage.reaches(one, two)
    assert stage.sent_at(two) < stage.ended_at(one)


@on_stage()
async def test_a_goal_that_can_be_reached_by_another_robot_does_not_wait(stage: Stage):
    one, two = stage.want("(in p0 a3)"), stage.want("(in p1 a3)")
    await stage.reaches(one, two)
    assert robots_of(stage, one).isdisjoint(robots_of(stage, two))
    assert not stage.seen(one, "state", "waits") + stage.seen(two, "state", "waits")


@on_stage()
async def test_a_goal_that_another_task_would_undo_waits_until_that_is_over(stage: Stage):
    one, two = stage.want("(at r0 a2)"), stage.want("(at r0 a1)")
    await stage.sees(two, "state", "waits for (at r0 a2)")
    assert stage.state(two) is TaskState.QUEUED
    await stage.reaches(one, two)
    assert stage.sent_at(two) >= stage.ended_at(one)
    assert stage.holds("(at r0 a1)")


@pytest.mark.parametrize("ends", ["by itself", "cancelled", "paused at once", "paused", "made to yield"])
@on_stage(delivery(), chosen=DRIVING)
async def test_no_plan_is_told_only_when_what_others_have_begun_cannot_make_it_possible(stage: Stage, ends: str):
    one = await stage.begun("(at r1 kitchen)")
    await asyncio.sleep(1.0)
    assert not any(stage.holds(f"(at r1 {place})") for place in ("store", "hall", "yard"))
    two = stage.want("(at r1 yard)", priority=1 if ends == "made to yield" else 0)
    never = stage.want("(at parcel1 yard)")
    if ends == "cancelled":
        await stage.master.cancel(one)
    elif ends.startswith("paused"):
        await stage.master.pause(one, at_once=ends == "paused at once")
    await stage.reaches(two)
    assert await stage.ended_with(never) == [Code.NO_PLAN]
    if ends.startswith("paused"):
        await stage.master.resume(one)
    if ends != "cancelled":
        await stage.reaches(one)
    else:
        assert await stage.ended_with(one) == [Code.CANCELLED]
    assert not stage.backend.robots.clashes


@on_stage(delivery(), chosen=DRIVING)
async def test_what_others_have_begun_counts_even_if_it_ends_while_a_plan_is_looked_for(stage: Stage):
    one = await stage.begun("(at r1 hall)")
    await asyncio.sleep(1.0)
    two = stage.want("(at r1 yard)")
    await stage.until(lambda: stage.seen(two, "state", "planning"))
    carry(stage, "r1", "store", "hall")
    await stage.master.cancel(one)
    await stage.reaches(two)


@on_stage(delivery(), chosen=DRIVING)
async def test_a_goal_that_waits_for_what_others_have_begun_says_so_or_is_refused(stage: Stage):
    one = await stage.begun("(at r1 kitchen)")
    await asyncio.sleep(1.0)
    two, three = stage.want("(at r1 yard)"), stage.want("(at r1 yard)", on_conflict=OnConflict.REFUSE)
    await stage.sees(two, "state", "waits for (at r1 kitchen)")
    assert "it has begun move(r1, store, hall)" in stage.seen(two, "state", "waits for")[0].text
    assert await stage.ended_with(three) == [Code.CONFLICT]
    await stage.reaches(one, two)


@on_stage()
async def test_a_goal_in_conflict_is_refused_if_that_is_the_policy(stage: Stage):
    one = await stage.begun("(at r0 a2)")
    two = stage.want("(at r0 a1)", on_conflict=OnConflict.REFUSE)
    assert await stage.ended_with(two, one) == [Code.CONFLICT, Code.GOAL_REACHED]
    assert "(at r0 " in stage.endings[two].message


@on_stage()
async def test_a_goal_in_conflict_waits_if_that_is_the_policy_even_if_there_is_a_way_around(stage: Stage):
    one = await stage.begun("(in p0 a3)")
    two = stage.want("(in p1 a3)", on_conflict=OnConflict.QUEUE)
    await stage.reaches(one, two)
    assert bool(stage.seen(two, "state", "waits")) == bool(robots_of(stage, one) & robots_of(stage, two))


# --- deadlines and cancelling -------------------------------------------------------------------


@pytest.mark.parametrize("deadline", [0.0, 0.5, 1.5])
@on_stage()
async def test_a_goal_that_is_not_reached_in_time_is_given_up(stage: Stage, deadline: float):
    task = stage.want("(in p0 a2)", deadline=deadline)
    assert await stage.ended_with(task) == [Code.DEADLINE_MISSED]
    await stage.reaches(stage.want("(in p0 a2)"))


@on_stage()
async def test_a_goal_that_waits_can_be_cancelled_and_misses_its_deadline(stage: Stage):
    one, two, three = stage.want("(at r0 a2)"), stage.want("(at r0 a1)"), stage.want("(at r0 a3)", deadline=1.0)
    await stage.sees(two, "state", "waits")
    await stage.master.cancel(two)
    assert await stage.ended_with(one, two, three) == [Code.GOAL_REACHED, Code.CANCELLED, Code.DEADLINE_MISSED]


@on_stage()
async def test_a_task_is_cancelled_only_when_the_servers_have_confirmed_it(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.cancel(task)
    assert stage.endings[task].code is Code.CANCELLED
    assert len(stage.seen(task, "ended")) == 1


@on_stage(faults=Faults((Fault("move", FaultKind.HANG, ignores_cancel=True, times=1),)))
async def test_a_server_that_does_not_confirm_is_given_up_after_its_limit(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.cancel(task)
    assert stage.endings[task].code is Code.CANCELLED


@on_stage(faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)))
async def test_what_a_request_has_that_was_given_up_is_not_used_by_others_and_they_find_another_way(stage: Stage):
    first = await stage.begun("(at r0 a1)")
    await stage.master.cancel(first)
    assert stage.seen(first, "withheld", "keeps r0 until its server says that it is over")
    second = stage.want("(in p0 a1)")
    assert await stage.ended_with(second) == [Code.GOAL_REACHED]
    (failure,) = stage.seen(second, "failed")
    assert f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over" in failure.text
    assert {word.split("(")[1].split(",")[0] for word in stage.sent(second)} == {"r1"}
    third = stage.want("(has r0 p0)")
    assert await stage.ended_with(third) == [Code.SERVER_UNAVAILABLE], "no other robot will do"
    assert "move(r0, ?, ?)" in stage.endings[third].message
    assert stage.endings[third].message.endswith(
        f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over"
    )
    assert not stage.sent(third)


@on_stage(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),)),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_what_a_request_has_that_was_given_up_is_free_when_its_server_reports_late(stage: Stage):
    first = await stage.begun("(at r0 a1)")
    await stage.master.cancel(first)
    second = stage.want("(has r0 p0)")
    assert await stage.ended_with(second) == [Code.GOAL_REACHED]
    assert stage.seen(second, "sent")[0].time >= 10.0 - 0.1, "when the first one has ended indeed"


@on_stage(
    faults=Faults(
        (
            Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),
            Fault("move(r1, a1, a0)", FaultKind.SLOW, times=1),
            Fault("pick(r1, p0, a0)", FaultKind.ABORT),
        )
    ),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0), pick=Binding(resources=("{r}",), retries=0, accept=3.0)),
)
async def test_what_was_waited_for_in_vain_is_planned_with_again_when_it_is_free(stage: Stage):
    first = await stage.begun("(at r0 a1)")
    await stage.master.cancel(first)
    second = stage.want("(in p0 a1)")
    await stage.sees(second, "failed", "r0 is kept")
    await stage.reaches(second)
    assert robots_of(stage, second) == {"r0", "r1"}


@on_stage()
async def test_what_is_not_there_cannot_be_paused_resumed_or_cancelled(stage: Stage):
    task = stage.want("(at r0 a0)")
    await stage.ended_with(task)
    for deed in (stage.master.cancel, stage.master.resume, lambda one: stage.master.pause(one, at_once=True)):
        with pytest.raises(TaskRefused, match="is over"):
            await deed(task)
        with pytest.raises(TaskRefused, match="there is no task"):
            await deed(uuid4())


# --- pausing and resuming -------------------------------------------------------------------------


@on_stage()
async def test_a_task_that_is_paused_at_a_safe_point_goes_on_where_it_was(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.pause(task, at_once=False)
    assert stage.state(task) is TaskState.PAUSED
    assert [len(stage.seen(task, kind)) for kind in ("sent", "ended")] == [1, 1]
    await asyncio.sleep(100.0)
    assert len(stage.sent(task)) == 1
    await stage.master.resume(task)
    await stage.reaches(task)
    assert len(stage.sent(task)) == 2
    assert len(stage.seen(task, "planned")) == 1


@on_stage()
async def test_a_task_that_is_paused_at_once_begins_its_call_anew(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.pause(task, at_once=True)
    assert stage.state(task) is TaskState.PAUSED
    assert "canceled" in stage.seen(task, "ended")[0].text
    await stage.master.resume(task)
    await stage.reaches(task)
    assert len(stage.sent(task)) == 3


@on_stage()
async def test_a_task_whose_plan_does_not_work_any_more_after_a_pause_finds_another_way(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.pause(task, at_once=True)
    carry(stage, "r0", "a0", "a3")
    await stage.master.resume(task)
    await stage.reaches(task)
    assert stage.sent(task)[1:] == ["move(r0, a3, a2)"]


async def resumed_beside(stage: Stage, goal: str, other: str, **how: object) -> tuple[UUID, UUID]:
    """Have a task be resumed when another one has begun with what is in conflict with it."""
    task = await stage.begun(goal, **how)
    await stage.master.pause(task, at_once=False)
    newcomer = await stage.begun(other)
    assert not stage.seen(newcomer, "state", "waits"), "what is paused keeps nobody waiting"
    await stage.master.resume(task)
    return task, newcomer


@pytest.mark.parametrize(("goal", "how"), [("(at r0 a3)", {}), ("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", {"is_plan": True})])
@on_stage(fleet(places=8))
async def test_a_task_that_is_resumed_waits_for_those_that_have_begun_meanwhile_what_is_in_its_way(
    stage: Stage, goal: str, how: dict[str, object]
):
    task, newcomer = await resumed_beside(stage, goal, "(and (has r0 p1) (at r0 a1))", **how)
    await stage.sees(task, "state", "queued: waits for")
    count = len(stage.sent(task))
    await stage.reaches(newcomer)
    assert len(stage.sent(task)) == count, "nothing of it began meanwhile"
    assert not stage.seen(newcomer, "failed")
    await stage.reaches(task)


@on_stage(fleet(places=8))
async def test_a_task_that_is_resumed_plans_around_those_that_have_begun_meanwhile(stage: Stage):
    task, newcomer = await resumed_beside(stage, "(in p1 a7)", "(and (at r1 a4) (has r1 p3))")
    await stage.reaches(task, newcomer)
    assert not stage.seen(task, "failed")
    assert not stage.seen(newcomer, "failed")
    assert robots_of(stage, newcomer) == {"r1"}
    assert stage.sent(task)[-1].startswith("drop(r0")


@on_stage(fleet(places=8))
async def test_a_task_that_is_resumed_is_refused_beside_others_if_that_is_the_policy(stage: Stage):
    task, newcomer = await resumed_beside(stage, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", on_conflict=OnConflict.REFUSE)
    assert await stage.ended_with(task, newcomer) == [Code.CONFLICT, Code.GOAL_REACHED]
    assert "which the other" in stage.endings[task].message


@on_stage(fleet(places=8))
async def test_those_of_lower_priority_make_way_for_a_task_that_is_resumed(stage: Stage):
    task, newcomer = await resumed_beside(stage, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", priority=1)
    await stage.ended_with(task)
    assert newcomer not in stage.endings
    assert stage.seen(newcomer, "conflict", "makes way")
    await stage.reaches(task, newcomer)


@on_stage(fleet(places=8))
async def test_a_plan_by_hand_that_was_to_make_room_goes_on_when_nobody_needs_that_any_more(stage: Stage):
    task = await stage.begun("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", is_plan=True)
    first = asyncio.ensure_future(stage.master.pause(task, at_once=False))
    await stage.sees(task, "state", "pausing")
    newcomer = stage.want("(and (has r0 p1) (at r0 a1))")
    await stage.sees(newcomer, "planned")
    await stage.master.resume(task)
    await asyncio.sleep(0.1)
    second = asyncio.ensure_future(stage.master.pause(task, at_once=False))
    await stage.master.cancel(newcomer)
    assert not stage.seen(task, "ended"), "its first call is still under way"
    await stage.master.resume(task)
    await asyncio.gather(first, second)
    await stage.reaches(task)


@pytest.mark.parametrize("at_once", [False, True])
@on_stage(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_does_not_use_up_the_time_of_the_task(stage: Stage, at_once: bool):
    task = await stage.begun("(at r0 a4)")
    for _ in range(2):
        await stage.master.pause(task, at_once=at_once)
        await asyncio.sleep(100.0)
        await stage.master.resume(task)
    await stage.reaches(task)


@on_stage(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_gives_the_task_no_more_time_than_it_had(stage: Stage):
    task = stage.want("(at r0 a4)")
    await stage.sees(task, "ended")
    await stage.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    stage.backend.robots.faults = Faults((Fault("move", FaultKind.HANG),))
    resumed = asyncio.get_running_loop().time()
    await stage.master.resume(task)
    assert await stage.ended_with(task) == [Code.TIMED_OUT]
    assert stage.endings[task].message == "the limit of 20 s is reached"
    assert 15.0 < asyncio.get_running_loop().time() - resumed < 20.0, "what it used before the pause counts"


@on_stage()
async def test_a_paused_task_can_be_cancelled_and_misses_its_deadline(stage: Stage):
    one, two = stage.want("(at r0 a2)"), stage.want("(at r1 a3)", deadline=50.0)
    await stage.sees(one, "sent")
    await stage.master.pause(None, at_once=False)
    await stage.master.cancel(one)
    assert await stage.ended_with(one, two) == [Code.CANCELLED, Code.DEADLINE_MISSED]


@on_stage()
async def test_what_comes_while_all_is_paused_waits(stage: Stage):
    await stage.master.pause(None, at_once=False)
    task = stage.want("(at r0 a2)")
    await asyncio.sleep(100.0)
    assert not stage.sent(task)
    await stage.master.resume(None)
    await stage.reaches(task)


@on_stage()
async def test_a_paused_task_keeps_nobody_waiting(stage: Stage):
    one = await stage.begun("(at r0 a2)")
    two = stage.want("(at r0 a1)")
    await stage.sees(two, "state", "waits")
    await stage.master.pause(one, at_once=False)
    await stage.reaches(two)
    await stage.master.resume(one)
    await stage.reaches(one)


@on_stage(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_a_task_that_a_pause_leaves_without_a_plan_keeps_nobody_waiting(stage: Stage):
    paused = await stage.begun("(at r0 a1)")
    await stage.master.pause(paused, at_once=True)
    assert stage.seen(paused, "replanned"), "its server has not confirmed that it has stopped"
    for goal in ("(at r1 a2)", "(at r1 a1)"):
        await stage.reaches(stage.want(goal))


@on_stage()
async def test_a_pause_right_after_the_end_was_asked_for_holds_nothing_up(stage: Stage):
    task = stage.want("(at r0 a2)")
    ending = asyncio.ensure_future(stage.master.cancel(task))
    await asyncio.sleep(0)
    await stage.master.pause(task, at_once=True)
    assert task in stage.endings, "the pause of a task that is being cancelled ends with it"
    await ending


@on_stage()
async def test_a_pause_right_after_a_resumption_waits_for_what_that_begins(stage: Stage):
    task = await stage.begun("(at r0 a2)")
    await stage.master.pause(task, at_once=True)
    going_on = stage.master._tasks[task]
    going_on.control.resume()
    await going_on.control.pause("", at_once=False)
    assert stage.state(task) is TaskState.PAUSED
    await asyncio.sleep(0.1)
    assert not stage.backend.robots._jobs
    await stage.master.resume(task)
    await stage.reaches(task)


@on_stage()
async def test_a_task_that_is_paused_while_it_plans_stays_so_and_plans_afresh(stage: Stage):
    task = stage.want("(at r0 a2)")
    await stage.until(lambda: stage.seen(task, "state", "planning"))
    await stage.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    assert stage.state(task) is TaskState.PAUSED
    assert not stage.seen(task, "planned")
    carry(stage, "r0", "a0", "a3")
    await stage.master.resume(task)
    await stage.reaches(task)
    assert stage.sent(task) == ["move(r0, a3, a2)"]


# --- priorities -----------------------------------------------------------------------------------


@on_stage()
async def test_a_higher_goal_preempts_a_lower_one_that_goes_on_by_itself(stage: Stage):
    low = await stage.begun("(at r0 a2)")
    high = stage.want("(at r0 a3)", priority=1)
    await stage.reaches(high)
    assert stage.seen(low, "state", "makes way for (at r0 a3)")
    await stage.reaches(low)
    assert stage.holds("(at r0 a2)")


@on_stage(chosen=needing("lift"))
async def test_a_higher_goal_takes_the_resource_of_a_lower_one_even_if_their_facts_have_nothing_to_do_with_each_other(stage: Stage):
    low = await stage.begun("(at r0 a2)")
    high = stage.want("(at r1 a3)", priority=1)
    await stage.reaches(high, low)
    assert stage.seen(low, "conflict", "makes way")
    assert stage.ended_at(high) < stage.ended_at(low)


@on_stage(chosen=needing("lift"))
async def test_equal_goals_that_share_a_resource_take_turns(stage: Stage):
    tasks = [stage.want("(at r0 a2)"), stage.want("(at r1 a3)")]
    await stage.reaches(*tasks)
    assert not any(stage.seen(task, "conflict") for task in tasks)


@on_stage()
async def test_a_task_that_was_preempted_and_paused_goes_on_when_both_are_over(stage: Stage):
    low = await stage.begun("(at r0 a2)")
    high = await stage.begun("(at r0 a3)", priority=1)
    await stage.master.pause(low, at_once=True)
    await stage.reaches(high)
    assert stage.state(low) is TaskState.PAUSED
    await stage.master.resume(low)
    await stage.reaches(low)


@on_stage()
async def test_nobody_is_held_up_by_a_task_that_is_paused(stage: Stage):
    low = await stage.begun("(at r0 a1)")
    high = await stage.begun("(at r0 a3)", priority=1)
    assert stage.state(low) is TaskState.PAUSED
    await stage.master.pause(high, at_once=True)
    await stage.reaches(low)
    await stage.master.resume(high)
    await stage.reaches(high)
    assert stage.holds("(at r0 a3)")


class Person:
    """Answers everything after a minute."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        if question.layer is not Layer.PERSON:
            return MISSING
        await asyncio.sleep(60.0)
        return "yes"

    async def update(self, question: Question, value: object, asker: Asker, /) -> None: ...

    async def close(self) -> None: ...


ASKING = Binding(resources=("lift",), retries=0, ask={"word": "May I?"}, goal={"word": "$word"})


@on_stage(fleet(robots=2, parcels=3, places=8), chosen=needing("lift", pick=ASKING), source=Person())
async def test_nobody_is_held_up_by_a_task_that_only_waits_for_an_answer(stage: Stage):
    low = await stage.begun("(at r0 a4)")
    high = stage.want("(has r1 p2)", priority=1)
    await stage.reaches(low, high)
    assert stage.seen(low, "state", "makes way"), "what the other one does first needs the lift"
    assert stage.ended_at(low) < stage.seen(high, "sent", "pick")[0].time
    assert len(stage.seen(low, "conflict")) == 1


# --- failures and changes while others go on ------------------------------------------------------


BOTH = "(and (at r0 a1) (at r1 a2))"
ONE_FAILS_AND_ONE_IS_SLOW = Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT), Fault("move(r1, a1, a2)", FaultKind.SLOW, times=1)))
A_WAY_IS_BLOCKED = Faults(changes=(HiddenChange({("way", "a1", "a2"): False}, at=0.5),))


@on_stage(faults=ONE_FAILS_AND_ONE_IS_SLOW, chosen=ONCE)
async def test_what_is_under_way_goes_on_while_another_way_is_found(stage: Stage):
    task = stage.want(BOTH)
    await stage.sees(task, "failed", "move(r0, a0, a1)")
    await stage.sees(task, "sent", "move(r0, a0, a3)")
    assert not stage.seen(task, "ended", "move(r1, a1, a2)"), "r1 is still on its way"
    await stage.reaches(task)
    assert stage.sent(task).count("move(r1, a1, a2)") == 1, "and was never sent again"


@pytest.mark.parametrize(("policy", "ends"), [(OnFailure.DRAIN, "succeeded"), (OnFailure.CANCEL, "canceled")])
def test_other_policies_end_what_is_under_way_first(policy: OnFailure, ends: str):
    @on_stage(faults=ONE_FAILS_AND_ONE_IS_SLOW, chosen=replace(ONCE, on_failure=policy))
    async def scene(stage: Stage) -> None:
        task = stage.want(BOTH)
        await stage.sees(task, "sent", "move(r0, a0, a3)")
        assert ends in stage.seen(task, "ended", "move(r1, a1, a2)")[0].text
        await stage.reaches(task)

    scene()


@on_stage(fleet(places=6), faults=A_WAY_IS_BLOCKED)
async def test_a_change_that_breaks_the_rest_of_the_plan_is_acted_on_at_once(stage: Stage):
    task = stage.want("(at r0 a2)")
    await stage.sees(task, "replanned")
    assert stage.seen(task, "replanned")[0].time == pytest.approx(0.5, abs=0.1)
    await stage.reaches(task)
    assert not stage.seen(task, "failed")
    assert stage.sent(task) == ["move(r0, a0, a1)", *(f"move(r0, a{n}, a{m})" for n, m in ((1, 0), (0, 5), (5, 4), (4, 3), (3, 2)))]


@on_stage(fleet(places=6), faults=A_WAY_IS_BLOCKED, chosen=replace(USUAL, on_change=OnChange.LAZY))
async def test_a_lazy_task_finds_out_when_a_call_fails(stage: Stage):
    task = stage.want("(at r0 a2)")
    await stage.reaches(task)
    assert stage.seen(task, "failed", "precondition_false")


SOMEBODY_BRINGS_IT = HiddenChange({("in", "p0", "a0"): False, ("in", "p0", "a2"): True, ("has", "r0", "p0"): False}, at=1.5)


@on_stage(fleet(robots=1), faults=Faults(changes=(SOMEBODY_BRINGS_IT,)))
async def test_a_goal_that_comes_true_by_itself_is_taken(stage: Stage):
    task = stage.want("(in p0 a2)")
    await stage.reaches(task)
    assert len(stage.sent(task)) <= 2


SOMEBODY_CARRIES_IT_ON = HiddenChange({("at", "r0", "a0"): False, ("at", "r0", "a1"): False, ("at", "r0", "a2"): True}, at=1.5)


@on_stage(fleet(places=8), faults=Faults(changes=(SOMEBODY_CARRIES_IT_ON,)))
async def test_calls_that_have_become_needless_are_left_out(stage: Stage):
    task = stage.want("(at r0 a4)")
    await stage.reaches(task)
    assert not stage.seen(task, "failed")


@on_stage(faults=Faults((Fault("pick", FaultKind.ABORT, message="the gripper is stuck"),)))
async def test_a_task_that_can_do_no_more_says_what_failed(stage: Stage):
    task = stage.want("(in p0 a2)")
    assert await stage.ended_with(task) == [Code.ACTION_FAILED]
    assert "the gripper is stuck" in stage.endings[task].message


# --- many -----------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_many_goals_over_few_robots_with_failures_all_end_and_say_the_truth(seed: int):
    rng = random.Random(seed)
    parcels, places = 8, 5
    kinds = [FaultKind.ABORT, FaultKind.REJECT, FaultKind.NO_EFFECT, FaultKind.SLOW, FaultKind.HANG]
    faults = tuple(
        Fault(rng.choice(CALLS), rng.choice(kinds), after=rng.randrange(20), times=1, ignores_cancel=rng.random() < 0.3)
        for _ in range(rng.randrange(6))
    )

    @on_stage(fleet(robots=3, parcels=parcels, places=places), faults=Faults(faults))
    async def scene(stage: Stage) -> None:
        wanted = [f"(in p{n} a{rng.randrange(places)})" for n in range(parcels)]
        tasks = []
        for text in wanted:
            tasks.append(stage.want(text, priority=rng.choice([0, 0, 0, 1]), on_conflict=rng.choice([None, OnConflict.QUEUE])))
            await asyncio.sleep(rng.choice([0.0, 0.0, 0.7, 3.0]))
            if rng.random() < 0.2:
                chosen = rng.choice([None, *tasks])
                if chosen is None or chosen not in stage.endings:
                    await stage.master.pause(chosen, at_once=rng.random() < 0.5)
                    await asyncio.sleep(rng.choice([0.0, 2.0]))
                    await stage.master.resume(None)
        codes = await stage.ended_with(*tasks)
        for text, code in zip(wanted, codes, strict=True):
            if code is Code.GOAL_REACHED:
                assert stage.holds(text)
            else:
                assert code in (Code.ACTION_FAILED, Code.NO_PLAN, Code.CONDITION_LOST, Code.SERVER_UNAVAILABLE, Code.TIMED_OUT), code

    scene()
