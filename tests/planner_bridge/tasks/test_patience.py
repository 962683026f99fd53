"""Goals without a plan: they wait for facts to change, as long as they have patience."""

from __future__ import annotations

import asyncio

import pytest

from planner_bridge.model.world import robots_of, simulated_backend
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError
from tests.support.pddl.problems import rooms
from tests.support.tasks.replanning import pursued

DOOR = ("way", "b", "c")


class Listener(TaskObserver):
    """Notes why a task is blocked."""

    def __init__(self) -> None:
        self.reasons: list[str] = []

    def blocked(self, reason: str) -> None:
        self.reasons.append(reason)


def closed(goal: str = "(at r1 c)", ways: str = "ab"):
    return rooms(init="(at r1 a)", goal=goal, ways=ways)


def opens(at: float) -> Faults:
    return Faults(changes=(HiddenChange({DOOR: True}, at=at),))


def test_patience_ends_with_the_reason() -> None:
    result, _ = pursued(closed(), opens(at=20.0), limits=Limits(patience=5.0))
    assert not result.goal_reached
    assert result.reason.startswith("no plan: proved unsolvable: (at r1 c) cannot be reached")


def test_what_changes_but_does_not_help_does_not_begin_the_wait_anew() -> None:
    useless = tuple(HiddenChange({("way", "d", "a"): bool(number % 2)}, at=number) for number in range(1, 40))
    result, _ = pursued(closed(), Faults(changes=useless), limits=Limits(patience=5.0))
    assert not result.goal_reached


def test_a_goal_waits_until_a_door_opens() -> None:
    listener, problem = Listener(), closed()
    backend = simulated_backend(problem, Settings().bindings, opens(at=20.0))
    task = achieve_at(backend, problem, Settings(limits=Limits(patience=60.0)), listener)
    result = run_async(task, virtual=True)
    assert result.goal_reached
    (reason,) = listener.reasons
    assert reason.startswith("waits 60 s at most for facts to change: no plan: proved unsolvable: (at r1 c) cannot be reached")


def test_a_task_whose_way_is_closed_while_it_is_on_it_waits_as_well() -> None:
    closes, opens_again = HiddenChange({DOOR: False}, at=0.5), HiddenChange({DOOR: True}, at=30.0)
    problem, faults = closed(ways="ab bc"), Faults(changes=(closes, opens_again))
    assert not pursued(problem, faults)[0].goal_reached
    result, _ = pursued(problem, faults, limits=Limits(patience=60.0))
    assert result.goal_reached
    assert result.replans == 1


def test_a_task_that_waits_is_cancelled_at_once() -> None:
    problem = closed()
    backend = simulated_backend(problem, Settings().bindings, Faults())

    async def scenario():
        pursuing = asyncio.ensure_future(achieve_at(backend, problem, Settings(limits=Limits(patience=1e6)), TaskObserver()))
        await asyncio.sleep(10.0)
        pursuing.cancel()
        return await pursuing, asyncio.get_running_loop().time()

    result, now = run_async(scenario(), virtual=True)
    assert result.code.word == "cancelled"
    assert now < 100.0


@pytest.mark.parametrize("patience", [-1.0, float("inf"), "long"])
def test_what_is_no_patience_is_refused(patience) -> None:
    with pytest.raises(InputError, match="a new plan waits for"):
        Limits(patience=patience)


class BusyElsewhere(SimulatedBackend):
    """Simulated robots whose server is at work on a goal of another program, for a while."""

    def __init__(self, until: float) -> None:
        super().__init__(robots_of(closed(), Bindings(), opens(at=until)))
        self.until = until
        self.looks: list[float] = []

    async def busy_elsewhere(self) -> tuple[str, ...]:
        self.looks.append(asyncio.get_running_loop().time())
        return ("/r1/move",) if self.looks[-1] - self.looks[0] < self.until else ()


@pytest.mark.parametrize(("until", "is_reached"), [(20.0, True), (100.0, False)])
def test_nothing_is_called_unsolvable_while_servers_are_at_work_for_others(until: float, is_reached: bool) -> None:
    listener, backend = Listener(), BusyElsewhere(until)
    result = run_async(achieve_at(backend, closed(), Settings(), listener), virtual=True)
    assert result.goal_reached is is_reached
    busy = "no plan, while /r1/move is at work on goals of other programs: "
    assert listener.reasons[0].startswith(f"waits 60 s at most for facts to change: {busy}")
    assert "proved" not in "".join(listener.reasons) + result.reason
    if not is_reached:
        assert result.reason.startswith(busy)
        assert backend.looks[-1] - backend.looks[0] == pytest.approx(60.0, abs=2.0)
