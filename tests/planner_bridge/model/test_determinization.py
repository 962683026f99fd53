"""Planning for actions with several outcomes: an action for each of them, and plans that say which they expect."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from hypothesis import assume, given, settings

from planner_bridge.model.determinization import determinization, untold
from planner_bridge.model.grounding import ground_step
from planner_bridge.model.plan import Plan, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from planner_bridge.planning import reachability
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.logic.effects import effects_text
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.message_fields import Flag, parse_field
from tests.support.e2e.command_line import pnm
from tests.support.files import input_error, written
from tests.support.pddl.random_problems import Features, problems

DOMAIN = """(define (domain d) (:requirements :adl :non-deterministic) (:types t) (:predicates (p ?x - t) (q) (r))
    (:action try :parameters (?x - t) :effect (and (r) (oneof (and) (p ?x) (q) (p ?x))))
    (:action try__1 :precondition (p a) :effect (q))
    (:action nothing :effect (oneof (and) (and)))
    (:action each :precondition (q) :effect (forall (?x - t) (oneof (p ?x) (and)))))"""


def problem(goal: str, domain: str = DOMAIN) -> Problem:
    return parse_problem(f"(define (problem one) (:domain d) (:objects a b - t) (:goal {goal}))", parse_domain(domain))


def test_that_there_is_no_plan_is_explained_once_and_with_the_actions_of_the_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, ask = list[Problem](), reachability.why_unreachable
    monkeypatch.setattr(reachability, "why_unreachable", lambda one: asked.append(one) or ask(one))
    closed = problem("(p b)", DOMAIN.replace(":effect (and (r)", ":precondition (p ?x) :effect (and (r)"))
    result = solve(closed)
    assert result.status is PlanningStatus.UNSOLVABLE
    assert "try(" in result.message
    assert asked == [closed]


def test_every_outcome_that_changes_something_is_an_action() -> None:
    found = determinization(problem("(q)"))
    effects = {name: effects_text(schema.end_effects) for name, schema in found.problem.domain.actions.items()}
    assert effects == {
        "try__2": "(r)",
        "try__3": "(and (r) (p ?x))",
        "try__4": "(and (r) (q))",
        "try__1": "(q)",
        "each__1": "(and (p a) (p b))",
        "each__2": "(p a)",
        "each__3": "(p b)",
    }
    assert found.outcomes == {
        **{"try__2": ("try", "1"), "try__3": ("try", "2"), "try__4": ("try", "3")},
        **{"each__1": ("each", "1+1"), "each__2": ("each", "1+2"), "each__3": ("each", "2+1")},
    }
    assert not found.problem.domain.uncertain
    again = parse_domain(write_domain(found.problem.domain))
    assert again.actions == found.problem.domain.actions
    assert parse_problem(write_problem(found.problem), again).init == found.problem.init


def test_a_plan_says_which_outcome_it_expects() -> None:
    asked = problem("(and (p a) (p b))")
    result = solve(asked, improve=0.0)
    assert result.plan is not None
    assert all((step.action, step.outcome) in {("try", "2"), ("try", "3"), ("each", "1+1")} for step in result.plan.steps)
    assert why_invalid(asked, result.plan) == ""
    for call in plan_graph(asked, result.plan).calls:
        assert call.action.outcome in [way.name for way in call.action.outcomes]
        assert next(way.effects for way in call.action.outcomes if way.name == call.action.outcome) == call.action.end_effects


def test_the_first_outcome_is_expected_where_nothing_is_said() -> None:
    asked = problem("(r)")
    action = ground_step(asked.domain, "try", ("a",), None, "", asked.members)
    assert (action.outcome, effects_text(action.end_effects)) == ("1", "(r)")
    assert [(way.name, way.chance) for way in action.outcomes] == [("1", 0.25), ("2", 0.5), ("3", 0.25)]
    certain = ground_step(asked.domain, "nothing", (), None, "", asked.members)
    assert (certain.outcomes, certain.outcome, certain.end_effects) == ((), "", ())


@pytest.mark.parametrize(("step", "why"), [(PlanStep("try", ("a",), outcome="9"), "no outcome '9'; it has 1, 2, 3")])
def test_an_outcome_that_there_is_not_makes_a_plan_wrong(step: PlanStep, why: str) -> None:
    assert why in why_invalid(problem("(r)"), Plan((step,)))


def test_no_outcome_that_leads_to_the_goal_is_no_plan() -> None:
    result = solve(problem("(q)", "(define (domain d) (:types t) (:predicates (p) (q)) (:action a :effect (oneof (p) (and))))"))
    assert (result.status, result.message) == (PlanningStatus.UNSOLVABLE, "(q) cannot be reached: no action brings it about")


def test_the_command_says_which_outcomes_its_plan_expects(tmp_path: Path) -> None:
    asked = problem("(p a)", DOMAIN.replace("(:action each", "(:action other"))
    files = written(tmp_path / "d.pddl", write_domain(asked.domain)), written(tmp_path / "p.pddl", write_problem(asked))
    found = json.loads(pnm("plan", *map(str, files), "--json", "--planner", "race:kairos").stdout)
    assert [(step["action"], step["outcome"]) for step in found["steps"]] == [("try", "2")]
    assert found["is_best"] is False
    assert "try(a) -> 2" in pnm("plan", *map(str, files)).stdout


@settings(max_examples=20, deadline=None)
@given(problems(Features(uncertain=True)))
def test_plans_of_any_problem_say_outcomes_that_lead_to_the_goal(asked: Problem) -> None:
    assume(all(input_error(partial(asked.outcomes, name)) is None for name in asked.domain.uncertain))
    each = determinization(asked)
    for result in (solve(asked, improve=0.0, timeout=1.0), solve(each.problem, improve=0.0, timeout=1.0)):
        assert result.status not in (PlanningStatus.INVALID_PLAN, PlanningStatus.DISAGREEMENT, PlanningStatus.INVALID), result.message
        if result.plan is not None:
            assert why_invalid(asked, each.plan(result.plan)) == ""


def test_what_servers_need_and_what_was_learned_holds_for_every_outcome() -> None:
    found = determinization(problem("(q)"))
    bound = found.bindings(Bindings({"try": Binding(seconds=7.0, resources=("arm",))}))
    assert [bound.of(name).seconds for name in ("try__2", "try__3", "try__4", "try__1", "try")] == [7.0, 7.0, 7.0, None, 7.0]
    assert (bound.of("try__3").server, bound.of("try__3").resources, bound.of("each__1").server) == ("try", ("arm",), "each")


@pytest.mark.parametrize(
    ("told", "unseen", "expected"),
    [
        ([], {"p", "q", "r"}, [("each", ("1+1", "1+2", "2+1", "2+2"), ("p",)), ("try", ("1", "2", "3"), ("p", "q"))]),
        ([], {"p"}, [("each", ("1+1", "1+2", "2+1", "2+2"), ("p",)), ("try", ("1", "2"), ("p",))]),
        (["1"], {"p", "q"}, [("each", ("1+1", "1+2", "2+1", "2+2"), ("p",)), ("try", ("2", "3"), ("p", "q"))]),
        (["1", "3"], {"p", "q"}, [("each", ("1+1", "1+2", "2+1", "2+2"), ("p",))]),
        ([], set(), []),
    ],
)
def test_outcomes_are_told_apart_by_the_result_or_by_sensors(told: list[str], unseen: set[str], expected: list[object]) -> None:
    bindings = Bindings({"try": Binding(outcomes={name: Flag(parse_field(f"is_{name}")) for name in told})})
    assert list(untold(problem("(q)"), bindings, frozenset(unseen))) == expected
