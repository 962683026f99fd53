"""Tasks: after a failure the rest of the plan, another plan, or an end with a reason."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.model.forbidden_actions import ForbiddenCall, forbid
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline import achieve, achieve_at
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.replanning import Decision, GiveUp, History, Limits, PlanAgain, Progress, ResumePlan, decide
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds, Not
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import CallOutcome
from pnm.core.machine.plan_graph import ActionCall, Cause, GroundAction
from pnm.tasks import TaskState
from tests.support.problems import ROOMS, matches, rooms
from tests.support.runs.simulated import LateBackend


def pursued(
    problem: Problem, faults: Faults = NO_FAULTS, *, limits: Limits = Limits(), bindings: Bindings = Bindings()
) -> tuple[TaskResult, KnowledgeBase]:
    """Pursue the goal of the problem and return the result with the truth; the verdict must be true to the world."""
    backend = simulated_backend(problem, bindings, faults)
    result = run_async(achieve_at(backend, problem, Settings(limits=limits, bindings=bindings), TaskObserver()), virtual=True)
    truth = backend.robots.world.truth
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
    assert decisions(result) == [ResumePlan]


def test_a_ground_action_that_failed_twice_is_planned_around() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), aborts("move(r1, b, c)"))
    assert result.goal_reached
    assert decisions(result) == [ResumePlan, PlanAgain]
    assert [str(call) for call in result.episodes[1].decision.forbidden] == ["move(r1, b, c)"]  # type: ignore[union-attr]
    assert ("move(r1, d, c)", "succeeded") in [(str(call.call.action), call.outcome) for call in result.calls]


def test_without_another_way_the_reason_names_what_failed() -> None:
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), aborts("move(r1, b, c)"))
    assert not result.goal_reached
    failure = "last failure: move(r1, b, c)#0: aborted: expected success; observed the action failed"
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
    assert (
        result.reason
        == "the limit of 2 replans is reached; last failure: move(r1, a, b)#0: aborted: expected success; observed the action failed"
    )
    assert decisions(result) == [ResumePlan, ResumePlan, GiveUp]


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
        pauses.append(history.backoff(limits))
    assert pauses == [0.0, 0.5, 1.0, 2.0, 3.0, 3.0]


def test_a_pause_before_another_try_is_told_with_its_reason() -> None:
    told: list[tuple[TaskState, str]] = []
    observer = TaskObserver()
    observer.entered = lambda state, why: told.append((state, why))  # type: ignore[method-assign]
    problem, limits = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), Limits(replans=2, forbid_after=100)
    run_async(
        achieve_at(simulated_backend(problem, Bindings(), aborts("move")), problem, Settings(limits=limits), observer),
        virtual=True,
    )
    assert (TaskState.REPLANNING, "tries again in 0.5 s after move(r1, a, b) was aborted") in told
    assert [state.name for state, _ in told] == ["PLANNING", "RUNNING", "REPLANNING", "RUNNING", "OVER"]


def test_a_match_burns_until_the_fuse_is_mended() -> None:
    result, _ = pursued(matches(3))
    assert result.goal_reached
    assert result.replans == 0


def test_a_match_that_goes_out_is_noticed() -> None:
    out = HiddenChange({("light", "m0"): False}, moment="start", what="mend")
    result, _ = pursued(matches(1), Faults(changes=(out,)))
    assert not result.goal_reached
    assert "invariant_false" in [failure.cause for failure in result.failures]


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
    assert sum(call.attempts for call in result.calls) == 1
    assert "; no plan without move(r1, a, b)" in result.reason


def test_a_fact_that_no_action_changes_may_change_all_the_same() -> None:
    gone = HiddenChange({("way", "b", "c"): False}, at=0.3)
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), Faults(changes=(gone,)))
    assert result.goal_reached
    assert [failure.cause for failure in result.failures] == ["precondition_false"]


def test_a_goal_that_comes_true_in_another_way_is_reached() -> None:
    helped = HiddenChange({("at", "r1", "b"): False, ("at", "r1", "c"): True}, at=1.6)
    faults = Faults(aborts("move(r1, b, c)").faults, (helped,))
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), faults)
    assert result.goal_reached


def test_an_action_that_has_succeeded_since_is_not_forbidden() -> None:
    call = ForbiddenCall("move", ("r1", "a", "b"))
    action = GroundAction("move", ("r1", "a", "b"))
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


OVER_B = [("move", "r1", "a", "b"), ("move", "r1", "b", "c")]


def decided(problem: Problem, steps: list[tuple[str, ...]], done: int = 0) -> Decision:
    """What follows a run of these steps, the first of which are done, if the world now is as the problem says."""
    graph = plan_graph(problem, Plan(tuple(PlanStep(step[0], step[1:], float(number)) for number, step in enumerate(steps))))
    calls = tuple(CallResult(call, CallOutcome.SUCCEEDED if call.index < done else CallOutcome.WAITING) for call in graph.calls)
    return decide(problem, Progress(graph, calls), KnowledgeBase(problem.init, objects=problem.objects_by_type), History(), Limits())


def clean(room: str) -> Holds:
    return Holds(("clean", room))


IN_B = Holds(("at", "r1", "b"))
KEPT = [
    Constraint("always", (Not(clean("?x")),), (), (Variable("?x", ("room",)),)),
    Constraint("sometime", (IN_B,)),
    Constraint("sometime-after", (IN_B, Holds(("at", "r1", "c")))),
    Constraint("sometime-before", (Holds(("at", "r1", "c")), IN_B)),
    Constraint("at-most-once", (Holds(("at", "r1", "a")),)),
    Constraint("at end", (Not(IN_B),)),
]
BROKEN = [
    (Constraint("always", (Not(IN_B),)), "the end of move(r1, a, b) would violate (always (not (at r1 b)))"),
    (Constraint("sometime-before", (IN_B, clean("a"))), "the end of move(r1, a, b) would violate (sometime-before (at r1 b) (clean a))"),
    (Constraint("sometime", (clean("d"),)), "the rest of the plan would leave (sometime (clean d)) unfulfilled"),
    (Constraint("sometime-after", (IN_B, clean("d"))), "the rest of the plan would leave (sometime-after (at r1 b) (clean d)) unfulfilled"),
    (Constraint("at end", (IN_B,)), "the rest of the plan would leave (at end (at r1 b)) unfulfilled"),
    (Constraint("within", (IN_B,), (90.0,)), "the times of the plan matter to (within 90 (at r1 b))"),
]


@pytest.mark.parametrize("constraint", KEPT, ids=str)
def test_the_rest_of_a_plan_that_keeps_the_constraints_is_used(constraint: Constraint) -> None:
    problem = replace(rooms(init="(at r1 a)", goal="(at r1 c)"), constraints=(constraint,))
    assert isinstance(decided(problem, OVER_B), ResumePlan)


@pytest.mark.parametrize(("constraint", "why"), BROKEN, ids=lambda value: str(value) if isinstance(value, Constraint) else "")
def test_the_rest_of_a_plan_that_breaks_a_constraint_is_not_used(constraint: Constraint, why: str) -> None:
    problem = rooms(init="(at r1 a)", goal="(at r1 c)")
    assert decided(replace(problem, constraints=(constraint,)), OVER_B) == PlanAgain(frozenset(), why)
    problem = replace(problem, domain=replace(problem.domain, constraints=(constraint,)))
    assert decided(problem, OVER_B) == PlanAgain(frozenset(), why)


def test_a_goal_that_holds_is_planned_for_again_as_long_as_something_is_missing() -> None:
    problem = replace(rooms(init="(at r1 c)", goal="(at r1 c)"), constraints=(Constraint("sometime", (clean("d"),)),))
    assert decided(problem, OVER_B, done=2) == PlanAgain(frozenset(), "the rest of the plan would leave (sometime (clean d)) unfulfilled")


def test_the_rest_of_a_network_of_tasks_is_used_and_otherwise_the_whole_network_is_planned_for() -> None:
    network = replace(rooms(init="(at r1 b)", goal="(at r1 c)"), network="(:htn)")
    rest = decided(network, OVER_B, done=1)
    assert isinstance(rest, ResumePlan)
    assert [str(call) for call in rest.rest.calls] == ["move(r1, b, c)#0"]
    elsewhere = replace(rooms(init="(at r1 d)", goal="(at r1 c)"), network="(:htn)")
    assert decided(elsewhere, OVER_B, done=1) == PlanAgain(
        frozenset(), "move(r1, b, c) would start although (at r1 b) is false; the whole network of tasks is planned for once more"
    )


@pytest.mark.parametrize("what", ["strike(m0)", "mend(f0, m0)"])
def test_late_reports_are_waited_for_before_anything_is_decided(what: str) -> None:
    problem = matches(1)
    faults = Faults((Fault(what, FaultKind.ABORT, times=1),))
    backend = LateBackend(problem, faults, delay=0.3, lag=1.0)
    settings = Settings(bindings=Bindings({"strike": Binding(retries=0), "mend": Binding(retries=0)}))
    result = run_async(achieve_at(backend, problem, settings, TaskObserver()), virtual=True)
    truth = evaluate(problem.goal, backend.robots.world.truth)
    assert result.goal_reached is truth
    assert what != "strike(m0)" or result.goal_reached


def test_a_report_about_things_unheard_of_does_not_disturb_planning() -> None:
    strange = HiddenChange({("at", "zz", "b"): True, ("flies", "r1"): True}, at=0.5)
    faults = Faults(aborts("move(r1, b, c)").faults, (strange,))
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), faults)
    assert result.goal_reached


def timed_rooms(time: float) -> Problem:
    """Room b opens at a time."""
    text = ROOMS.replace("(clean ?a - room))", "(clean ?a - room) (open ?a - room))", 1)
    domain = parse_domain(text.replace("(way ?a ?b))\n    :effect", "(way ?a ?b) (open ?b))\n    :effect"))
    things = f"(:objects r1 - robot a b - room) (:init (at r1 a) (way a b) (at {time} (open b)))"
    return parse_problem(f"(define (problem p) (:domain rooms) {things} (:goal (at r1 b)))", domain)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"open"})])
def test_a_fact_that_comes_true_by_itself_is_waited_for_whether_or_not_it_is_sensed(assumed: frozenset[str]) -> None:
    result, _ = pursued(timed_rooms(4.0), bindings=Bindings(assumed=assumed))
    assert result.goal_reached, result.reason
    assert result.calls[0].started is not None
    assert result.calls[0].started >= 4.0


def test_nothing_happens_in_a_world_after_its_task() -> None:
    for _ in range(5):
        _, truth = pursued(
            rooms(init="(at r1 a)", goal="(at r1 b)"), Faults(changes=(HiddenChange({("at", "r1", "b"): False}, at=100_000.0),))
        )
        assert truth.value(("at", "r1", "b")) is True


@pytest.mark.parametrize("kind", FaultKind)
@pytest.mark.parametrize("times", [1, 2, 3, None])
@pytest.mark.parametrize("what", ["move(r1, a, b)", "move(r2, a, d)", "move", "sweep(r1, c)"])
def test_any_fault_ends_in_the_goal_or_in_a_named_failure(kind: FaultKind, times: int | None, what: str) -> None:
    problem = rooms(goal="(and (at r1 c) (at r2 c) (clean c))")
    bindings = Bindings({"move": Binding(timeout=3.0), "sweep": Binding(timeout=3.0)})
    result, _ = pursued(problem, Faults((Fault(what, kind, times=times),)), bindings=bindings)
    assert result.goal_reached or "; no plan without " in result.reason or result.reason.startswith("the limit")
    assert result.goal_reached or result.failures


def test_a_task_may_take_as_long_as_its_plan() -> None:
    domain = parse_domain("""(define (domain d) (:requirements :durative-actions) (:predicates (done))
      (:durative-action grow :parameters () :duration (= ?duration 5000) :condition () :effect (at end (done))))""")
    problem = parse_problem("(define (problem p) (:domain d) (:init) (:goal (done)))", domain)
    assert achieve(None, problem).goal_reached
    assert not achieve(None, problem, settings=Settings(limits=Limits(seconds=3600.0))).goal_reached
