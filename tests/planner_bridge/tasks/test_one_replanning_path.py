"""Replanning is the same whether the run is over or other calls are under way: back-off, late reports, given plans, `replan`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.model.plan import CancelToken, PlanningResult
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import solve
from planner_bridge.tasks import plan_search
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.yaml.reader import read
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.language.plan import read_plans
from pnm.language.runner import Program
from pnm.tasks import Code, TaskState
from tests.support.files import ROOT
from tests.support.pddl.problems import fleet
from tests.support.runs.simulated import LateBackend
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks
from tests.support.yaml.run_plans import BLOCKED, PATROL

NO_RETRY = Bindings({name: Binding(retries=0) for name in ("move", "pick", "drop")})
SERVED = Settings(bindings=NO_RETRY, on_change=OnChange.EAGER, on_failure=OnFailure.CONTINUE_OTHERS)
"""As `pnm serve` has it if nothing else is chosen."""
ALWAYS_ABORTED = Fault("move(r0, a0, a1)", FaultKind.ABORT)
NEVER_ENDS, SLOW = (Fault("move(r1, a1, a2)", kind) for kind in (FaultKind.HANG, FaultKind.SLOW))
BESIDE, ALONE = "(and (at r0 a1) (at r1 a2))", "(at r0 a1)"
CALL = "move(r0, a0, a1)"


def times_sent(simulation: TaskSimulation, task: UUID, call: str = CALL) -> list[float]:
    return [event.time for event in simulation.seen(task, "sent", call)]


def with_back_off(first: float, longest: float) -> Settings:
    return replace(SERVED, limits=Limits(forbid_after=100, without_progress=100, backoff=first, longest_backoff=longest))


@pytest.mark.parametrize("goal", [BESIDE, ALONE], ids=["another call is under way", "nothing is under way"])
@simulated(faults=Faults((ALWAYS_ABORTED, NEVER_ENDS)), chosen=with_back_off(0.5, 4.0))
async def test_attempts_that_fail_for_ever_are_spaced_by_the_back_off(simulation: TaskSimulation, goal: str) -> None:
    task = simulation.want(goal)
    await simulation.sees(task, "sent", CALL, times=8)
    times = times_sent(simulation, task)
    took = simulation.seen(task, "failed")[0].time - times[0]
    pauses = [later - earlier - took for earlier, later in pairwise(times)]
    assert pauses == pytest.approx([0.0, 0.5, 1.0, 2.0, 4.0, 4.0, 4.0], abs=0.2)
    assert simulation.sent(task).count("move(r1, a1, a2)") == (goal == BESIDE), "what is under way is handed on"
    await simulation.master.cancel(task)


@simulated(faults=Faults((ALWAYS_ABORTED, SLOW)), chosen=with_back_off(50.0, 50.0))
async def test_what_is_under_way_goes_on_during_the_back_off_which_does_not_begin_anew_at_its_end(simulation: TaskSimulation) -> None:
    task = simulation.want(BESIDE)
    await simulation.sees(task, "ended", "move(r1, a1, a2)")
    assert len(times_sent(simulation, task)) == 2, "it was tried once more at once, and then the back-off began"
    await simulation.sees(task, "sent", CALL, times=3)
    second_failure = simulation.seen(task, "failed", CALL)[1].time
    assert times_sent(simulation, task)[2] - second_failure == pytest.approx(50.0, abs=0.2)
    assert simulation.sent(task).count("move(r1, a1, a2)") == 1
    await simulation.master.cancel(task)


@pytest.mark.parametrize("goal", [BESIDE, ALONE], ids=["another call is under way", "nothing is under way"])
@simulated(faults=Faults((ALWAYS_ABORTED, NEVER_ENDS)), chosen=with_back_off(1000.0, 1000.0))
async def test_a_task_can_be_paused_and_cancelled_during_the_back_off(simulation: TaskSimulation, goal: str) -> None:
    task = simulation.want(goal)
    await simulation.sees(task, "failed", CALL, times=2)
    await asyncio.sleep(10.0)
    await simulation.master.pause(task, at_once=True)
    assert simulation.state(task) is TaskState.PAUSED
    await simulation.master.resume(task)
    await asyncio.sleep(10.0)
    assert len(times_sent(simulation, task)) == 2
    await simulation.master.cancel(task)
    assert simulation.endings[task].code is Code.CANCELLED


@pytest.mark.parametrize("on_change", OnChange)
def test_late_reports_are_waited_for_while_another_call_is_under_way(on_change: OnChange) -> None:
    problem = load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")
    faults = Faults((Fault("move(r1, store, hall)", FaultKind.ABORT, times=1), Fault("move(r2, hall, corridor)", FaultKind.SLOW)))

    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("(and (at r1 hall) (at r2 corridor))")
        await simulation.sees(task, "failed", "move(r1, store, hall)")
        failed = asyncio.get_running_loop().time()
        await simulation.sees(task, "sent", "move(r1, store, hall)", times=2)
        assert asyncio.get_running_loop().time() - failed < 3.0
        assert not simulation.seen(task, "ended", "move(r2"), "r2 is still on its way"
        await simulation.reaches(task)

    simulate_tasks(scenario, problem, faults=faults, chosen=replace(SERVED, on_change=on_change), make_backend=LateBackend)


@simulated(faults=Faults((ALWAYS_ABORTED, SLOW)), chosen=SERVED)
async def test_a_plan_that_is_sent_as_a_text_is_not_replanned_while_its_other_calls_are_under_way(simulation: TaskSimulation) -> None:
    task = simulation.want("(move r1 a1 a2)\n(move r0 a0 a1)\n(move r0 a1 a2)", is_plan=True)
    assert await simulation.ended_with(task) == [Code.ACTION_FAILED]
    assert sorted(simulation.sent(task)) == ["move(r0, a0, a1)", "move(r1, a1, a2)"]
    assert not simulation.seen(task, "replanned")


# --- a hand-written plan whose recovery ends with `replan`, among other tasks --------------------


def served(folder: Path, scene_of: object, text: str = PATROL) -> None:
    """Simulate tasks of a node that has loaded the plan."""
    file = folder / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    contents = read(file)
    assert contents.problem
    programs = {name: Program.of(plan) for name, plan in read_plans(file).items()}
    chosen = replace(SERVED, bindings=programs["patrol"].plan.bindings)
    simulate_tasks(scene_of, contents.problem, faults=BLOCKED, chosen=chosen, programs=programs)  # type: ignore[arg-type]


def test_a_loaded_plan_that_asks_for_it_is_replanned_among_other_tasks(tmp_path: Path) -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("patrol", is_plan=True)
        assert await simulation.ended_with(task) == [Code.GOAL_REACHED], simulation.endings[task].message
        assert simulation.sent(task) == ["move(r1, a, b)", "move(r1, a, c)", "move(r1, c, b)"]
        assert (simulation.endings[task].results, simulation.endings[task].cause) == ({"note": 7}, "")
        assert simulation.endings[task].replans == 1

    served(tmp_path, scenario)


def test_a_loaded_plan_that_is_replanned_can_be_paused_and_is_preempted(tmp_path: Path) -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("patrol", is_plan=True)
        await simulation.sees(task, "sent", "move(r1, a, c)")
        await simulation.master.pause(task, at_once=True)
        assert simulation.state(task) is TaskState.PAUSED
        await asyncio.sleep(100.0)
        await simulation.master.resume(task)
        await simulation.sees(task, "sent", "move(r1, a, c)", times=2)
        higher = simulation.want("(at r1 c)", priority=1)
        await simulation.sees(task, "state", "makes way for (at r1 c)")
        await simulation.reaches(higher, task)
        assert simulation.holds("(at r1 b)")

    served(tmp_path, scenario)


@pytest.mark.parametrize(
    ("old", "new", "code", "why"),
    [
        ("goal: (at r1 b)\n", "", Code.ACTION_FAILED, "no planner can be asked: the plan patrol has no goal"),
        (", (way c b)", "", Code.NO_PLAN, "no plan without move(r1, a, b), not to be tried again"),
        ("[replan]", "[fail]", Code.ACTION_FAILED, "move(r1, a, b)#0: aborted"),
    ],
)
def test_why_no_planner_finds_another_way_for_a_loaded_plan(tmp_path: Path, old: str, new: str, code: Code, why: str) -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("patrol", is_plan=True)
        assert await simulation.ended_with(task) == [code]
        assert why in simulation.endings[task].message
        assert simulation.endings[task].cause == "aborted"

    assert old in PATROL
    served(tmp_path, scenario, PATROL.replace(old, new))


# --- a search that begins while late reports are waited for: its answer is taken if they bring nothing new ---

LAZY = replace(SERVED, on_change=OnChange.LAZY, on_failure=Settings().on_failure)
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

    once = Faults((Fault(CALL, FaultKind.ABORT, times=1),))
    chosen = replace(LAZY, limits=Limits(forbid_after=forbid_after, replans=5, backoff=0.0))
    simulate_tasks(scenario, fleet(), faults=once, chosen=chosen, make_backend=LateBackend)
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
