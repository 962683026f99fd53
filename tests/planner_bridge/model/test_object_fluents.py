"""Fluents whose values are objects mean the same in plans, runs and replanning."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import kairos
import pytest

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import PlanAgain, ResumePlan
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Compare, Condition, Not, evaluate
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Constant, Fluent, Value, ValueOf
from pnm.core.machine.bindings import Binding, Bindings, goal_data
from tests.support.runs.plan_graphs import shown
from tests.support.tasks.planned_runs import SimulatedSite, change_at, on_site, timed

TRAYS = parse_domain("""
(define (domain trays) (:requirements :durative-actions :typing :adl :fluents)
  (:types robot room thing - object)
  (:constants hall - room)
  (:predicates (greeted ?r - robot))
  (:functions (battery) - number (place ?r - robot) (wanted ?r - robot) - room)
  (:durative-action move :parameters (?r - robot ?a ?b - room) :duration (= ?duration 4)
    :condition (at start (= (place ?r) ?a)) :effect (and (at start (assign (place ?r) undefined)) (at end (assign (place ?r) ?b))))
  (:durative-action fetch :parameters (?r - robot) :duration (= ?duration 3)
    :condition (at start (not (= (place ?r) (wanted ?r)))) :effect (at end (assign (place ?r) (wanted ?r))))
  (:action greet :parameters (?r - robot) :precondition (= (place ?r) hall) :effect (greeted ?r)))
""")
"""Where a robot is, is a value: ``(place r1)``; on its way it is nowhere. It fetches things from where they are wanted."""


def tray_problem(init: str, goal: str) -> Problem:
    things = "(:objects r1 r2 - robot lab yard - room cup - thing)"
    return parse_problem(f"(define (problem p) (:domain trays) {things} (:init {init}) (:goal {goal}))", TRAYS)


R1, R2 = ("place", "r1"), ("place", "r2")
IN_LAB = tray_problem("(= (place r1) hall)", "(= (place r1) lab)")
TO_LAB = timed("0 4 move r1 hall lab")


def test_objects_order_calls_like_facts() -> None:
    plan = timed("0 4 move r1 hall lab", "4.001 4 move r1 lab yard", "0 4 move r2 hall lab", "8.002 0 greet r1")
    graph = plan_graph(tray_problem("(= (place r1) hall) (= (place r2) hall)", "(= (place r1) yard)"), plan)
    assert shown(graph)[0] == "end of #0 < start of #1 ((place r1))"
    assert not any(2 in (one.before.call, one.after.call) for one in graph.orderings)


@on_site(IN_LAB)
async def test_a_robot_whose_place_is_a_value_is_nowhere_on_its_way_and_arrives(site: SimulatedSite) -> None:
    places: list[object] = []
    asyncio.get_running_loop().call_later(2.0, lambda: places.append(site.knowledge.value(R1)))
    result = await site.run(plan_graph(IN_LAB, TO_LAB))
    assert result.goal, result.reason
    assert (places, site.truth(R1), site.knowledge.value(R1)) == ([UNDEFINED], "lab", "lab")


@on_site(replace(IN_LAB, init={("wanted", "r1"): "lab"}))
async def test_a_robot_that_is_nowhere_is_not_where_it_is_wanted(site: SimulatedSite) -> None:
    assert (await site.carry_out("0 3 fetch r1")).goal


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"place"})])
def test_an_object_that_does_not_come_is_missed_if_it_is_sensed(assumed: frozenset[str]) -> None:
    @on_site(IN_LAB, Faults((Fault("move", FaultKind.NO_EFFECT),)), Bindings(assumed=assumed))
    async def scenario(site: SimulatedSite) -> None:
        result = await site.run(plan_graph(IN_LAB, TO_LAB))
        missed = [] if assumed else [("effects_missing", "(= (place r1) lab)")]
        assert (result.goal, [(one.cause, one.expected) for one in result.failures]) == (bool(assumed), missed)
        assert site.truth(R1) == "hall"

    scenario()


@on_site(IN_LAB, Faults((Fault("move", FaultKind.ABORT),)), Bindings({"move": Binding(retries=0)}, assumed=frozenset({"place"})))
async def test_an_aborted_move_leaves_the_robot_where_it_was_known_to_be(site: SimulatedSite) -> None:
    graph = plan_graph(IN_LAB, TO_LAB)
    result = await site.run(graph)
    assert [one.cause for one in result.failures] == ["aborted"]
    assert (site.truth(R1), site.knowledge.value(R1)) == ("hall", "hall")
    assert isinstance(site.decide(graph, result), ResumePlan)


@on_site(IN_LAB)
async def test_a_robot_that_was_carried_away_is_found_by_the_precondition(site: SimulatedSite) -> None:
    site.backend.robots.world.change({R1: "yard"})
    graph = plan_graph(IN_LAB, TO_LAB)
    result = await site.run(graph)
    assert [(one.cause, one.observed) for one in result.failures] == [("precondition_false", "(place r1) is yard")]
    assert isinstance(site.decide(graph, result), PlanAgain)
    assert site.now().init[R1] == "yard"
    assert (await site.run(plan_graph(site.now(), timed("0 4 move r1 yard lab")))).goal


@on_site(replace(IN_LAB, init={R1: "lab"}))
async def test_a_robot_that_is_there_does_not_move(site: SimulatedSite) -> None:
    result = await site.run(plan_graph(IN_LAB, TO_LAB))
    assert (result.goal, [call.outcome for call in result.calls]) == (True, ["already true"])


@on_site(tray_problem("(= (place r1) hall) (= (wanted r1) lab)", "(= (place r1) yard)"), change_at(1.0, {("wanted", "r1"): "yard"}))
async def test_a_value_read_at_the_end_is_the_one_it_has_then(site: SimulatedSite) -> None:
    result = await site.carry_out("0 3 fetch r1")
    assert result.goal, result.reason


FIELDS = Bindings({"fetch": Binding(goal={"robot": "?r", "to": "(wanted ?r)"})})


@on_site(tray_problem("(= (place r1) hall) (= (wanted r1) lab)", "(= (place r1) lab)"), bindings=FIELDS)
async def test_a_goal_field_may_be_an_object_that_is_known(site: SimulatedSite) -> None:
    graph = plan_graph(site.problem, timed("0 3 fetch r1"))
    call, binding = graph.calls[0].action, FIELDS.of("fetch")
    data = goal_data(call, binding, ("robot", "to"), EvaluationContext(site.knowledge))
    assert data == ({"robot": "r1", "to": "lab"}, ())
    assert (await site.run(graph)).goal
    for nothing in (UNKNOWN, UNDEFINED):
        site.knowledge.world.update({("wanted", "r1"): nothing})
        assert goal_data(call, binding, None, EvaluationContext(site.knowledge))[1] == ("to",)


def test_a_problem_from_what_is_known_has_only_values_that_it_declares() -> None:
    knowledge = initial_knowledge(IN_LAB)
    strange: dict[Fluent, Value] = {R2: "moon", ("place", "zz"): "lab", ("wanted", "r1"): "cup", ("wanted", "r2"): 3.0, ("battery",): "lab"}
    knowledge.update({**strange, ("battery",): "lab", ("greeted", "r1"): True})
    assert problem_now(IN_LAB, knowledge).init == {R1: "hall", ("greeted", "r1"): True}
    for nothing in (UNKNOWN, UNDEFINED):
        knowledge.update({("battery",): 0.5, R2: "yard", R1: nothing})
        assert problem_now(IN_LAB, knowledge).init == {("battery",): 0.5, R2: "yard", ("greeted", "r1"): True}


HOLDING, WANTS, HAS = ValueOf(("holding", "r1")), ValueOf(("wants", "r1")), ValueOf(("has", "r1"))
CUP = Constant("cup")
EQUALITIES = [Compare("=", HOLDING, CUP), Compare("=", HAS, CUP), Compare("=", HAS, Constant("bowl")), Compare("=", HOLDING, HAS)]
EQUALITIES += [Compare("=", WANTS, HAS), Compare("=", HAS, HAS)]


@pytest.mark.parametrize("condition", [*EQUALITIES, *map(Not, EQUALITIES)], ids=str)
def test_the_planner_also_takes_what_is_undefined_for_equal_to_nothing(condition: Condition) -> None:
    domain = kairos.parse_domain(f"""(define (domain d) (:requirements :typing :object-fluents :adl) (:types robot thing - object)
      (:constants r1 - robot cup bowl - thing) (:predicates (done))
      (:functions (holding ?r - robot) - thing (wants ?r - robot) - thing (has ?r - robot) - thing)
      (:action a :parameters () :precondition {condition} :effect (done)))""")
    text = "(define (problem p) (:domain d) (:init (= (has r1) cup) (= (wants r1) bowl)) (:goal (done)))"
    found = kairos.solve(domain, kairos.parse_problem(text, domain))
    state = KnowledgeBase({HAS.fluent: "cup", WANTS.fluent: "bowl"})
    assert found.status is (kairos.Status.SOLVED if evaluate(condition, state) else kairos.Status.UNSOLVABLE)
