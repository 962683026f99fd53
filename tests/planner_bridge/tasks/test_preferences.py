"""Preferences of tasks are counted and never enforced; what is left of both for a planner, how it is reported; networks of tasks."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.run_console import ConsoleObserver, print_result
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve, achieve_at
from planner_bridge.tasks.replanning import PlanAgain, ResumePlan
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.logic.conditions import Exists, Holds, Not
from pnm.core.logic.domain import ActionSchema, Preference
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint
from pnm.core.machine.bindings import Bindings
from tests.support.logic.trajectories import always, sometime
from tests.support.tasks.constraints import TO_C, changes, monitor, monitored, within
from tests.support.tasks.replanning import pursued
from tests.support.tasks.rooms import done, ring

A, B, C, D = (Holds(("clean", room)) for room in "abcd")
ROOM = Variable("?a", ("room",))


def wished(*preferences: Preference, problem: Problem = TO_C) -> Problem:
    return replace(problem, preferences=preferences)


# --- preferences ---


def test_preferences_are_counted_and_never_enforced() -> None:
    problem = wished(
        Preference("tidy", Holds(("clean", "?a")), (ROOM,)),
        Preference("there", Holds(("at", "r1", "c"))),
        Preference("quiet", (always(Not(Holds(("clean", "?a")))),), (ROOM,)),
        Preference("all-quiet", (always(Not(Holds(("clean", "?a"))), ROOM),)),
        Preference("soon", (within(0.5, C), within(0.7, C))),
        Preference("soon", (within(1.5, B),)),
        Preference("", (sometime(Holds(("at", "r1", "b"))),)),
        Preference("still", (Constraint("hold-during", (Not(D),), (0.5, 0.9)),)),
    )
    done = monitored(problem, changes((0.5, "a"), (1.0, "b"), (0.3, "d"), (0.95, "not d")))
    assert done.result.goal_reached
    assert done.result.constraints == ()
    assert [(one.name, one.status, one.violated) for one in done.result.preferences] == [
        ("tidy", "violated", 2),
        ("there", "fulfilled", 0),
        ("quiet", "violated", 3),
        ("all-quiet", "violated", 1),
        ("soon", "violated", 1),
        ("", "fulfilled", 0),
        ("still", "violated", 1),
    ]
    assert done.log.told == []


def test_preferences_of_actions_are_said_not_to_be_monitored() -> None:
    move: ActionSchema = replace(TO_C.domain.actions["move"], preferences=(Preference("lit", Exists((ROOM,), Holds(("clean", "?a")))),))
    problem = replace(TO_C, domain=replace(TO_C.domain, actions={**TO_C.domain.actions, "move": move}))
    assert [(one.name, one.status, one.violated) for one in monitored(problem).result.preferences] == [("lit", "not monitored", None)]


# --- what is left for a planner ---


def test_as_long_as_nothing_has_happened_everything_is_left_as_it_was_written() -> None:
    lifted = Constraint("at-most-once", (Holds(("clean", "?a")),), (), (ROOM,))
    problem = replace(wished(Preference("p", (sometime(A),), (ROOM,)), Preference("q", B)), constraints=(lifted, within(9.0, B)))
    _, left = monitor(problem, (0.0, {"d": True}))
    assert left.constraints == problem.constraints
    assert left.preferences == problem.preferences
    _, left = monitor(problem, (0.0, {"d": True}), (1.0, {"d": False}))
    assert [str(one) for one in left.constraints[2:]] == ["(at-most-once (clean c))", "(always (not (clean d)))", "(within 8 (clean b))"]


def test_what_is_left_is_handed_to_the_planner_with_times_from_now_on() -> None:
    domain = replace(TO_C.domain, constraints=(sometime(A), sometime(D)), preferences=(Preference("p", B),))
    problem = replace(
        TO_C, domain=domain, constraints=(within(9.0, C), Constraint("sometime-after", (A, D)), Constraint("at-most-once", (A,)))
    )
    _, left = monitor(problem, (0.0, {}), (3.0, {"a": True}), (4.0, {"a": False}))
    assert [str(one) for one in left.constraints] == [
        "(sometime (clean d))",
        "(within 5 (clean c))",
        "(sometime-after (clean a) (clean d))",
        "(sometime (clean d))",
        "(always (not (clean a)))",
    ]
    assert (left.domain.constraints, left.domain.preferences, left.preferences) == ((), (), (Preference("p", B),))


def test_of_preferences_every_instance_is_left_as_the_metric_names_them() -> None:
    problem = wished(
        Preference("p", (sometime(Holds(("clean", "?a"))),), (ROOM,)),
        Preference("q", (always(Not(A)), sometime(D))),
        Preference("r", (Constraint("sometime-after", (A, D)), within(9.0, B))),
        Preference("s", (sometime(B),)),
    )
    _, left = monitor(problem, (0.0, {}), (3.0, {"a": True}))
    assert left.preferences == (
        Preference("p", ()),
        *(Preference("p", (sometime(room),)) for room in (B, C, D)),
        Preference("q", (IMPOSSIBLE, sometime(D))),
        Preference("r", (Constraint("sometime-after", (A, D)), sometime(D), within(6.0, B))),
        Preference("s", (sometime(B),)),
    )


# --- told ---


def test_a_person_reads_what_is_violated_as_it_happens_and_at_the_end() -> None:
    problem = replace(wished(Preference("p", A), Preference("q", B)), constraints=(always(Not(Holds(("clean", "?a"))), ROOM),))
    text = io.StringIO()
    console = SafeConsole(file=text)
    backend = simulated_backend(problem, Bindings(), changes((0.3, "b"), (0.3, "c")))
    print_result(console, run_async(achieve_at(backend, problem, Settings(), ConsoleObserver(console, 30.0)), virtual=True))
    lines = text.getvalue().splitlines()
    assert "      0.31 s  broken (always (not (clean b))); observed (clean b) is true" in lines
    assert "goal     not reached: (always (not (clean b))) is violated after 0.30 s: (clean b) is true" in lines
    assert lines[-3:] == [
        "         constraint (always (not (clean b))) is violated after 0.30 s: (clean b) is true, and for 1 more choices of objects",
        "         preference p is violated 1 time",
        "         preference q is fulfilled",
    ]
    assert not any("constraint" in line or "preference" in line for line in result_lines(TO_C))


def result_lines(problem: Problem) -> list[str]:
    text = io.StringIO()
    print_result(SafeConsole(file=text), monitored(problem).result)
    return text.getvalue().splitlines()


# --- from PDDL text to the goal ---


# --- preferences ---


def test_preferences_are_planned_for_counted_and_not_enforced() -> None:
    wishes = "(and (forall (?a - room) (preference tidy (sometime (clean ?a)))) (preference past-d (sometime (at r1 d))))"
    goal = "(and (at r1 c) (preference swept (clean c)) (preference nowhere (not (at r1 c))))"
    wanted = ring(wishes, goal=goal, more="(:metric minimize (+ (* 5 (is-violated past-d)) (is-violated nowhere) (total-cost)))")
    blocked = HiddenChange({("at", "r1", "d"): False, ("at", "r1", "a"): True}, at=1.0)
    result, _ = pursued(wanted, Faults(changes=(blocked,)))
    assert result.goal_reached, result.reason
    found = {one.name: one for one in result.preferences}
    assert set(found) == {"tidy", "past-d", "swept", "nowhere"}
    assert (found["nowhere"].status, found["nowhere"].violated) == ("violated", 1)
    assert found["tidy"].violated == 4 - sum("sweep" in call for call in set(done(result)))
    assert result.constraints == ()


TIDYING = """
(define (domain tidying) (:requirements :typing :hierarchy :method-preconditions)
  (:types room)
  (:predicates (at ?a - room) (way ?a ?b - room) (clean ?a - room))
  (:task tidy :parameters (?a - room))
  (:method here :parameters (?a - room) :task (tidy ?a) :precondition (at ?a) :ordered-subtasks (and (sweep ?a)))
  (:method next :parameters (?b ?a - room) :task (tidy ?a) :precondition (and (at ?b) (way ?b ?a))
    :ordered-subtasks (and (move ?b ?a) (sweep ?a)))
  (:action move :parameters (?a ?b - room) :precondition (and (at ?a) (way ?a ?b)) :effect (and (not (at ?a)) (at ?b)))
  (:action sweep :parameters (?a - room) :precondition (at ?a) :effect (clean ?a)))
"""
TIDY = """
(define (problem p) (:domain tidying) (:objects a b c - room)
  (:htn :parameters () :ordered-subtasks (and (tidy b) (tidy c)))
  (:init (at a) (way a b) (way b a) (way b c)) (:goal (at c)))
"""
ARIES = Settings(planner="aries")


# --- networks of tasks ---


def test_a_network_is_not_done_when_its_goal_holds_but_when_its_tasks_are_done() -> None:
    result, truth = pursued(parse_problem(TIDY, parse_domain(TIDYING)), Faults((Fault("sweep(c)", FaultKind.ABORT, times=2),)), ARIES)
    assert result.goal_reached, result.reason
    assert [type(episode.decision) for episode in result.episodes] == [ResumePlan, type(None)]
    assert truth.value(("clean", "c")) is True


def test_a_network_whose_rest_does_not_work_any_more_is_planned_for_as_a_whole() -> None:
    back = HiddenChange({("at", "c"): False, ("at", "a"): True}, at=3.9)
    faults = Faults((Fault("sweep(c)", FaultKind.ABORT, times=2),), (back,))
    result, _ = pursued(parse_problem(TIDY, parse_domain(TIDYING)), faults, ARIES)
    assert result.goal_reached, result.reason
    decision = result.episodes[0].decision
    assert isinstance(decision, PlanAgain)
    assert decision.why.endswith("; the whole network of tasks is planned for once more")
    assert result.plans == 2


# --- the result ---


def test_the_result_tells_as_json_which_constraint_ended_the_run() -> None:
    wanted = ring("(always (not (clean a)))", goal="(and (at r1 c) (preference swept (clean c)))")
    result, _ = pursued(wanted, changes((0.5, "a")))
    found = result.as_json()
    violation = {"constraint": "(always (not (clean a)))", "time": 0.5, "observed": "(clean a) is true"}
    assert found["constraints"] == [{"constraint": "(always (not (clean a)))", "status": "violated", "violations": [violation]}]
    assert found["preferences"] == [{"name": "swept", "status": "violated", "violated": 1}]
    assert str(found["reason"]).startswith("(always (not (clean a))) is violated after 0.50 s")


def test_a_metric_over_preferences_is_searched_on_for_a_better_plan() -> None:
    metric = "(:metric minimize (+ (total-cost) (* 10 (is-violated swept))))"
    result = achieve(None, ring(goal="(and (at r1 c) (preference swept (clean b)))", ways="(way a b) (way b c)", more=metric))
    assert [one.status for one in result.preferences] == ["fulfilled"]
    assert "sweep(r1, b)" in [str(call.call.action) for call in result.calls]


RAIN = """(define (domain d) (:requirements :durative-actions :constraints :timed-initial-literals) (:predicates (p) (q) (rain))
  (:durative-action a :parameters () :duration (= ?duration 2) :condition () :effect (at end (p)))
  (:durative-action b :parameters () :duration (= ?duration 2) :condition () :effect (at end (q))))"""


def raining(rest: str) -> Problem:
    return parse_problem(f"(define (problem p) (:domain d) (:init (at 6 (rain))) {rest})", parse_domain(RAIN))


def test_a_constraint_that_needs_a_timed_fact_is_waited_for() -> None:
    result = achieve(None, raining("(:goal (p)) (:constraints (sometime-before (p) (rain)))"))
    assert result.goal_reached, result.reason
    assert result.calls[0].ended is not None
    assert result.calls[0].ended - result.began >= 6.0


@pytest.mark.parametrize("goal", ["(rain)", "(and (p) (rain))"])
def test_a_goal_that_needs_a_timed_fact_is_waited_for(goal: str) -> None:
    result = achieve(None, raining(f"(:goal {goal})"))
    assert result.goal_reached, result.reason
    assert result.replans == 0


def test_where_the_validators_disagree_nothing_moves_and_both_are_told() -> None:
    result = achieve(None, raining("(:goal (p)) (:constraints (hold-during 1 2 (q)))"))  # Kairos looks at states that begin then
    assert not result.goal_reached
    assert result.calls == ()
    assert "validators disagree: Kairos' validator says: valid; our own says: (hold-during 1 2 (q)) is violated at 1 s" in result.reason


def test_the_value_of_a_function_may_be_taken_away() -> None:
    domain = parse_domain("""(define (domain d) (:requirements :typing :object-fluents :adl) (:types place crate) (:predicates (done))
      (:functions (where ?c - crate) - place)
      (:action load :parameters (?c - crate) :precondition (not (done)) :effect (and (assign (where ?c) undefined) (done))))""")
    text = "(define (problem p) (:domain d) (:objects a - place k - crate) (:init (= (where k) a)) (:goal (done)))"
    assert achieve(None, parse_problem(text, domain)).goal_reached
