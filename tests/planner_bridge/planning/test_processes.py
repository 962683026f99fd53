"""Processes and events: planned by Kairos, validated by both, and carried out while they go on."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep, plan_text, read_plan
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import foreseen
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.engines import ENGINES, Feature, problem_kind
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.actions.prediction import Prediction
from pnm.clock import run_async
from pnm.core.nature import Nature
from pnm.tasks import Code

TANK = """(define (domain tank)
  (:requirements :strips :typing :negative-preconditions :numeric-fluents :time)
  (:types tank)
  (:predicates (open ?t - tank) (wet) (served))
  (:functions (level ?t - tank) (capacity ?t - tank) (flow ?t - tank))
  (:process fill :parameters (?t - tank) :precondition (open ?t) :effect (increase (level ?t) (* #t (flow ?t))))
  (:event overflow :parameters (?t - tank)
    :precondition (and (> (level ?t) (capacity ?t)) (not (wet))) :effect (and (wet) (not (open ?t))))
  (:action turn-on :parameters (?t - tank) :precondition (not (open ?t)) :effect (open ?t))
  (:action turn-off :parameters (?t - tank) :precondition (open ?t) :effect (not (open ?t)))
  (:action serve :parameters (?t - tank)
    :precondition (and (>= (level ?t) 8) (not (open ?t)) (not (wet))) :effect (served)))"""
FULL = "(and (served) (not (wet)))"
KETTLE = """(define (domain kettle)
  (:requirements :strips :typing :negative-preconditions :numeric-fluents :time)
  (:predicates (on) (boils) (poured))
  (:functions (temperature))
  (:process heat :parameters () :precondition (on) :effect (increase (temperature) (* #t (* 0.1 (- 120 (temperature))))))
  (:event boil :parameters () :precondition (and (>= (temperature) 100) (not (boils))) :effect (and (boils) (not (on))))
  (:action switch-on :parameters () :precondition (not (on)) :effect (on))
  (:action pour :parameters () :precondition (boils) :effect (poured)))"""
BATTERY = """(define (domain battery)
  (:requirements :strips :typing :negative-preconditions :numeric-fluents :time :durative-actions)
  (:predicates (plugged) (moving) (there))
  (:functions (charge))
  (:process drain :parameters () :precondition (> (charge) 0) :effect (decrease (charge) (* #t 1)))
  (:process load :parameters () :precondition (plugged) :effect (increase (charge) (* #t 3)))
  (:action plug :parameters () :precondition (and (not (plugged)) (not (moving))) :effect (plugged))
  (:durative-action drive :parameters () :duration (= ?duration 20)
    :condition (and (at start (not (there))) (over all (>= (charge) 5)))
    :effect (and (at start (and (moving) (not (plugged)))) (at end (and (there) (not (moving)) (decrease (charge) 1))))))"""


def tank(goal: str = FULL) -> Problem:
    init = "(= (level t) 0) (= (capacity t) 10) (= (flow t) 0.5)"
    return parse_problem(f"(define (problem p) (:domain tank) (:objects t - tank) (:init {init}) (:goal {goal}))", parse_domain(TANK))


def kettle(goal: str = "(poured)") -> Problem:
    return parse_problem(f"(define (problem p) (:domain kettle) (:init (= (temperature) 20)) (:goal {goal}))", parse_domain(KETTLE))


def battery(goal: str = "(there)") -> Problem:
    return parse_problem(f"(define (problem p) (:domain battery) (:init (= (charge) 6)) (:goal {goal}))", parse_domain(BATTERY))


PROBLEMS = (tank(), tank("(>= (level t) 9)"), kettle(), kettle("(boils)"), battery(), battery("(and (there) (plugged))"))


def planned(problem: Problem) -> Plan:
    result = solve(problem, timeout=20.0, improve=0.0)
    assert result.plan is not None, result
    return result.plan


@pytest.mark.parametrize("problem", PROBLEMS)
def test_plans_wait_for_what_happens_by_itself(problem: Problem) -> None:
    assert problem.warnings == ()
    plan = planned(problem)
    assert why_invalid(problem, plan) == ""
    assert plan.makespan >= 8.0
    assert read_plan(plan_text(plan), problem) == replace(plan, cost=None)


@pytest.mark.parametrize(
    ("problem", "steps", "until", "why"),
    [
        (tank(), (("turn-on", 0.0), ("turn-off", 15.0), ("serve", 16.0)), 16.0, "step 3, serve(t), cannot start at 16 s"),
        (tank(), (("turn-on", 0.0), ("turn-off", 21.0), ("serve", 22.0)), 22.0, "step 2, turn-off(t), cannot start at 21 s"),
        (tank(), (("turn-on", 0.0), ("turn-off", 17.0), ("serve", 18.0)), 18.0, ""),
        (tank("(>= (level t) 9)"), (("turn-on", 0.0),), 17.0, "the goal does not hold at the end"),
        (tank("(>= (level t) 9)"), (("turn-on", 0.0),), 18.0, ""),
        (kettle(), (("switch-on", 0.0), ("pour", 16.0)), 16.0, "step 2, pour(), cannot start at 16 s"),
        (kettle(), (("switch-on", 0.0), ("pour", 16.2)), 16.2, ""),  # 10 ln 5 = 16.09 s
    ],
)
def test_what_happens_by_itself_is_validated(problem: Problem, steps: tuple[tuple[str, float], ...], until: float, why: str) -> None:
    arguments = tuple(problem.own_objects)
    plan = Plan(tuple(PlanStep(name, arguments, start) for name, start in steps), temporal=True, until=until)
    found = why_invalid(problem, plan)
    assert found.startswith(why)
    assert bool(found) is bool(why)


def test_what_a_plan_waits_for_comes_at_its_time() -> None:
    problem, plan = kettle(), planned(kettle())
    comes = [change.time for change in foreseen(problem, plan).timed if change.changes.get(("boils",)) is True]
    assert comes == [pytest.approx(plan.steps[0].start + 16.094, abs=0.01)]
    graph = plan_graph(problem, plan)
    assert [call.release >= comes[0] for call in graph.calls] == [call.action.name == "pour" for call in graph.calls]


def test_only_kairos_plans_for_them() -> None:
    assert Feature.NATURE in problem_kind(kettle())
    assert not any(Feature.NATURE in engine.supports for engine in ENGINES.values())


@pytest.mark.parametrize("problem", PROBLEMS)
def test_plans_are_carried_out_while_things_happen_by_themselves(problem: Problem) -> None:
    result = achieve(None, problem)
    assert (result.code, result.replans) == (Code.GOAL_REACHED, 0), result.reason


def test_calls_after_a_late_one_are_as_late() -> None:
    late = Fault("turn-on", FaultKind.SLOW, seconds=2.0)
    result = achieve(None, tank(), faults=Faults((late,)))
    assert (result.code, result.replans) == (Code.GOAL_REACHED, 0), result.reason
    assert [round(call.started or 0.0) for call in result.calls] == [0, 18, 18]


def test_a_prediction_that_fails_is_planned_for_anew() -> None:
    leak = HiddenChange({("level", "t"): 1.0}, at=10.0)
    result = achieve(None, tank(), faults=Faults(changes=(leak,)))
    assert result.code is Code.GOAL_REACHED, result.reason
    assert result.replans >= 1


def test_events_without_end_are_refused() -> None:
    text = "(define (domain d) (:requirements :time) (:predicates (on) (off)) (:event e :parameters () :precondition (on) :effect (off)))"
    problem = parse_problem("(define (problem p) (:domain d) (:init (on)) (:goal (off)))", parse_domain(text))
    assert why_invalid(problem, Plan(temporal=True, until=1.0)) == "the event e has no end: its effects leave its condition true"


def test_numbers_are_predicted_between_reports_and_corrected_by_them() -> None:
    async def lived() -> tuple[list[float], object, object]:
        knowledge, levels = initial_knowledge(tank()), []
        knowledge.sense(("level", "wet"))
        prediction = Prediction(Nature(tank()), knowledge)
        knowledge.update({("open", "t"): True})
        for reported in (None, 1.0, None, 9.5):
            await asyncio.sleep(4.5)
            prediction.bring_up_to_date()
            levels.append(knowledge.value(("level", "t")))
            knowledge.update({} if reported is None else {("level", "t"): reported})
        await asyncio.sleep(4.5)
        prediction.close()
        return levels, knowledge.value(("open", "t")), knowledge.value(("wet",))

    levels, is_open, is_wet = run_async(lived(), virtual=True)
    assert levels == pytest.approx([2.25, 4.5, 3.25, 5.5])
    assert (is_open, is_wet) == (False, None)  # it is told of what sensors report, and assumed of all else
