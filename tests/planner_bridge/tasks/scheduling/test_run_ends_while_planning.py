"""A run that ends while the plan that should succeed it becomes a graph."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from uuid import UUID

from planner_bridge.model.plan import Plan
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import ClientBackend
from pnm.clock import run_async
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Request
from tests.support.pddl.problems import fleet

FAILING, SLOW = "move(r0, a0, a1)", "move(r1, a1, a2)"


@dataclass
class Robots(TaskObserver):
    """The first robot fails once; the second one fails when the plan without that failure has been found."""

    actions: list[str] = field(default_factory=list)
    plans: int = 0
    end: Callable[[], None] | None = None

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Callable[[Accepted | Ended], None], /) -> None:
        action, loop = str(request.action), asyncio.get_running_loop()
        is_first = action not in self.actions
        self.actions.append(action)
        loop.call_soon(report, Accepted(request.id))
        if is_first and action == SLOW:
            self.end = lambda: report(Ended(request.id, Outcome(OutcomeKind.ABORTED)))
        else:
            kind = OutcomeKind.ABORTED if is_first and action == FAILING else OutcomeKind.SUCCEEDED
            loop.call_later(1.0, report, Ended(request.id, Outcome(kind)))

    def cancel(self, request: UUID, /) -> None:
        raise AssertionError("nothing is cancelled")

    def planned(self, plan: Plan) -> None:
        self.plans += 1
        if self.plans == 2:
            assert self.end, "the second robot is under way"
            asyncio.get_running_loop().call_soon(self.end)


def test_a_plan_that_counts_on_what_was_under_way_is_not_begun_when_the_run_has_ended_meanwhile() -> None:
    robots = Robots()
    bindings = Bindings({"move": Binding(retries=0)})
    settings = Settings(bindings=bindings, limits=Limits(forbid_after=1, backoff=0.0), on_failure=OnFailure.CONTINUE_OTHERS)
    problem = fleet(goal="(and (at r0 a1) (at r1 a2))")
    result = run_async(achieve_at(ClientBackend(robots), problem, settings, robots), virtual=True)
    assert result.goal_reached, result.reason
    assert (robots.actions.count(FAILING), robots.actions.count(SLOW)) == (1, 1), "both go another way"
