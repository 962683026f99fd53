"""Several goals at once, over shared robots, in simulation."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.ordering.interference import ReadWriteSets, interference
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.context import Conflict, Preemption
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange
from planner_bridge.tasks.task import Task
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.tasks import Code, OnConflict, TaskState
from tests.support.files import ROOT
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import EAGER, USUAL, carry, robots_of, simulated
from tests.support.tasks.scenarios.random_scenarios import run_scenario
from tests.support.tasks.simulation import TaskSimulation

ONCE = replace(USUAL, limits=Limits(forbid_after=1))
"""What has failed is not tried again in a new plan either."""


def delivery() -> Problem:
    """Robots that are at no place while they drive."""
    return load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")


DRIVING = replace(EAGER, bindings=Bindings({"move": Binding(resources=("{robot}",), retries=0)}))


# --- several goals ---


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
    assert "it is expected to be done with (at r1 kitchen) in 7 s" in simulation.seen(two, "state", "waits for")[0].text
    assert await simulation.ended_with(three) == [Code.CONFLICT]
    assert "it has begun move(r1, store, hall)" in simulation.endings[three].message
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


BOTH = "(and (at r0 a1) (at r1 a2))"
ONE_FAILS_AND_ONE_IS_SLOW = Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT), Fault("move(r1, a1, a2)", FaultKind.SLOW, times=1)))
A_WAY_IS_BLOCKED = Faults(changes=(HiddenChange({("way", "a1", "a2"): False}, at=0.5),))


# --- failures and changes while others go on ---


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


# --- many ---


BROKEN = {
    75: "paused right after it was cancelled",
    76: "over while it was told to make way",
    175: "what is under way does not fit into the plan that was found",
    243: "what made way for another was let go before that one was over",
    272: "what a pause lets come to its end was not seen by others",
    10875: "paused right after it was resumed",
    44: "what a plan by hand needs was not noted when it began",
    54: "what a plan needs was not noted when it followed another one",
}
"""Scripts that went wrong once, of the last two with a part left out."""


@pytest.mark.parametrize("number", BROKEN)
def test_a_random_script_is_played_to_its_end(number: int, monkeypatch: pytest.MonkeyPatch):
    """And the index of plans overlooks no conflict, whatever has become of the plans: the oracle looks at all of them."""
    of_index = Preemption.conflicts

    def conflicts(scheduler: Preemption, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        found, its = of_index(scheduler, task, footprint), footprint()
        others = ((other.id, other.control.footprint) for other in scheduler._others(task, scheduler._tasks.values()))
        assert [one.task for one in found] == [other for other, sets in others if sets and interference(its, sets)]
        return found

    monkeypatch.setattr(Preemption, "conflicts", conflicts)
    run_scenario(number)
