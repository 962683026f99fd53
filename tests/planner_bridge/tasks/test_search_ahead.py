"""A search that begins while late reports are waited for: its answer is taken if they bring nothing new."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from planner_bridge.model.plan import CancelToken, PlanningResult
from planner_bridge.model.problem import Problem
from planner_bridge.planning.solve import solve
from planner_bridge.tasks import plan_search
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from tests.support.pddl.problems import fleet
from tests.support.runs.simulated import LateBackend
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

CALL = "move(r0, a0, a1)"
LAZY = Settings(bindings=Bindings({"move": Binding(retries=0)}), on_change=OnChange.LAZY)
LAG = 1.0
"""Of `LateBackend`."""


@dataclass
class Searches:
    """The searches so far: when each began, on the clock of the tasks, its problem, and the token that ends it."""

    begun: list[tuple[float, Problem, CancelToken]] = field(default_factory=list)
    clock: Callable[[], float] = lambda: 0.0
    over: list[bool] = field(default_factory=list)
    """Of each, whether its token was set when the request after the failure was sent."""

    def solve(self, problem: Problem, *, cancel: CancelToken, **chosen: Any) -> PlanningResult:
        self.begun.append((self.clock(), problem, cancel))
        return solve(problem, cancel=cancel, **chosen)


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> Searches:
    noted = Searches()
    monkeypatch.setattr(plan_search, "solve", noted.solve)
    return noted


def after_failure(searches: Searches, *, forbid_after: int, news: bool = False) -> tuple[float, float]:
    """Carry out a call that is aborted once, and what follows; return when it failed, and when the next request was sent."""
    found: list[float] = []

    async def scenario(simulation: TaskSimulation) -> None:
        searches.clock = asyncio.get_running_loop().time
        task = simulation.want("(at r0 a1)")
        await simulation.sees(task, "failed", CALL)
        found.append(searches.clock())
        if news:
            await asyncio.sleep(LAG / 2)
            simulation.knowledge.update({("in", "p3", "a3"): False, ("in", "p3", "a1"): True})
        await simulation.sees(task, "sent", "move(r0, a0", times=2)
        found.append(searches.clock())
        searches.over += (token.is_set() for _, _, token in searches.begun)
        await simulation.reaches(task)

    def late(problem: Problem, bindings: Bindings, faults: Faults) -> LateBackend:
        return LateBackend(problem, faults, bindings)

    once = Faults((Fault(CALL, FaultKind.ABORT, times=1),))
    chosen = replace(LAZY, limits=Limits(forbid_after=forbid_after, replans=5, backoff=0.0))
    simulate_tasks(scenario, fleet(), faults=once, chosen=chosen, make_backend=late)
    failed, sent = found
    return failed, sent


def test_the_answer_of_a_search_that_began_with_the_failure_is_taken_when_no_report_brings_anything_new(searches: Searches) -> None:
    failed, sent = after_failure(searches, forbid_after=1)
    assert sent - failed >= LAG, "reports are waited for all the same"
    assert [time for time, _, _ in searches.begun[1:]] == [pytest.approx(failed)]
    assert searches.over == [False, False]


def test_what_has_become_known_since_is_planned_with(searches: Searches) -> None:
    failed, sent = after_failure(searches, forbid_after=1, news=True)
    _, (ahead, _, _), (again, problem, _) = searches.begun
    assert (ahead, again) == (pytest.approx(failed), pytest.approx(sent))
    assert searches.over == [False, True, False]
    assert problem.init[("in", "p3", "a1")] is True


def test_the_search_ends_when_the_rest_of_the_plan_is_resumed(searches: Searches) -> None:
    after_failure(searches, forbid_after=2)
    assert searches.over == [False, True]
