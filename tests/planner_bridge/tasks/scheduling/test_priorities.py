"""Who goes first: priorities of tasks, and the robot that reaches a goal soonest, though others may be free before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from planner_bridge.model.plan import PlanningResult
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.tasks import plan_search
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Code, OnConflict, TaskState
from tests.support.pddl.problems import fleet
from tests.support.pddl.vans import vans
from tests.support.tasks.node import EAGER, SlowPerson, everything_needs, robots_of, simulated
from tests.support.tasks.simulation import TaskSimulation


@simulated()
async def test_a_higher_goal_preempts_a_lower_one_that_goes_on_by_itself(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a2)")
    high = simulation.want("(at r0 a3)", priority=1)
    await simulation.reaches(high)
    assert simulation.seen(low, "state", "makes way for (at r0 a3)")
    await simulation.reaches(low)
    assert simulation.holds("(at r0 a2)")


@simulated(chosen=everything_needs("lift"))
async def test_a_higher_goal_takes_the_resource_of_a_lower_one_even_if_their_facts_have_nothing_to_do_with_each_other(
    simulation: TaskSimulation,
):
    low = await simulation.begun("(at r0 a2)")
    high = simulation.want("(at r1 a3)", priority=1)
    await simulation.reaches(high, low)
    assert simulation.seen(low, "conflict", "makes way")
    assert simulation.ended_at(high) < simulation.ended_at(low)


@simulated(chosen=everything_needs("lift"))
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


@simulated(chosen=EAGER)
async def test_all_are_resumed_at_once_and_who_makes_way_still_does(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a2)")
    high = await simulation.begun("(at r0 a3)", priority=1)
    await simulation.master.pause(None, at_once=True)
    sent = len(simulation.sent(low))
    await simulation.master.resume(None)
    await simulation.reaches(high)
    assert len(simulation.sent(low)) == sent, "it makes way until the other one is over"
    await simulation.reaches(low)


@simulated(chosen=EAGER, faults=Faults((Fault("move", FaultKind.HANG, after=2, times=1, ignores_cancel=True),)))
async def test_who_is_resumed_waits_until_nothing_is_under_way_of_those_that_make_way(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a1)")
    high = await simulation.begun("(at r0 a3)", priority=1)
    await simulation.master.pause(high, at_once=True)
    await simulation.sees(low, "sent", times=2)
    sent = len(simulation.sent(high))
    await simulation.master.resume(high)
    assert len(simulation.sent(high)) == sent
    await simulation.sees(high, "state", "waits until (at r0 a1)")
    await simulation.sees(low, "failed")
    assert len(simulation.sent(high)) == sent, "a robot that has not confirmed that it has stopped gets no other command"
    await simulation.ended_with(high, low)


ASKING = Binding(resources=("lift",), retries=0, ask={"word": "May I?"}, goal={"word": "$word"})


@simulated(fleet(robots=2, parcels=3, places=8), chosen=everything_needs("lift", pick=ASKING), source=SlowPerson())
async def test_nobody_is_held_up_by_a_task_that_only_waits_for_an_answer(simulation: TaskSimulation):
    low = await simulation.begun("(at r0 a4)")
    high = simulation.want("(has r1 p2)", priority=1)
    await simulation.reaches(low, high)
    assert simulation.seen(low, "state", "makes way"), "what the other one does first needs the lift"
    assert simulation.ended_at(low) < simulation.seen(high, "sent", "pick")[0].time
    assert len(simulation.seen(low, "conflict")) == 1


KITCHEN = """
(define (domain kitchen)
  (:requirements :durative-actions)
  (:predicates (cold) (warm) (baked) (served))
  (:durative-action heat :parameters () :duration (= ?duration 8)
    :condition (and (at start (cold)) (over all (warm)))
    :effect (and (at start (not (cold))) (at start (warm)) (at end (not (warm)))))
  (:durative-action bake :parameters () :duration (= ?duration 5) :condition (over all (warm)) :effect (at end (baked)))
  (:durative-action serve :parameters () :duration (= ?duration 1) :condition (at start (cold)) :effect (at end (served))))
"""
PROBLEM = parse_problem("(define (problem p) (:domain kitchen) (:init (cold)) (:goal (and)))", parse_domain(KITCHEN))
ASKED_BEFORE = replace(EAGER, bindings=Bindings({"bake": Binding(ask={"word": "May I?"}, goal={"word": "$word"})}))


@simulated(PROBLEM, chosen=ASKED_BEFORE, source=SlowPerson())
async def test_nobody_waits_for_a_call_that_is_over_and_only_waits_for_another_one_of_a_task_that_makes_way(simulation: TaskSimulation):
    low = await simulation.begun("(baked)")
    await simulation.sees(low, "ended", "heat")  # whose end counts once what needs it warm has been baked, and that waits for an answer
    high = simulation.want("(served)", priority=1)  # there would be a plan if heating could still be undone
    assert await simulation.ended_with(high, low) == [Code.NO_PLAN, Code.CONDITION_LOST]


# --- who reaches it soonest ---


DRIVING = replace(EAGER, bindings=Bindings({name: Binding(resources=("{v}",), retries=0) for name in ("drive", "serve")}))
NEAR_AND_FAR = vans("v1 home v2 depot", "home near 15", "depot far 10", "near shop 1", "far shop 60")
"""v2 is free first, but v1 is nearer to the shop then."""


@pytest.mark.parametrize(
    ("ways", "busy", "chosen", "waits"),
    [
        (("home near 100", "depot far 10", "near shop 1", "far shop 60"), ("v1 near", "v2 far"), "v2", True),  # is free sooner
        (("home near 15", "depot far 10", "near shop 1", "far shop 60"), ("v1 near", "v2 far"), "v1", True),  # is free later, and nearer
        (("home near 15", "near shop 1", "depot shop 60"), ("v1 near",), "v1", True),  # is busy, and does it sooner than the idle one
        (("home near 60", "near shop 1", "depot shop 60"), ("v1 near",), "v2", False),  # is idle, and does it no later
    ],
)
def test_it_goes_to_the_robot_that_does_it_soonest(ways: tuple[str, ...], busy: tuple[str, ...], chosen: str, waits: bool):
    @simulated(vans("v1 home v2 depot", *ways), chosen=DRIVING)
    async def scenario(simulation: TaskSimulation) -> None:
        others = [await simulation.begun(f"(at {place})") for place in busy]
        served = simulation.want("(served shop)")
        await simulation.reaches(served, *others)
        assert robots_of(simulation, served) == {chosen}
        assert bool(simulation.seen(served, "state", f"waits for (at {chosen} ")) is waits

    scenario()


@simulated(vans("v1 home v2 depot", "home near 100", "depot far 10", "near shop 1", "far shop 20"), chosen=DRIVING)
async def test_it_gets_a_robot_as_soon_as_a_task_of_several_is_done_with_it(simulation: TaskSimulation):
    both = simulation.want("(and (at v1 near) (served far))")
    await simulation.sees(both, "sent", "drive(v2")
    served = simulation.want("(served shop)")
    await simulation.reaches(served)
    assert robots_of(simulation, served) == {"v2"}
    assert both not in simulation.endings
    await simulation.reaches(both)


PATIENT = replace(DRIVING, bindings=Bindings({"drive": Binding(resources=("{v}",), retries=0, timeout=10000.0)}))


@simulated(NEAR_AND_FAR, faults=Faults((Fault("drive(v1, home, near)", FaultKind.HANG),)), chosen=PATIENT)
async def test_it_goes_to_another_robot_when_the_one_that_it_waits_for_is_too_late(simulation: TaskSimulation):
    one, two = await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")
    served = simulation.want("(served shop)")
    await simulation.sees(served, "state", "waits for (at v1 near)")
    await simulation.reaches(two, served)
    assert robots_of(simulation, served) == {"v2"}
    await simulation.master.cancel(one)


@pytest.mark.parametrize("policy", [OnConflict.REFUSE, OnConflict.QUEUE])
def test_with_other_policies_it_does_not_choose_whom_to_wait_for(policy: OnConflict):
    @simulated(NEAR_AND_FAR, chosen=DRIVING)
    async def scenario(simulation: TaskSimulation) -> None:
        one, two = await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")
        served = simulation.want("(served shop)", on_conflict=policy)
        await simulation.reaches(one, two)
        expected = Code.CONFLICT if policy is OnConflict.REFUSE else Code.GOAL_REACHED
        assert await simulation.ended_with(served) == [expected]

    scenario()


@simulated(NEAR_AND_FAR, chosen=DRIVING)
async def test_it_does_not_wait_for_a_task_that_is_paused(simulation: TaskSimulation):
    one, two = await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")
    served = simulation.want("(served shop)")
    await simulation.sees(served, "state", "waits for (at v1 near)")
    await simulation.master.pause(one, at_once=True)
    await simulation.reaches(two, served)
    assert one not in simulation.endings
    await simulation.master.resume(one)
    await simulation.reaches(one)


def test_the_search_for_whom_to_wait_is_short_because_others_wait_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds: list[float] = []

    def noted(problem: Any, *, timeout: float, **chosen: Any) -> PlanningResult:
        seconds.append(timeout)
        return solve(problem, timeout=timeout, **chosen)

    monkeypatch.setattr(plan_search, "solve", noted)

    @simulated(NEAR_AND_FAR, chosen=DRIVING)
    async def scenario(simulation: TaskSimulation) -> None:
        one, two = await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")
        assert set(seconds) == {DRIVING.planner_timeout}
        await simulation.reaches(two, one, simulation.want("(served shop)"))

    scenario()
    assert min(seconds) == pytest.approx(DRIVING.planner_timeout / 10)
