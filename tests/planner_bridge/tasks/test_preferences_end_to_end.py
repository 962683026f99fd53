"""Preferences and networks of tasks from PDDL text to the goal, and what the command line prints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.tasks.replanning import PlanAgain, ResumePlan
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from tests.support.e2e.command_line import pnm, result as told
from tests.support.pddl.problems import ROOMS
from tests.support.tasks.replanning import pursued
from tests.support.tasks.rooms import ROUND, done, ring

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


# --- the command line ---


def test_the_command_line_tells_which_constraint_ended_the_run(tmp_path: Path) -> None:
    domain, wanted, faults = (tmp_path / name for name in ("domain.pddl", "problem.pddl", "faults.yaml"))
    domain.write_text(ROOMS.replace(":strips", ":adl :constraints :preferences :strips", 1))
    wanted.write_text(
        f"(define (problem p) (:domain rooms) (:objects r1 - robot a b c d - room) (:init (at r1 a) {ROUND})"
        " (:goal (and (at r1 c) (preference swept (clean c)))) (:constraints (always (not (clean a)))))"
    )
    faults.write_text('changes:\n  - at: 0.5\n    set: ["(clean a)"]\n')
    run = pnm("run", str(domain), str(wanted), "--faults", str(faults), "--json")
    assert run.returncode == 1
    found = told(run)
    assert found["constraints"] == [
        {
            "constraint": "(always (not (clean a)))",
            "status": "violated",
            "violations": [{"constraint": "(always (not (clean a)))", "time": 0.5, "observed": "(clean a) is true"}],
        }
    ]
    assert found["preferences"] == [{"name": "swept", "status": "violated", "violated": 1}]
    assert json.dumps(found["reason"]).startswith('"(always (not (clean a))) is violated after 0.50 s')
    spoken = pnm("run", str(domain), str(wanted), "--faults", str(faults))
    assert "broken (always (not (clean a))); observed (clean a) is true" in spoken.stdout
    assert "         preference swept is violated 1 time" in spoken.stdout


def test_a_metric_over_preferences_is_searched_on_for_a_better_plan() -> None:
    domain = parse_domain(ROOMS.replace(":strips", ":adl :preferences :strips", 1))
    ways = " ".join(f"(way {one} {other})" for one, other in ("ab", "bc"))
    things = "(:objects r1 - robot a b c - room)"
    goal = "(and (at r1 c) (preference swept (clean b)))"
    text = f"(define (problem p) (:domain rooms) {things} (:init (at r1 a) {ways} (= (total-cost) 0)) (:goal {goal})"
    problem = parse_problem(f"{text} (:metric minimize (+ (total-cost) (* 10 (is-violated swept)))))", domain)
    result = achieve(None, problem)
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
