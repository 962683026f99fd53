"""A goal that several robots could reach goes to the one that reaches it soonest, though others may be free before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from planner_bridge.model.plan import PlanningResult
from planner_bridge.planning.solve import solve
from planner_bridge.tasks import plan_search
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Code, OnConflict
from tests.support.pddl.vans import vans
from tests.support.tasks.node import EAGER, robots_of, simulated
from tests.support.tasks.simulation import TaskSimulation

DRIVING = replace(EAGER, bindings=Bindings({name: Binding(resources=("{v}",), retries=0) for name in ("drive", "serve")}))
NEAR_AND_FAR = vans("v1 home v2 depot", "home near 15", "depot far 10", "near shop 1", "far shop 60")
"""v2 is free first, but v1 is nearer to the shop then."""


@simulated(vans("v1 home v2 depot", "home near 100", "depot far 10", "near shop 1", "far shop 60"), chosen=DRIVING)
async def test_it_goes_to_the_robot_that_is_free_sooner(simulation: TaskSimulation):
    others = [await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")]
    served = simulation.want("(served shop)")
    await simulation.reaches(served)
    assert robots_of(simulation, served) == {"v2"}
    await simulation.reaches(*others)


@simulated(NEAR_AND_FAR, chosen=DRIVING)
async def test_it_goes_to_the_robot_that_is_free_later_if_that_does_it_sooner(simulation: TaskSimulation):
    one, two = await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")
    served = simulation.want("(served shop)")
    await simulation.reaches(two, one, served)
    assert robots_of(simulation, served) == {"v1"}
    assert "(at v1 near)" in simulation.seen(served, "state", "waits for")[0].text


@simulated(vans("v1 home v2 depot", "home near 15", "near shop 1", "depot shop 60"), chosen=DRIVING)
async def test_it_waits_for_a_busy_robot_that_does_it_sooner_than_an_idle_one(simulation: TaskSimulation):
    one = await simulation.begun("(at v1 near)")
    served = simulation.want("(served shop)")
    await simulation.reaches(one, served)
    assert robots_of(simulation, served) == {"v1"}


@simulated(vans("v1 home v2 depot", "home near 60", "near shop 1", "depot shop 60"), chosen=DRIVING)
async def test_it_begins_at_once_with_an_idle_robot_that_does_it_no_later(simulation: TaskSimulation):
    one = await simulation.begun("(at v1 near)")
    served = simulation.want("(served shop)")
    await simulation.reaches(served, one)
    assert robots_of(simulation, served) == {"v2"}
    assert not simulation.seen(served, "state", "waits for")


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


@simulated(vans("v1 home v2 depot", "home near 15", "depot far 20", "near shop 1", "far shop 1", "near far 5"), chosen=DRIVING)
async def test_of_several_goals_each_gets_its_robot(simulation: TaskSimulation):
    busy = [await simulation.begun("(at v1 near)"), await simulation.begun("(at v2 far)")]
    goals = [simulation.want("(served shop)"), simulation.want("(served far)")]
    await simulation.reaches(*busy, *goals)


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
