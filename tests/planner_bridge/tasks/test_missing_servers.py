"""Action servers that are missing: one failure, told once, and waited for; other actions of the same server wait with it."""

from __future__ import annotations

import asyncio

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Code
from tests.support.pddl.problems import rooms

ONE = Bindings({name: Binding(server="/execute_action", retries=8) for name in ("move", "sweep")})
GONE = Faults((Fault("move(r1, b, c)", FaultKind.LOSE_SERVER, times=1),))
TO_DO = rooms(init="(at r1 a)", goal="(and (clean b) (at r1 c))", ways="ab bc ba ad dc cb")


class Told(TaskObserver):
    def __init__(self) -> None:
        self.reasons: list[str] = []

    def blocked(self, reason: str) -> None:
        self.reasons.append(reason)


def after_loss(problem: Problem, back: float | None = None) -> tuple[TaskResult, list[str]]:
    """Return the result of a task whose server goes away, and comes back after these seconds; and what it waited for."""
    told, backend = Told(), SimulatedBackend(robots_of(problem, ONE, GONE))

    async def scenario() -> TaskResult:
        if back is not None:
            asyncio.get_running_loop().call_later(back, backend.robots.lost.clear)
        return await achieve_at(backend, problem, Settings(bindings=ONE), told)

    return run_async(scenario(), virtual=True), told.reasons


def test_a_dead_server_is_one_failure_and_no_other_action_of_it_is_tried() -> None:
    result, told = after_loss(TO_DO)
    assert result.code is Code.SERVER_UNAVAILABLE
    assert [(str(failure.call), failure.cause) for failure in result.failures] == [("move(r1, b, c)#2", "unavailable")]
    assert sum(call.attempts for call in result.calls if str(call.call) == "move(r1, b, c)#2") == 2, (
        "one that was lost, and one that found nobody"
    )
    assert len(told) == 1
    assert told[0] == "waits 15 s at most for /execute_action: no plan without the action server /execute_action, which is missing"
    failure = "last failure: move(r1, b, c)#2: unavailable: there is no server /execute_action"
    assert result.reason == f"{failure}; no plan without the action server /execute_action, which is missing"


def test_a_server_that_comes_back_goes_on_with_what_is_left() -> None:
    result, told = after_loss(TO_DO, back=10.0)
    assert result.goal_reached, result.reason
    assert (len(told), len(result.failures)) == (1, 1)
    assert [str(call.call.action) for call in result.calls if call.outcome == "succeeded"].count("move(r1, a, b)") == 1
