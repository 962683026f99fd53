"""Tasks: after a failure the rest of the plan, another plan, or an end with a reason."""

from __future__ import annotations

import pytest

from planner_bridge.model.guards import ForbiddenCall, forbid
from planner_bridge.model.world import simulated_backend
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import GiveUp, History, Limits, PlanAgain, ResumePlan
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import CallOutcome
from pnm.tasks import TaskState
from tests.support.e2e.hosts.survey import DOMAIN as SURVEY
from tests.support.pddl.problems import ROOMS, matches, rooms
from tests.support.tasks.replanning import aborts, decisions, pursued


def test_a_ground_action_that_failed_twice_is_planned_around() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), aborts("move(r1, b, c)"))
    assert result.goal_reached
    assert decisions(result) == [ResumePlan, PlanAgain]
    decision = result.episodes[1].decision
    assert isinstance(decision, PlanAgain)
    assert [str(call) for call in decision.forbidden] == ["move(r1, b, c)"]
    assert decision.why == "move(r1, b, c) has failed 2 times"
    assert ("move(r1, d, c)", "succeeded") in [(str(call.call.action), call.outcome) for call in result.calls]


def test_without_another_way_the_reason_names_what_failed() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move(r1, b, c)"))
    assert not result.goal_reached
    failure = "last failure: move(r1, b, c)#0: aborted: the action failed"
    assert result.reason.startswith(f"{failure}; no plan without move(r1, b, c), not to be tried again: proved unsolvable")


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
    assert result.reason == "the limit of 2 replans is reached; last failure: move(r1, a, b)#0: aborted: the action failed"
    assert decisions(result) == [ResumePlan, ResumePlan, GiveUp]


def test_a_pause_before_another_try_is_told_with_its_reason() -> None:
    told: list[tuple[TaskState, str]] = []
    observer = TaskObserver()
    observer.entered = lambda state, why: told.append((state, why))  # type: ignore[method-assign]
    problem, limits = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), Limits(replans=2, forbid_after=100)
    run_async(achieve_at(simulated_backend(problem, Bindings(), aborts("move")), problem, Settings(limits=limits), observer), virtual=True)
    assert (TaskState.REPLANNING, "tries again in 0.5 s after move(r1, a, b) was aborted") in told
    assert [state.name for state, _ in told] == ["PLANNING", "RUNNING", "REPLANNING", "RUNNING", "OVER"]


def test_a_match_that_goes_out_is_noticed() -> None:
    out = HiddenChange({("light", "m0"): False}, moment="start", what="mend")
    result, _ = pursued(matches(1), Faults(changes=(out,)))
    assert not result.goal_reached
    assert "invariant_false" in [failure.cause for failure in result.failures]


ENVELOPE = """(define (domain envelope) (:requirements :strips :durative-actions)
 (:predicates (on) (done) (off) (ended))
 (:durative-action wrap :parameters () :duration (= ?duration 5)
  :condition (at start (off)) :effect (and (at start (not (off))) (at start (on)) (at end (not (on)))))
 (:durative-action inner :parameters () :duration (= ?duration 5) :condition (over all (on)) :effect (at end (done)))
 (:durative-action after :parameters () :duration (= ?duration 2) :condition (at start (done)) :effect (at end (ended))))"""


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"on"})], ids=["sensed", "assumed"])
def test_a_call_may_end_at_the_moment_at_which_another_ends_what_it_relies_on(assumed: frozenset[str]) -> None:
    problem = parse_problem("(define (problem e) (:domain envelope) (:init (off)) (:goal (ended)))", parse_domain(ENVELOPE))
    result, _ = pursued(problem, bindings=Bindings(assumed=assumed))
    assert result.goal_reached
    assert (result.replans, result.failures) == (0, ())
    assert {call.call.action.name: call.ended for call in result.calls} == {"wrap": 5.0, "inner": 5.0, "after": 7.0}


def test_a_task_is_stopped_when_its_time_is_up() -> None:
    slow = Faults((Fault("move", FaultKind.SLOW),))
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)"), slow, limits=Limits(seconds=5.0))
    assert result.reason == "the limit of 5 s is reached"
    assert [call.outcome for call in result.calls] == ["canceled", "skipped"]


def test_an_action_that_may_still_be_going_on_is_not_planned_with() -> None:
    stuck = Faults((Fault("move(r1, a, b)", FaultKind.SLOW, ignores_cancel=True),))
    bindings = Bindings({"move": Binding(timeout=3.0, cancel=1.0)}, assumed=frozenset({"at"}))
    backend = simulated_backend(rooms(init="(at r1 a)", goal="(at r1 b)"), bindings, stuck)
    task = achieve_at(backend, rooms(init="(at r1 a)", goal="(at r1 b)"), Settings(bindings=bindings), TaskObserver())
    result = run_async(task, virtual=True)
    assert result.failures[0].unconfirmed
    assert result.episodes[0].decision.why == (  # type: ignore[union-attr]
        "move(r1, a, b) may still be under way: its server has not confirmed that it is over"
    )
    assert sum(call.attempts for call in result.calls) == 1
    assert "; no plan without move(r1, a, b)" in result.reason


def test_a_server_that_is_not_there_is_planned_around_whatever_it_is_called_for() -> None:
    problem = rooms(init="(at r1 h) (at r2 a)", goal="(clean t)", ways="hs st hu ut hv vt hw wt ab bc cd dt")
    lost = Faults(tuple(Fault(f"move(r1, h, {place})", FaultKind.LOSE_SERVER) for place in "suvw"))
    result, _ = pursued(problem, lost, bindings=Bindings({"move": Binding(server="/{r}/move")}))
    assert result.goal_reached
    assert result.replans == 1
    assert {call.call.action.arguments[0] for call in result.calls if call.outcome == "succeeded"} == {"r2"}
    assert decisions(result) == [PlanAgain]


def test_a_server_whose_pattern_other_kinds_of_robots_share_is_planned_around() -> None:
    robots, roads = "r1 - rover d1 - drone", "(road base south) (road south north)"
    world = f"(:objects {robots} base south north - place) (:init (standing r1 base) (above d1 base) {roads})"
    problem = parse_problem(f"(define (problem p) (:domain survey) {world} (:goal (surveyed north)))", parse_domain(SURVEY))
    bindings = Bindings({name: Binding(server="/{robot}/navigate") for name in ("drive", "fly")})
    lost = Faults((Fault("fly", FaultKind.LOSE_SERVER),))
    result, _ = pursued(problem, lost, bindings=bindings)
    assert result.goal_reached, result.reason
    assert {call.call.action.name for call in result.calls if call.outcome == "succeeded"} == {"drive", "look_around"}


def test_a_server_that_carried_something_out_since_is_there() -> None:
    bindings = Bindings({"move": Binding(server="/{r}/move")})
    failed, other = (ActionCall(0, GroundAction("move", ("r1", "a", place), ("r", "from", "to"))) for place in "bc")
    gone, success = Failure(failed, Cause.LOST), CallResult(other, CallOutcome.SUCCEEDED)
    history = History().after((), (gone,), bindings)
    assert history.after((), (gone,), bindings).absent_servers(Limits()) == {"/r1/move"}
    assert history.after((success,), (), bindings).after((), (gone,), bindings).absent_servers(Limits()) == frozenset()


def test_a_call_that_lacks_a_value_is_not_tried_again_while_nothing_new_is_known() -> None:
    bindings = Bindings({"move": Binding(goal={"speed": "$speed"})})
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 b)"), bindings=bindings)
    assert result.replans == 0
    assert [failure.cause for failure in result.failures] == ["data_missing"]
    assert "move(r1, a, b)#0: data_missing: expected values for speed" in result.reason


def test_a_call_that_lacked_a_value_is_used_once_there_is_one() -> None:
    domain = parse_domain("""(define (domain d) (:requirements :durative-actions :numeric-fluents)
      (:predicates (walked) (measured)) (:functions (level))
      (:durative-action walk :parameters () :duration (= ?duration 5) :condition () :effect (at end (walked)))
      (:durative-action measure :parameters () :duration (= ?duration 1) :condition () :effect (at end (measured))))""")
    problem = parse_problem("(define (problem p) (:domain d) (:init) (:goal (and (walked) (measured))))", domain)
    known = Faults(changes=(HiddenChange({("level",): 3.0}, at=2.0),))
    result, _ = pursued(problem, known, bindings=Bindings({"measure": Binding(goal={"level": "(level)"}, retries=0)}))
    assert [failure.cause for failure in result.failures] == ["data_missing"]
    assert result.goal_reached
    alone = parse_problem("(define (problem p) (:domain d) (:init) (:goal (measured)))", domain)
    bindings = Bindings({"measure": Binding(goal={"level": "(level)"}, retries=0)})
    result, _ = pursued(alone, known, limits=Limits(patience=10.0), bindings=bindings)
    assert [failure.cause for failure in result.failures] == ["data_missing"]
    assert result.goal_reached


def test_what_is_reported_only_when_it_is_asked_for_is_asked_for_before_every_plan() -> None:
    problem = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ad dc")
    backend = simulated_backend(problem, Bindings(), aborts("move(r1, a, d)", times=1))
    closed, asked = [("way", "a", "b")], []

    async def refresh() -> None:
        asked.append(backend.robots.world.truth.value(("at", "r1", "a")))
        backend.knowledge.update(dict.fromkeys(closed, False))

    backend.refresh = refresh
    opened = backend.open

    async def note(knowledge) -> None:
        backend.knowledge = knowledge
        await opened(knowledge)

    backend.open = note
    result = run_async(
        achieve_at(backend, problem, Settings(bindings=Bindings({"move": Binding(retries=0)})), TaskObserver()), virtual=True
    )
    assert result.goal_reached
    assert {call.call.action.arguments[1:] for call in result.calls if call.outcome == "succeeded"} == {("a", "d"), ("d", "c")}
    assert asked[:2] == [True, True], "at the start, and after the failure"


def test_a_goal_that_comes_true_in_another_way_is_reached() -> None:
    helped = HiddenChange({("at", "r1", "b"): False, ("at", "r1", "c"): True}, at=1.6)
    faults = Faults(aborts("move(r1, b, c)").faults, (helped,))
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), faults)
    assert result.goal_reached


def test_an_action_that_has_succeeded_since_is_not_forbidden() -> None:
    call = ForbiddenCall("move", ("r1", "a", "b"))
    action = GroundAction("move", ("r1", "a", "b"), ("r", "from", "to"))
    failure, success = Failure(ActionCall(0, action), Cause.ABORTED), CallResult(ActionCall(0, action), CallOutcome.SUCCEEDED)
    history = History().after((), (failure,))
    assert history.after((), (failure,)).forbidden(Limits()) == {call}
    assert history.after((success,), ()).after((), (failure,)).forbidden(Limits()) == frozenset()


def test_forbidding_does_not_touch_a_predicate_of_the_domain() -> None:
    text = ROOMS.replace("(clean ?a - room))", "(clean ?a - room) (forbidden-move))", 1)
    domain = parse_domain(text)
    problem = parse_problem("(define (problem p) (:domain rooms) (:objects r1 - robot a - room) (:goal (forbidden-move)))", domain)
    assert set(forbid(problem, frozenset({ForbiddenCall("move", ("r1", "a", "a"))})).domain.predicates) >= {
        "forbidden-move",
        "forbidden-move-",
    }
