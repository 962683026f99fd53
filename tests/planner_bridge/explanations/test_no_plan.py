"""Why there is no plan, what would make one possible, and why not another action; and what of that is proved.

A whole tree is in docs/guides/why.md.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.explanations.answer import Answer, Best, Known, NoSmallerChange, Unsolvable
from planner_bridge.explanations.goal_now import what_would_help
from planner_bridge.explanations.needed_call import Forced, why_not
from planner_bridge.explanations.no_plan import AnswerLimit, why_no_plan
from planner_bridge.model.guards import ForbiddenCall, forbid
from planner_bridge.model.plan import PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.reachability import MOST_ACTIONS
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from tests.support.pddl.explanations.checked_claims import Checked
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.problems import hard, matches, rooms, tanks

GAVE_UP = PlanningResult(PlanningStatus.TIMED_OUT, message="after 1 s")


def why(problem: Problem) -> Answer:
    limit = AnswerLimit.of(30)
    found = limit.first_plan(problem)
    assert found.plan is None
    return why_no_plan(problem, found, limit)


def test_a_search_that_gave_up_proves_nothing() -> None:
    answer = why_no_plan(hard(), GAVE_UP, AnswerLimit.of(0.0))
    assert [(part.known, part.claims) for part in answer.every()] == [(Known.NOT_PROVED, ())]
    assert "time-out: after 1 s" in answer.statement


def test_goals_that_exclude_each_other_are_named_without_the_others() -> None:
    answer = why(house("(open door)", "(and (has r1 cup) (at r1 yard) (at r1 hall))"))
    assert (answer.statement, answer.known) == ("there is no plan", Known.SEARCH)
    (conflict,) = answer.reasons
    assert conflict.statement == "(at r1 yard) and (at r1 hall) exclude each other"
    assert [reason.known for reason in conflict.reasons] == [Known.PLAN, Known.PLAN]


def test_goals_of_which_it_is_not_known_whether_each_is_possible_are_not_said_to_exclude_each_other() -> None:
    problem = house("(open door)", "(and (at r1 yard) (at r1 hall))")
    found = PlanningResult(PlanningStatus.UNSOLVABLE)
    (conflict,) = why_no_plan(problem, found, AnswerLimit.of(0.0)).reasons
    assert conflict.statement == "(and (at r1 yard) (at r1 hall)) is impossible"
    assert {reason.known for reason in conflict.reasons} == {Known.NOT_PROVED}


def test_what_is_unknown_proves_nothing() -> None:
    problem = replace(house(), unknown=frozenset({("key", "r1", "door")}))
    answer = why(problem)
    assert "(key r1 door) is unknown, and counted as false" in answer.statement
    assert not any(part.known.is_certain or part.claims for part in answer.every())


def test_what_must_not_be_used_is_where_the_tree_ends() -> None:
    answer = why(forbid(rooms(ways="ab bc", goal="(at r1 c)"), frozenset({ForbiddenCall("move", ("r1", "b", "c"))})))
    assert [*answer.every()][-1].statement == "move(r1, b, c) must not be used any more"


def test_two_doors_are_both_named() -> None:
    text = str(why(rooms(ways="ab", goal="(at r1 c)")))
    assert "move(r1, a, c) would make it so, but needs (way a c)" in text
    assert "move(r1, b, c) would make it so, but needs (way b c)" in text
    assert "1 more way to it is closed as well" not in text.splitlines()[0]


CIRCLE = """(define (domain circle) (:requirements :adl :derived-predicates :numeric-fluents) (:predicates (p) (q) (both)) (:functions (n))
  (:derived (both) (and (p) (q)))
  (:action one :parameters () :precondition (q) :effect (p)) (:action two :parameters () :precondition (p) :effect (q))
  (:action go :parameters () :precondition (> (n) 2) :effect (p)))"""


@pytest.mark.parametrize(
    ("goal", "init", "last"),
    [
        ("(q)", "(= (n) 1)", "(> (n) 2) is false, and no action changes that"),
        ("(q)", "", "(n) has no value"),
        ("(both)", "(= (n) 1)", "(> (n) 2) is false, and no action changes that"),
    ],
)
def test_the_end_of_the_tree_is_what_is_missing(goal: str, init: str, last: str) -> None:
    problem = parse_problem(f"(define (problem x) (:domain circle) (:init {init}) (:goal {goal}))", parse_domain(CIRCLE))
    assert last in [part.statement for part in why(problem).every()]


def test_a_circle_is_called_one() -> None:
    domain = parse_domain(CIRCLE.replace("(:action go :parameters () :precondition (> (n) 2) :effect (p))", ""))
    answer = why(parse_problem("(define (problem x) (:domain circle) (:init) (:goal (p)))", domain))
    assert [*answer.every()][-1].statement == "(p) would be needed for itself"


def test_without_its_constraints_there_would_be_a_plan() -> None:
    text = "(define (problem x) (:domain circle) (:init) (:goal (q)) (:constraints (always (not (p)))))"
    answer = why(parse_problem(text, parse_domain(CIRCLE.replace(":adl", ":adl :constraints").replace("(> (n) 2)", "(and)"))))
    assert [reason.known for reason in answer.reasons] == [Known.PLAN]
    assert answer.reasons[0].statement.startswith("there is a plan without these constraints: (always (not (p)))")


# --- what would help ---


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


# --- why not another action ---


def ask(problem: Problem, action: str, *arguments: str, seconds: float = 30.0) -> Answer:
    limit = AnswerLimit.of(seconds)
    return why_not(problem, PlanStep(action, arguments), limit.first_plan(problem), limit)


def test_an_action_that_no_plan_uses_is_proved_to_be_so() -> None:
    once = rooms(ways="ab bc ad dc", goal="(and (at r1 c) (at r2 c) (not (at r1 d)))", init="(at r1 b) (at r2 a)")
    answer = ask(once, "move", "r1", "a", "d")
    assert answer.known is Known.RELAXATION
    answer = ask(rooms(ways="ab ac bc", goal="(and (at r1 a) (at r2 c))"), "move", "r1", "a", "b")
    assert (answer.statement, answer.known) == ("no plan that reaches the goal uses move(r1, a, b)", Known.SEARCH)
    assert [type(claim) for claim in answer.claims] == [Unsolvable]


def test_one_that_is_as_good_is_called_so() -> None:
    plan = solve(rooms(goal="(at r1 c)"), improve=0.0).plan
    assert plan
    other = "d" if "b" in plan.steps[0].arguments else "b"
    answer = ask(rooms(goal="(at r1 c)"), "move", "r1", "a", other)
    assert answer.statement == f"a plan that uses move(r1, a, {other}) is as good: 2 against 2 calls"


def test_one_that_the_plan_has_is_named() -> None:
    assert ask(house("(open door)", "(has r1 cup)"), "take", "r1", "cup", "kitchen").statement == (
        "the plan does use take(r1, cup, kitchen): it is call #1"
    )


def test_without_time_nothing_is_proved() -> None:
    found = PlanningResult(PlanningStatus.TIMED_OUT)
    problem = hard(4)
    name, schema = next(iter(problem.domain.actions.items()))
    arguments = tuple(problem.objects_by_type[variable.types[0]][0] for variable in schema.parameters)
    answer = why_not(problem, PlanStep(name, arguments), found, AnswerLimit.of(0.0))
    assert answer.known in (Known.NOT_PROVED, Known.RELAXATION)


@pytest.mark.parametrize("problem", [rooms(), matches(), tanks("4"), house("")], ids=["rooms", "time", "numbers", "house"])
def test_a_plan_of_the_forced_problem_is_one_of_the_problem_with_the_action(problem: Problem) -> None:
    for schema in problem.domain.actions.values():
        arguments = tuple(problem.objects_by_type[variable.types[0]][-1] for variable in schema.parameters)
        asked = Forced.of(problem, PlanStep(schema.name, arguments))
        result = solve(asked.problem, timeout=5.0, improve=0.0)
        if result.plan:
            plan = asked.plan(result.plan)
            assert why_invalid(problem, plan) == ""
            assert (schema.name, arguments) in [(step.action, step.arguments) for step in plan.steps]


class NeverSure(AnswerLimit):
    """The planner never proves that a plan is best."""

    def solve(self, problem: Problem, *, share: float = 1.0, improve: float = 0.0) -> PlanningResult:
        found = super().solve(problem, share=share, improve=improve)
        return replace(found, plan=found.plan and replace(found.plan, is_best=False))


@pytest.mark.parametrize("kind", [AnswerLimit, NeverSure])
def test_a_plan_with_it_is_worse_by_so_much_which_is_called_proved_only_if_it_is(kind: type[AnswerLimit]) -> None:
    problem, limit = house("(open door)", "(has r1 cup)"), kind(AnswerLimit.of(30).end)
    answer = why_not(problem, PlanStep("move", ("r1", "hall", "yard")), limit.first_plan(problem), limit)
    proved = [claim for claim in answer.claims if isinstance(claim, Best)]
    assert answer.statement == (
        "a plan that uses move(r1, hall, yard) is worse by 2 calls at least: 4 against 2 calls"
        if proved
        else "the best plan found that uses move(r1, hall, yard) is worse by 2 calls: 4 against 2 calls"
    )
    assert (answer.known, answer.reasons[-1].known is Known.NOT_PROVED) == ((Known.SEARCH, False) if proved else (Known.PLAN, True))
    assert not (proved and kind is NeverSure)
    assert answer.reasons[0].statement == "at first it could begin"
