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
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

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


def simulated(
    problem: Problem | None = None,
    *,
    faults: Faults = NO_FAULTS,
    chosen: Settings = USUAL,
    limits: TaskLimits | None = None,
    source: Source | None = None,
) -> Callable[[Callable[Concatenate[TaskSimulation, P], Awaitable[None]]], Callable[P, None]]:
    """Run a test with the tasks of such a node, in simulation."""

    def wrap(scenario: Callable[Concatenate[TaskSimulation, P], Awaitable[None]]) -> Callable[P, None]:
        def test(*args: P.args, **kwargs: P.kwargs) -> None:
            simulate_tasks(
                lambda simulation: scenario(simulation, *args, **kwargs),
                problem,
                faults=faults,
                chosen=chosen,
                limits=limits,
                source=source,
            )

        _, *others = signature(scenario).parameters.values()
        update_wrapper(test, scenario)
        test.__signature__ = Signature(others)  # type: ignore[attr-defined]  # by which pytest knows what a test is given
        return test

    return wrap


def carry(simulation: TaskSimulation, robot: str, origin: str, place: str) -> None:
    """Have somebody carry a robot from one place to another."""
    simulation.backend.robots.world.change({("at", robot, origin): False, ("at", robot, place): True})


def robots_of(simulation: TaskSimulation, task: UUID) -> set[str]:
    """Return the robots that have done something for a task."""
    return {call.split("(")[1].split(",")[0] for call in simulation.sent(task)}


def delivery() -> Problem:
    """Robots that are at no place while they drive."""
    return load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")


DRIVING = replace(EAGER, bindings=Bindings({"move": Binding(resources=("{robot}",), retries=0)}))


# --- what is wrong with a goal -------------------------------------------------------------------


@simulated()
async def test_a_goal_that_cannot_be_read_ends_at_once_with_the_reason(simulation: TaskSimulation):
    task = simulation.want("nonsense")
    assert await simulation.ended_with(task) == [Code.INVALID_GOAL]
    assert "nonsense" in simulation.endings[task].message


@simulated()
async def test_the_goal_of_the_problem_is_told_in_pddl(simulation: TaskSimulation):
    simulation.master._read_goal = lambda _: simulation.read("(at r0 a1)")
    task = simulation.want("")
    assert simulation.master.status()[0].goal == "(at r0 a1)"
    await simulation.ended_with(task)


@simulated()
async def test_a_plan_as_a_text_takes_no_parameters_and_a_plan_that_nobody_has_is_refused(simulation: TaskSimulation):
    with_parameters = simulation.want("(move r0 a0 a1)", is_plan=True, parameters={"speed": 1})
    unknown = simulation.want("tour", is_plan=True)
    assert await simulation.ended_with(with_parameters, unknown) == [Code.INVALID_GOAL] * 2
    assert simulation.endings[with_parameters].message == "a plan that is sent as a text has no parameters; found speed"
    assert "expected a call such as (move r1 hall kitchen), found 'tour'" in simulation.endings[unknown].message


@simulated()
async def test_an_unreachable_goal_has_no_plan(simulation: TaskSimulation):
    assert await simulation.ended_with(simulation.want("(and (has r0 p0) (has r0 p1))")) == [Code.NO_PLAN]


@simulated()
async def test_a_goal_that_holds_is_reached_without_any_call(simulation: TaskSimulation):
    task = simulation.want("(at r0 a0)")
    await simulation.reaches(task)
    assert simulation.sent(task) == []


@simulated(limits=TaskLimits(active=1, queue=1))
async def test_a_full_queue_takes_no_more(simulation: TaskSimulation):
    first, second, third = (simulation.want(f"(in p{n} a{n + 1})") for n in range(3))
    assert await simulation.ended_with(third) == [Code.QUEUE_FULL]
    await simulation.reaches(first, second)
    await simulation.reaches(simulation.want("(in p2 a3)"))


@simulated()
async def test_a_task_of_the_same_id_is_refused_and_the_first_goes_on(simulation: TaskSimulation):
    first = simulation.want("(in p0 a1)")
    ended: list[Code] = []
    simulation.master.listen(type("Ears", (TaskListener,), {"ended": lambda self, task, ending: ended.append(ending.code)})())
    simulation.ended = lambda task, ending: None  # type: ignore[method-assign]
    simulation.master.begin(Wanted(first, "(in p1 a2)"))
    assert ended == [Code.ERROR]
    del simulation.ended
    assert [one.id for one in simulation.master.status() if one.state is not TaskState.OVER] == [first]
    await simulation.reaches(first)


# --- several goals ------------------------------------------------------------------------------


@simulated()
async def test_goals_of_different_robots_are_pursued_at_the_same_time(simulation: TaskSimulation):
    one, two = simulation.want("(at r0 a2)"), simulation.want("(at r1 a3)")
    await simulation.reaches(one, two)
    assert simulation.sent_at(two) < simulation.ended_at(one)


@simulated()
async def test_a_goal_that_can_be_reached_by_another_robot_does_not_wait(simulation: TaskSimulation):
    one, two = simulation.want("(in p0 a3)"), simulation.want("(in p1 a3)")
    await simulation.reaches(one, two)
    assert robots_of(simulation, one).isdisjoint(robots_of(simulation, two))
    assert not simulation.seen(one, "state", "waits") + simulation.seen(two, "state", "waits")


@simulated()
async def test_a_goal_that_another_task_would_undo_waits_until_that_is_over(simulation: TaskSimulation):
    one, two = simulation.want("(at r0 a2)"), simulation.want("(at r0 a1)")
    await simulation.sees(two, "state", "waits for (at r0 a2)")
    assert simulation.state(two) is TaskState.QUEUED
    await simulation.reaches(one, two)
    assert simulation.sent_at(two) >= simulation.ended_at(one)
    assert simulation.holds("(at r0 a1)")


@pytest.mark.parametrize("ends", ["by itself", "cancelled", "paused at once", "paused", "made to yield"])
@simulated(delivery(), chosen=DRIVING)
async def test_no_plan_is_told_only_when_what_others_have_begun_cannot_make_it_possible(simulation: TaskSimulation, ends: str):
    one = await simulation.begun("(at r1 kitchen)")
    await asyncio.sleep(1.0)
    assert not any(simulation.holds(f"(at r1 {place})") for place in ("store", "hall", "yard"))
    two = simulation.want("(at r1 yard)", priority=1 if ends == "made to yield" else 0)
    never = simulation.want("(at parcel1 yard)")
    if ends == "cancelled":
        await simulation.master.cancel(one)
    elif ends.startswith("paused"):
        await simulation.master.pause(one, at_once=ends == "paused at once")
    await simulation.reaches(two)
    assert await simulation.ended_with(never) == [Code.NO_PLAN]
    if ends.startswith("paused"):
        await simulation.master.resume(one)
    if ends != "cancelled":
        await simulation.reaches(one)
    else:
        assert await simulation.ended_with(one) == [Code.CANCELLED]
    assert not simulation.backend.robots.clashes


@simulated(delivery(), chosen=DRIVING)
async def test_what_others_have_begun_counts_even_if_it_ends_while_a_plan_is_looked_for(simulation: TaskSimulation):
    one = await simulation.begun("(at r1 hall)")
    await asyncio.sleep(1.0)
    two = simulation.want("(at r1 yard)")
    await simulation.until(lambda: simulation.seen(two, "state", "planning"))
    carry(simulation, "r1", "store", "hall")
    await simulation.master.cancel(one)
    await simulation.reaches(two)


@simulated(delivery(), chosen=DRIVING)
async def test_a_goal_that_waits_for_what_others_have_begun_says_so_or_is_refused(simulation: TaskSimulation):
    one = await simulation.begun("(at r1 kitchen)")
    await asyncio.sleep(1.0)
    two, three = simulation.want("(at r1 yard)"), simulation.want("(at r1 yard)", on_conflict=OnConflict.REFUSE)
    await simulation.sees(two, "state", "waits for (at r1 kitchen)")
    assert "it has begun move(r1, store, hall)" in simulation.seen(two, "state", "waits for")[0].text
    assert await simulation.ended_with(three) == [Code.CONFLICT]
    await simulation.reaches(one, two)


@simulated()
async def test_a_goal_in_conflict_is_refused_if_that_is_the_policy(simulation: TaskSimulation):
    one = await simulation.begun("(at r0 a2)")
    two = simulation.want("(at r0 a1)", on_conflict=OnConflict.REFUSE)
    assert await simulation.ended_with(two, one) == [Code.CONFLICT, Code.GOAL_REACHED]
    assert "(at r0 " in simulation.endings[two].message


@simulated()
async def test_a_goal_in_conflict_waits_if_that_is_the_policy_even_if_there_is_a_way_around(simulation: TaskSimulation):
    one = await simulation.begun("(in p0 a3)")
    two = simulation.want("(in p1 a3)", on_conflict=OnConflict.QUEUE)
    await simulation.reaches(one, two)
    assert bool(simulation.seen(two, "state", "waits")) == bool(robots_of(simulation, one) & robots_of(simulation, two))


# --- deadlines and cancelling -------------------------------------------------------------------


@pytest.mark.parametrize("deadline", [0.0, 0.5, 1.5])
@simulated()
async def test_a_goal_that_is_not_reached_in_time_is_given_up(simulation: TaskSimulation, deadline: float):
    task = simulation.want("(in p0 a2)", deadline=deadline)
    assert await simulation.ended_with(task) == [Code.DEADLINE_MISSED]
    await simulation.reaches(simulation.want("(in p0 a2)"))


@simulated()
async def test_a_goal_that_waits_can_be_cancelled_and_misses_its_deadline(simulation: TaskSimulation):
    one, two, three = simulation.want("(at r0 a2)"), simulation.want("(at r0 a1)"), simulation.want("(at r0 a3)", deadline=1.0)
    await simulation.sees(two, "state", "waits")
    await simulation.master.cancel(two)
    assert await simulation.ended_with(one, two, three) == [Code.GOAL_REACHED, Code.CANCELLED, Code.DEADLINE_MISSED]


@simulated()
async def test_a_task_is_cancelled_only_when_the_servers_have_confirmed_it(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.cancel(task)
    assert simulation.endings[task].code is Code.CANCELLED
    assert len(simulation.seen(task, "ended")) == 1


@simulated(faults=Faults((Fault("move", FaultKind.HANG, ignores_cancel=True, times=1),)))
async def test_a_server_that_does_not_confirm_is_given_up_after_its_limit(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.cancel(task)
    assert simulation.endings[task].code is Code.CANCELLED


@simulated(faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)))
async def test_what_a_request_has_that_was_given_up_is_not_used_by_others_and_they_find_another_way(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    assert simulation.seen(first, "withheld", "keeps r0 until its server says that it is over")
    second = simulation.want("(in p0 a1)")
    assert await simulation.ended_with(second) == [Code.GOAL_REACHED]
    (failure,) = simulation.seen(second, "failed")
    assert f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over" in failure.text
    assert {word.split("(")[1].split(",")[0] for word in simulation.sent(second)} == {"r1"}
    third = simulation.want("(has r0 p0)")
    assert await simulation.ended_with(third) == [Code.SERVER_UNAVAILABLE], "no other robot will do"
    assert "move(r0, ?, ?)" in simulation.endings[third].message
    assert simulation.endings[third].message.endswith(
        f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over"
    )
    assert not simulation.sent(third)


@simulated(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),)),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_what_a_request_has_that_was_given_up_is_free_when_its_server_reports_late(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    second = simulation.want("(has r0 p0)")
    assert await simulation.ended_with(second) == [Code.GOAL_REACHED]
    assert simulation.seen(second, "sent")[0].time >= 10.0 - 0.1, "when the first one has ended indeed"


@simulated(
    faults=Faults(
        (
            Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),
            Fault("move(r1, a1, a0)", FaultKind.SLOW, times=1),
            Fault("pick(r1, p0, a0)", FaultKind.ABORT),
        )
    ),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0), pick=Binding(resources=("{r}",), retries=0, accept=3.0)),
)
async def test_what_was_waited_for_in_vain_is_planned_with_again_when_it_is_free(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    second = simulation.want("(in p0 a1)")
    await simulation.sees(second, "failed", "r0 is kept")
    await simulation.reaches(second)
    assert robots_of(simulation, second) == {"r0", "r1"}


@simulated()
async def test_what_is_not_there_cannot_be_paused_resumed_or_cancelled(simulation: TaskSimulation):
    task = simulation.want("(at r0 a0)")
    await simulation.ended_with(task)
    for deed in (simulation.master.cancel, simulation.master.resume, lambda one: simulation.master.pause(one, at_once=True)):
        with pytest.raises(TaskRefused, match="is over"):
            await deed(task)
        with pytest.raises(TaskRefused, match="there is no task"):
            await deed(uuid4())


# --- pausing and resuming -------------------------------------------------------------------------


@simulated()
async def test_a_task_that_is_paused_at_a_safe_point_goes_on_where_it_was(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=False)
    assert simulation.state(task) is TaskState.PAUSED
    assert [len(simulation.seen(task, kind)) for kind in ("sent", "ended")] == [1, 1]
    await asyncio.sleep(100.0)
    assert len(simulation.sent(task)) == 1
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert len(simulation.sent(task)) == 2
    assert len(simulation.seen(task, "planned")) == 1


@simulated()
async def test_a_task_that_is_paused_at_once_begins_its_call_anew(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    assert simulation.state(task) is TaskState.PAUSED
    assert "canceled" in simulation.seen(task, "ended")[0].text
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert len(simulation.sent(task)) == 3


@simulated()
async def test_a_task_whose_plan_does_not_work_any_more_after_a_pause_finds_another_way(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    carry(simulation, "r0", "a0", "a3")
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert simulation.sent(task)[1:] == ["move(r0, a3, a2)"]


async def resumed_beside(simulation: TaskSimulation, goal: str, other: str, **how: object) -> tuple[UUID, UUID]:
    """Have a task be resumed when another one has begun with what is in conflict with it."""
    task = await simulation.begun(goal, **how)
    await simulation.master.pause(task, at_once=False)
    newcomer = await simulation.begun(other)
    assert not simulation.seen(newcomer, "state", "waits"), "what is paused keeps nobody waiting"
    await simulation.master.resume(task)
    return task, newcomer


@pytest.mark.parametrize(("goal", "how"), [("(at r0 a3)", {}), ("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", {"is_plan": True})])
@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_waits_for_those_that_have_begun_meanwhile_what_is_in_its_way(
    simulation: TaskSimulation, goal: str, how: dict[str, object]
):
    task, newcomer = await resumed_beside(simulation, goal, "(and (has r0 p1) (at r0 a1))", **how)
    await simulation.sees(task, "state", "queued: waits for")
    count = len(simulation.sent(task))
    await simulation.reaches(newcomer)
    assert len(simulation.sent(task)) == count, "nothing of it began meanwhile"
    assert not simulation.seen(newcomer, "failed")
    await simulation.reaches(task)


@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_plans_around_those_that_have_begun_meanwhile(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(in p1 a7)", "(and (at r1 a4) (has r1 p3))")
    await simulation.reaches(task, newcomer)
    assert not simulation.seen(task, "failed")
    assert not simulation.seen(newcomer, "failed")
    assert robots_of(simulation, newcomer) == {"r1"}
    assert simulation.sent(task)[-1].startswith("drop(r0")


@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_is_refused_beside_others_if_that_is_the_policy(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", on_conflict=OnConflict.REFUSE)
    assert await simulation.ended_with(task, newcomer) == [Code.CONFLICT, Code.GOAL_REACHED]
    assert "which the other" in simulation.endings[task].message


@simulated(fleet(places=8))
async def test_those_of_lower_priority_make_way_for_a_task_that_is_resumed(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", priority=1)
    await simulation.ended_with(task)
    assert newcomer not in simulation.endings
    assert simulation.seen(newcomer, "conflict", "makes way")
    await simulation.reaches(task, newcomer)


@simulated(fleet(places=8))
async def test_a_plan_by_hand_that_was_to_make_room_goes_on_when_nobody_needs_that_any_more(simulation: TaskSimulation):
    task = await simulation.begun("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", is_plan=True)
    first = asyncio.ensure_future(simulation.master.pause(task, at_once=False))
    await simulation.sees(task, "state", "pausing")
    newcomer = simulation.want("(and (has r0 p1) (at r0 a1))")
    await simulation.sees(newcomer, "planned")
    await simulation.master.resume(task)
    await asyncio.sleep(0.1)
    second = asyncio.ensure_future(simulation.master.pause(task, at_once=False))
    await simulation.master.cancel(newcomer)
    assert not simulation.seen(task, "ended"), "its first call is still under way"
    await simulation.master.resume(task)
    await asyncio.gather(first, second)
    await simulation.reaches(task)


@pytest.mark.parametrize("at_once", [False, True])
@simulated(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_does_not_use_up_the_time_of_the_task(simulation: TaskSimulation, at_once: bool):
    task = await simulation.begun("(at r0 a4)")
    for _ in range(2):
        await simulation.master.pause(task, at_once=at_once)
        await asyncio.sleep(100.0)
        await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_gives_the_task_no_more_time_than_it_had(simulation: TaskSimulation):
    task = simulation.want("(at r0 a4)")
    await simulation.sees(task, "ended")
    await simulation.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    simulation.backend.robots.faults = Faults((Fault("move", FaultKind.HANG),))
    resumed = asyncio.get_running_loop().time()
    await simulation.master.resume(task)
    assert await simulation.ended_with(task) == [Code.TIMED_OUT]
    assert simulation.endings[task].message == "the limit of 20 s is reached"
    assert 15.0 < asyncio.get_running_loop().time() - resumed < 20.0, "what it used before the pause counts"


@simulated()
async def test_a_paused_task_can_be_cancelled_and_misses_its_deadline(simulation: TaskSimulation):
    one, two = simulation.want("(at r0 a2)"), simulation.want("(at r1 a3)", deadline=50.0)
    await simulation.sees(one, "sent")
    await simulation.master.pause(None, at_once=False)
    await simulation.master.cancel(one)
    assert await simulation.ended_with(one, two) == [Code.CANCELLED, Code.DEADLINE_MISSED]


@simulated()
async def test_what_comes_while_all_is_paused_waits(simulation: TaskSimulation):
    await simulation.master.pause(None, at_once=False)
    task = simulation.want("(at r0 a2)")
    await asyncio.sleep(100.0)
    assert not simulation.sent(task)
    await simulation.master.resume(None)
    await simulation.reaches(task)


@simulated()
async def test_a_paused_task_keeps_nobody_waiting(simulation: TaskSimulation):
    one = await simulation.begun("(at r0 a2)")
    two = simulation.want("(at r0 a1)")
    await simulation.sees(two, "state", "waits")
    await simulation.master.pause(one, at_once=False)
    await simulation.reaches(two)
    await simulation.master.resume(one)
    await simulation.reaches(one)


@simulated(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)),
    chosen=needing("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_a_task_that_a_pause_leaves_without_a_plan_keeps_nobody_waiting(simulation: TaskSimulation):
    paused = await simulation.begun("(at r0 a1)")
    await simulation.master.pause(paused, at_once=True)
    assert simulation.seen(paused, "replanned"), "its server has not confirmed that it has stopped"
    for goal in ("(at r1 a2)", "(at r1 a1)"):
        await simulation.reaches(simulation.want(goal))


@simulated()
async def test_a_pause_right_after_the_end_was_asked_for_holds_nothing_up(simulation: TaskSimulation):
    task = simulation.want("(at r0 a2)")
    ending = asyncio.ensure_future(simulation.master.cancel(task))
    await asyncio.sleep(0)
    await simulation.master.pause(task, at_once=True)
    assert task in simulation.endings, "the pause of a task that is being cancelled ends with it"
    await ending


@simulated()
async def test_a_pause_right_after_a_resumption_waits_for_what_that_begins(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    going_on = simulation.master._tasks[task]
    going_on.control.resume()
    await going_on.control.pause("", at_once=False)
    assert simulation.state(task) is TaskState.PAUSED
    await asyncio.sleep(0.1)
    assert not simulation.backend.robots._jobs
    await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated()
async def test_a_task_that_is_paused_while_it_plans_stays_so_and_plans_afresh(simulation: TaskSimulation):
    task = simulation.want("(at r0 a2)")
    await simulation.until(lambda: simulation.seen(task, "state", "planning"))
    await simulation.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    assert simulation.state(task) is TaskState.PAUSED
    assert not simulation.seen(task, "planned")
    carry(simulation, "r0", "a0", "a3")
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert simulation.sent(task) == ["move(r0, a3, a2)"]


# --- priorities -----------------------------------------------------------------------------------


@simulated()
async def test_a_higher_goal_preempts_a_lower_one_that_goes_on_by_itself(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a2)")
    high = simulation.want("(at r0 a3)", priority=1)
    await simulation.reaches(high)
    assert simulation.seen(low, "state", "makes way for (at r0 a3)")
    await simulation.reaches(low)
    assert simulation.holds("(at r0 a2)")


@simulated(chosen=needing("lift"))
async def test_a_higher_goal_takes_the_resource_of_a_lower_one_even_if_their_facts_have_nothing_to_do_with_each_other(
    simulation: TaskSimulation,
):
    low = await simulation.begun("(at r0 a2)")
    high = simulation.want("(at r1 a3)", priority=1)
    await simulation.reaches(high, low)
    assert simulation.seen(low, "conflict", "makes way")
    assert simulation.ended_at(high) < simulation.ended_at(low)


@simulated(chosen=needing("lift"))
async def test_equal_goals_that_share_a_resource_take_turns(simulation: TaskSimulation):
    tasks = [simulation.want("(at r0 a2)"), simulation.want("(at r1 a3)")]
    await simulation.reaches(*tasks)
    assert not any(simulation.seen(task, "conflict") for task in tasks)


@simulated()
async def test_a_task_that_was_preempted_and_paused_goes_on_when_both_are_over(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a2)")
    high = await simulation.begun("(at r0 a3)", priority=1)
    await simulation.master.pause(low, at_once=True)
    await simulation.reaches(high)
    assert simulation.state(low) is TaskState.PAUSED
    await simulation.master.resume(low)
    await simulation.reaches(low)


@simulated()
async def test_nobody_is_held_up_by_a_task_that_is_paused(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a1)")
    high = await simulation.begun("(at r0 a3)", priority=1)
    assert simulation.state(low) is TaskState.PAUSED
    await simulation.master.pause(high, at_once=True)
    await simulation.reaches(low)
    await simulation.master.resume(high)
    await simulation.reaches(high)
    assert simulation.holds("(at r0 a3)")


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


@simulated(fleet(robots=2, parcels=3, places=8), chosen=needing("lift", pick=ASKING), source=Person())
async def test_nobody_is_held_up_by_a_task_that_only_waits_for_an_answer(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a4)")
    high = simulation.want("(has r1 p2)", priority=1)
    await simulation.reaches(low, high)
    assert simulation.seen(low, "state", "makes way"), "what the other one does first needs the lift"
    assert simulation.ended_at(low) < simulation.seen(high, "sent", "pick")[0].time
    assert len(simulation.seen(low, "conflict")) == 1


# --- failures and changes while others go on ------------------------------------------------------


BOTH = "(and (at r0 a1) (at r1 a2))"
ONE_FAILS_AND_ONE_IS_SLOW = Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT), Fault("move(r1, a1, a2)", FaultKind.SLOW, times=1)))
A_WAY_IS_BLOCKED = Faults(changes=(HiddenChange({("way", "a1", "a2"): False}, at=0.5),))


@simulated(faults=ONE_FAILS_AND_ONE_IS_SLOW, chosen=ONCE)
async def test_what_is_under_way_goes_on_while_another_way_is_found(simulation: TaskSimulation):
    task = simulation.want(BOTH)
    await simulation.sees(task, "failed", "move(r0, a0, a1)")
    await simulation.sees(task, "sent", "move(r0, a0, a3)")
    assert not simulation.seen(task, "ended", "move(r1, a1, a2)"), "r1 is still on its way"
    await simulation.reaches(task)
    assert simulation.sent(task).count("move(r1, a1, a2)") == 1, "and was never sent again"


@pytest.mark.parametrize(("policy", "ends"), [(OnFailure.DRAIN, "succeeded"), (OnFailure.CANCEL, "canceled")])
def test_other_policies_end_what_is_under_way_first(policy: OnFailure, ends: str):
    @simulated(faults=ONE_FAILS_AND_ONE_IS_SLOW, chosen=replace(ONCE, on_failure=policy))
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want(BOTH)
        await simulation.sees(task, "sent", "move(r0, a0, a3)")
        assert ends in simulation.seen(task, "ended", "move(r1, a1, a2)")[0].text
        await simulation.reaches(task)

    scenario()


@simulated(fleet(places=6), faults=A_WAY_IS_BLOCKED)
async def test_a_change_that_breaks_the_rest_of_the_plan_is_acted_on_at_once(simulation: TaskSimulation):
    task = simulation.want("(at r0 a2)")
    await simulation.sees(task, "replanned")
    assert simulation.seen(task, "replanned")[0].time == pytest.approx(0.5, abs=0.1)
    await simulation.reaches(task)
    assert not simulation.seen(task, "failed")
    assert simulation.sent(task) == ["move(r0, a0, a1)", *(f"move(r0, a{n}, a{m})" for n, m in ((1, 0), (0, 5), (5, 4), (4, 3), (3, 2)))]


@simulated(fleet(places=6), faults=A_WAY_IS_BLOCKED, chosen=replace(USUAL, on_change=OnChange.LAZY))
async def test_a_lazy_task_finds_out_when_a_call_fails(simulation: TaskSimulation):
    task = simulation.want("(at r0 a2)")
    await simulation.reaches(task)
    assert simulation.seen(task, "failed", "precondition_false")


SOMEBODY_BRINGS_IT = HiddenChange({("in", "p0", "a0"): False, ("in", "p0", "a2"): True, ("has", "r0", "p0"): False}, at=1.5)


@simulated(fleet(robots=1), faults=Faults(changes=(SOMEBODY_BRINGS_IT,)))
async def test_a_goal_that_comes_true_by_itself_is_taken(simulation: TaskSimulation):
    task = simulation.want("(in p0 a2)")
    await simulation.reaches(task)
    assert len(simulation.sent(task)) <= 2


SOMEBODY_CARRIES_IT_ON = HiddenChange({("at", "r0", "a0"): False, ("at", "r0", "a1"): False, ("at", "r0", "a2"): True}, at=1.5)


@simulated(fleet(places=8), faults=Faults(changes=(SOMEBODY_CARRIES_IT_ON,)))
async def test_calls_that_have_become_needless_are_left_out(simulation: TaskSimulation):
    task = simulation.want("(at r0 a4)")
    await simulation.reaches(task)
    assert not simulation.seen(task, "failed")


@simulated(faults=Faults((Fault("pick", FaultKind.ABORT, message="the gripper is stuck"),)))
async def test_a_task_that_can_do_no_more_says_what_failed(simulation: TaskSimulation):
    task = simulation.want("(in p0 a2)")
    assert await simulation.ended_with(task) == [Code.ACTION_FAILED]
    assert "the gripper is stuck" in simulation.endings[task].message


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

    @simulated(fleet(robots=3, parcels=parcels, places=places), faults=Faults(faults))
    async def scenario(simulation: TaskSimulation) -> None:
        wanted = [f"(in p{n} a{rng.randrange(places)})" for n in range(parcels)]
        tasks = []
        for text in wanted:
            tasks.append(simulation.want(text, priority=rng.choice([0, 0, 0, 1]), on_conflict=rng.choice([None, OnConflict.QUEUE])))
            await asyncio.sleep(rng.choice([0.0, 0.0, 0.7, 3.0]))
            if rng.random() < 0.2:
                chosen = rng.choice([None, *tasks])
                if chosen is None or chosen not in simulation.endings:
                    await simulation.master.pause(chosen, at_once=rng.random() < 0.5)
                    await asyncio.sleep(rng.choice([0.0, 2.0]))
                    await simulation.master.resume(None)
        codes = await simulation.ended_with(*tasks)
        for text, code in zip(wanted, codes, strict=True):
            if code is Code.GOAL_REACHED:
                assert simulation.holds(text)
            else:
                assert code in (Code.ACTION_FAILED, Code.NO_PLAN, Code.CONDITION_LOST, Code.SERVER_UNAVAILABLE, Code.TIMED_OUT), code

    scenario()
