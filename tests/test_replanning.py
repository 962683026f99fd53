"""Tasks: after a failure the rest of the plan, another plan, or an end with a reason."""

from __future__ import annotations

import pytest

from planner_bridge.model import Problem
from planner_bridge.pipeline import Stopwatch, pursue
from planner_bridge.replanning import GiveUp, History, Limits, PlanAgain, Resume
from planner_bridge.sites import SimulatedSite
from planner_bridge.tasks import Settings, TaskObserver, TaskResult
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.bindings import Binding, Bindings
from pnm.clock import run_async
from pnm.conditions import evaluate
from pnm.knowledge import KnowledgeBase
from tests.domains import matches, rooms


def pursued(
    problem: Problem, faults: Faults = NO_FAULTS, *, limits: Limits = Limits(), bindings: Bindings = Bindings()
) -> tuple[TaskResult, KnowledgeBase]:
    """Pursue the goal of the problem and return the result with the truth; the verdict must be true to the world."""
    site = SimulatedSite(problem, bindings, faults)
    result = run_async(pursue(problem, site, Settings(limits=limits, bindings=bindings), TaskObserver(), Stopwatch()), virtual=True)
    truth = site.robots.world.truth
    assert result.goal_reached == (evaluate(problem.goal, truth) is True)
    return result, truth


def decisions(result: TaskResult) -> list[type]:
    return [type(episode.decision) for episode in result.episodes if episode.decision]


def aborts(what: str, times: int | None = None) -> Faults:
    return Faults((Fault(what, FaultKind.ABORT, times=times),))


def test_nothing_goes_wrong() -> None:
    result, _ = pursued(rooms())
    assert result.goal_reached
    assert (result.plans, result.replans, result.failures) == (1, 0, ())


def test_a_goal_that_holds_needs_no_call() -> None:
    result, _ = pursued(rooms(goal="(at r1 a)"))
    assert result.goal_reached
    assert result.calls == ()


def test_the_rest_of_the_plan_is_used_before_a_planner_is_asked() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move(r1, b, c)", times=2))
    assert result.goal_reached
    assert result.plans == 1
    assert decisions(result) == [Resume]


def test_a_ground_action_that_failed_twice_is_planned_around() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), aborts("move(r1, b, c)"))
    assert result.goal_reached
    assert decisions(result) == [Resume, PlanAgain]
    assert [str(call) for call in result.episodes[1].decision.forbidden] == ["move(r1, b, c)"]  # type: ignore[union-attr]
    assert ("move(r1, d, c)", "succeeded") in [(str(call.call.action), call.outcome) for call in result.calls]


def test_without_another_way_the_reason_names_what_failed() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move(r1, b, c)"))
    assert not result.goal_reached
    assert result.reason.startswith("no plan without move(r1, b, c), which failed too often: proved unsolvable")


def test_a_fact_changed_behind_the_robots_back_leads_to_a_new_plan() -> None:
    changed = HiddenChange({("at", "r1", "b"): False, ("at", "r1", "d"): True}, moment="end", what="move(r1, a, b)")
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)"), Faults(changes=(changed,)))
    assert result.goal_reached
    assert decisions(result) == [PlanAgain]
    assert [failure.cause for failure in result.failures] == ["precondition_false"]


def test_a_goal_undone_at_the_end_is_pursued_again() -> None:
    undone = HiddenChange({("clean", "a"): False}, at=1.5)
    result, _ = pursued(rooms(init="(at r1 a) (at r2 a)", goal="(and (clean a) (at r2 c))"), Faults(changes=(undone,)))
    assert result.goal_reached
    assert result.failures == ()
    assert decisions(result) == [PlanAgain]


def test_the_limit_of_replans_ends_a_task_by_name() -> None:
    limits = Limits(replans=2, forbid_after=100)
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move"), limits=limits)
    assert not result.goal_reached
    assert result.replans == 2
    assert (
        result.reason
        == "the limit of 2 replans is reached; last failure: move(r1, a, b)#0: aborted: expected success; observed the action failed"
    )
    assert decisions(result) == [Resume, Resume, GiveUp]


def test_the_limit_in_seconds_ends_a_task_by_name() -> None:
    result, _ = pursued(
        rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move"), limits=Limits(seconds=0.5, forbid_after=100)
    )
    assert result.reason.startswith("the limit of 0.5 s is reached")


def test_trying_without_progress_takes_longer_and_longer() -> None:
    history, limits = History(), Limits(backoff=0.5, longest_backoff=3.0)
    pauses = []
    for _ in range(6):
        history = history.after((), ())
        pauses.append(history.pause(limits))
    assert pauses == [0.0, 0.5, 1.0, 2.0, 3.0, 3.0]


def test_a_match_burns_until_the_fuse_is_mended() -> None:
    result, _ = pursued(matches(3))
    assert result.goal_reached
    assert result.replans == 0


def test_a_match_that_goes_out_is_noticed() -> None:
    out = HiddenChange({("light", "m0"): False}, moment="start", what="mend")
    result, _ = pursued(matches(1), Faults(changes=(out,)))
    assert not result.goal_reached
    assert "invariant_false" in [failure.cause for failure in result.failures]


@pytest.mark.parametrize("kind", FaultKind)
@pytest.mark.parametrize("times", [1, 2, 3, None])
@pytest.mark.parametrize("what", ["move(r1, a, b)", "move(r2, a, d)", "move", "sweep(r1, c)"])
def test_any_fault_ends_in_the_goal_or_in_a_named_failure(kind: FaultKind, times: int | None, what: str) -> None:
    problem = rooms(goal="(and (at r1 c) (at r2 c) (clean c))")
    bindings = Bindings({"move": Binding(timeout=3.0), "sweep": Binding(timeout=3.0)})
    result, _ = pursued(problem, Faults((Fault(what, kind, times=times),)), bindings=bindings)
    assert result.goal_reached or result.reason.startswith(("no plan", "the limit"))
    assert result.goal_reached or result.failures
