"""What would make a goal possible: the fewest facts, proved by plans, and a proof that fewer are not enough."""

from __future__ import annotations

from dataclasses import replace

from planner_bridge.explanations.answer import Answer, Known, NoSmallerChange
from planner_bridge.explanations.goal_now import what_would_help
from planner_bridge.explanations.no_plan import AnswerLimit, why_no_plan
from planner_bridge.model.forbidden_actions import ForbiddenCall, forbid
from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.reachability import MOST_ACTIONS
from tests.support.pddl.explanations.checked_claims import Checked
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.problems import rooms, tanks


def help_for(problem: Problem) -> Answer:
    """What would help, every claim of which is right."""
    limit, checked = AnswerLimit.of(30), Checked()
    answer = what_would_help(problem, limit, why_no_plan(problem, limit.first_plan(problem), limit))
    checked.look(answer)
    assert checked.false == []
    return answer


def test_two_facts_are_changed_only_if_it_is_proved_that_one_is_not_enough() -> None:
    for one in (rooms(init="", ways="ab", goal="(clean c)"), house(cups=""), house("(open door)", "(and (at r1 yard) (at r1 hall))")):
        help_for(one)
    answer = help_for(house("(locked door) (broken r1)", "(and (has r1 cup) (at r1 yard))"))
    assert answer.statement == "there would be a plan with two facts changed"
    assert "if (broken r1) were false and (key r1 door) were true: a plan with 5 calls" in [part.statement for part in answer.reasons]
    assert answer.reasons[-1].statement == "no change of one fact is enough"
    assert answer.reasons[-1].known is Known.RELAXATION


def test_a_change_far_from_the_goal_is_found_where_only_facts_in_a_circle_would_help() -> None:
    problem = house("(open door)")
    nowhere = replace(problem, init={fluent: value for fluent, value in problem.init.items() if fluent != ("at", "r1", "hall")})
    assert "if (at r1 yard) were true: a plan with 4 calls" in [part.statement for part in help_for(nowhere).reasons]


def test_numbers_are_not_changed_and_that_is_said() -> None:
    answer = help_for(replace(tanks("1")))
    assert not any("if " in part.statement for part in answer.reasons)
    assert any("numbers were not changed" in part.statement for part in answer.every())


def test_without_a_proof_that_there_is_no_plan_no_change_is_called_smallest() -> None:
    unsure = Answer("no plan was found", Known.NOT_PROVED)
    answer = what_would_help(house(), AnswerLimit.of(30), unsure)
    assert not any(isinstance(claim, NoSmallerChange) for part in answer.every() for claim in part.claims)
    assert answer.reasons[-1].known is Known.NOT_PROVED


def test_what_has_too_many_facts_is_not_looked_through() -> None:
    problem, limit = house("(open door)", "(and (at r1 yard) (at r1 hall))"), AnswerLimit.of(30)
    reached = limit.reached(problem)
    assert reached is not None
    reached.count = MOST_ACTIONS
    answer = what_would_help(problem, limit, Answer("there is no plan", Known.SEARCH))
    assert answer == Answer("helpful changes were not searched: there are too many facts", Known.NOT_PROVED)


def test_without_time_nothing_is_found_and_nothing_proved() -> None:
    assert what_would_help(house(), AnswerLimit.of(0.0), Answer("there is no plan", Known.RELAXATION)).known is Known.NOT_PROVED


def test_a_call_that_is_forbidden_might_be_used_again() -> None:
    problem = forbid(rooms(ways="ab bc", goal="(at r1 c)"), frozenset({ForbiddenCall("move", ("r1", "b", "c"))}))
    assert "if move(r1, b, c) might be used: a plan with 2 calls" in [part.statement for part in help_for(problem).reasons]


SMALL = """(define (domain small) (:requirements :strips) (:predicates (p) (q) (r) (s) (x) (y) (z))
  (:action one :parameters () :precondition (q) :effect (p)) (:action two :parameters () :precondition (and (r) (s)) :effect (p))
  (:action three :parameters () :precondition (and (x) (y)) :effect (r)) (:action four :parameters () :precondition (z) :effect (x))
  (:action five :parameters () :precondition (z) :effect (y)))"""


def small(goal: str) -> Problem:
    return parse_problem(f"(define (problem p) (:domain small) (:init) (:goal {goal}))", parse_domain(SMALL))


def test_one_fact_that_two_others_follow_from_is_found() -> None:
    assert "if (z) were true: a plan with 3 calls" in [part.statement for part in help_for(small("(r)")).reasons]


class SlowAtOneFact(AnswerLimit):
    """The planner gives up where a single fact was changed."""

    def solve(self, problem: Problem, *, share: float = 1.0, improve: float = 0.0) -> PlanningResult:
        return PlanningResult(PlanningStatus.TIMED_OUT) if len(problem.init) == 1 else super().solve(problem, share=share, improve=improve)


def test_where_the_planner_gives_up_no_change_is_called_smallest() -> None:
    limit = SlowAtOneFact(AnswerLimit.of(30).end)
    answer = what_would_help(small("(p)"), limit, Answer("there is no plan", Known.RELAXATION))
    assert answer.statement == "there would be a plan with two facts changed"
    assert answer.reasons[-1] == Answer("it is not proved that no change of one fact is enough", Known.NOT_PROVED)
