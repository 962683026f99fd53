"""Derived facts, fluents whose values are objects, and conditions decided at the start: the same in plans, runs and replanning."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any as Anything
from uuid import uuid4

import kairos
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.replanning import Decision, History, Limits, PlanAgain, Progress, ResumePlan, decide, why_not
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Not
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import Set, When
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Constant, Fluent, Value, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.core.machine.bindings import Binding, Bindings, goal_data
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.verification.verify import verify
from pnm.errors import InputError
from pnm.executor import Executor


@dataclass
class Simulation:
    """A simulated world, and what is known of it, for one run after the other."""

    problem: Problem
    backend: SimulatedBackend
    knowledge: Layered
    bindings: Bindings

    async def run(self, graph: PlanGraph) -> RunResult:
        machine = generate(graph, self.bindings)
        verify(machine)
        fields = self.backend.client.goal_fields
        return await Executor(
            Run(machine, self.knowledge, id=uuid4(), bindings=self.bindings, goal_fields=fields), self.backend.client
        ).execute()

    def truth(self, fluent: Fluent) -> object:
        return self.backend.robots.world.truth.value(fluent)

    def now(self) -> Problem:
        return problem_now(self.problem, self.knowledge.world)

    def decide(self, graph: PlanGraph, result: RunResult) -> Decision:
        history = History().after(result.calls, result.failures)
        return decide(self.now(), Progress(graph, result.calls), self.knowledge.world, history, Limits())


Scenario = Callable[[Simulation], Coroutine[Anything, Anything, None]]


def simulate(problem: Problem, scenario: Scenario, faults: Faults = NO_FAULTS, bindings: Bindings = Bindings()) -> None:
    async def main() -> None:
        simulation = Simulation(problem, simulated_backend(problem, bindings, faults), Layered(initial_knowledge(problem)), bindings)
        await simulation.backend.open(simulation.knowledge.world)
        try:
            await scenario(simulation)
        finally:
            await simulation.backend.close()

    run_async(main(), virtual=True)


def timed(*steps: str) -> Plan:
    """Steps such as ``"0 4 go r1 a b"``: when, how long, what."""
    found = [step.split() for step in steps]
    return Plan(tuple(PlanStep(one[2], tuple(one[3:]), float(one[0]), float(one[1])) for one in found), temporal=True)


def shown(graph: PlanGraph) -> list[str]:
    return [str(ordering) for ordering in graph.orderings]


def changed(when: float, changes: dict[Fluent, Value]) -> Faults:
    return Faults(changes=(HiddenChange(changes, at=when),))


# --- derived facts ------------------------------------------------------------------------------

DOORS = """
(define (domain doors) (:requirements :durative-actions :typing)
  (:types robot room door - object)
  (:predicates (at ?r - robot ?a - room) (joins ?d - door ?a ?b - room) (open ?d - door) (way ?a ?b - room) (shut-in ?r - robot))
  (:durative-action go :parameters (?r - robot ?a ?b - room) :duration (= ?duration 4)
    :condition (and (at start (at ?r ?a)) (over all (way ?a ?b)))
    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))
  (:durative-action open-door :parameters (?d - door) :duration (= ?duration 2) :condition () :effect (at end (open ?d)))
  (:durative-action close-door :parameters (?d - door) :duration (= ?duration 2) :condition () :effect (at start (not (open ?d))))
  (:durative-action ring :parameters (?r - robot) :duration (= ?duration 1) :condition (at start (shut-in ?r)) :effect ()))
"""
A, B, C, D, R = (
    Variable(f"?{name}", (kind,)) for name, kind in (("a", "room"), ("b", "room"), ("c", "room"), ("d", "door"), ("r", "robot"))
)
PASSAGE = Exists((D,), All((Holds(("joins", "?d", "?a", "?c")), Holds(("open", "?d")))))
RULES = (
    DerivationRule(
        "way", (A, B), Any((Compare("=", Constant("?a"), Constant("?b")), Exists((C,), All((PASSAGE, Holds(("way", "?c", "?b")))))))
    ),
    DerivationRule(
        "shut-in",
        (R,),
        Exists(
            (A,),
            All(
                (
                    Holds(("at", "?r", "?a")),
                    ForAll((B,), Any((Compare("=", Constant("?a"), Constant("?b")), Not(Holds(("way", "?a", "?b")))))),
                )
            ),
        ),
    ),
)
DOMAIN = replace(parse_domain(DOORS), rules=RULES)


def doors(init: str = "(at r1 k)", goal: str = "(at r1 h)") -> Problem:
    """Kitchen, hall and garage: d1 leads from the kitchen to the hall, d2 to the garage, d3 from there to the hall."""
    joins = " ".join(f"(joins {door} {one} {other})" for door, one, other in DOORWAYS)
    things = "(:objects r1 r2 - robot k h g - room d1 d2 d3 - door)"
    return parse_problem(f"(define (problem p) (:domain doors) {things} (:init {joins} {init}) (:goal {goal}))", DOMAIN)


DOORWAYS = [(door, *pair) for door, pair in (("d1", "kh"), ("d2", "kg"), ("d3", "gh")) for pair in (pair, pair[::-1])]


def test_who_reads_a_derived_fact_waits_for_what_it_rests_on() -> None:
    graph = plan_graph(doors(), timed("0 2 open-door d1", "2.001 4 go r1 k h", "6.002 2 close-door d1"))
    assert sorted(shown(graph)) == [f"end of #{one} < start of #{other} ((open d1))" for one, other in ((0, 1), (0, 2), (1, 2))]
    assert graph.rules.rules == RULES


def test_a_derived_fact_that_holds_in_any_case_orders_nothing() -> None:
    steps = ("0 2 open-door d1", "2.001 4 go r1 k h", "6.002 2 close-door d1")
    assert shown(plan_graph(doors("(at r1 k) (open d2) (open d3)"), timed(*steps))) == ["end of #0 < start of #2 ((open d1))"]
    dead_end = plan_graph(doors("(at r1 k) (open d1)"), timed("0 2 open-door d2", "2.001 4 go r1 k h"))
    assert shown(dead_end) == []


def test_writes_that_keep_a_derived_over_all_condition_true_together_are_ordered() -> None:
    steps = ("0 4 go r1 k h", "0 2 open-door d2", "0.5 2 open-door d3", "3 0.5 close-door d1")
    graph = plan_graph(doors("(at r1 k) (open d1)"), timed(*steps))
    assert {"end of #1 < start of #3 ((open d2), (open d1))", "end of #2 < start of #3 ((open d3), (open d1))"} <= set(shown(graph))


def random_walk(problem: Problem, chooser: random.Random) -> Plan:
    """A random plan that works: doors are opened and closed, robots go where there is a way, or ring if there is none."""
    knowledge, steps = initial_knowledge(problem), list[str]()
    for now in range(0, 50, 5):
        door, robot = chooser.choice(("d1", "d2", "d3")), chooser.choice(("r1", "r2"))
        here = next(room for room in "khg" if knowledge.value(("at", robot, room)) is True)
        there = [room for room in "khg" if room != here and knowledge.value(("way", here, room)) is True]
        kind = chooser.choice(("open", "close", "go", "go"))
        if kind != "go":
            knowledge.update({("open", door): kind == "open"})
            steps.append(f"{now} 2 {kind}-door {door}")
        elif there:
            target = chooser.choice(there)
            knowledge.update({("at", robot, here): False, ("at", robot, target): True})
            steps.append(f"{now} 4 go {robot} {here} {target}")
        else:
            steps.append(f"{now} 1 ring {robot}")
    return timed(*steps)


def any_order(graph: PlanGraph, chooser: random.Random) -> PlanGraph:
    """The graph with all its events in one order that it allows."""
    left = {
        PlanEvent(call.index, moment): {PlanEvent(call.index, Moment.START)} - {PlanEvent(call.index, moment)}
        for call in graph.calls
        for moment in Moment
    }
    for one in graph.orderings:
        left[one.after].add(one.before)
    order: list[PlanEvent] = []
    while left:
        order.append(chooser.choice(sorted((event for event, before in left.items() if not before & left.keys()), key=str)))
        del left[order[-1]]
    return replace(graph, orderings=tuple(Ordering(*pair) for pair in pairwise(order) if pair[0].call != pair[1].call))


@settings(max_examples=60, deadline=None)
@given(st.sets(st.sampled_from(("d1", "d2", "d3"))), st.randoms(use_true_random=False))
def test_every_order_that_the_graph_allows_works(opened: set[str], chooser: random.Random) -> None:
    problem = doors(" ".join(("(at r1 k) (at r2 g)", *(f"(open {door})" for door in sorted(opened)))), goal="(and)")
    graph = plan_graph(problem, random_walk(problem, chooser))
    for _ in range(3):
        assert why_not(Progress.beginning(any_order(graph, chooser)), initial_knowledge(problem)) == ""


BOTH = timed("0 2 open-door d1", "2.001 4 go r1 k h")


def test_a_plan_with_derived_conditions_and_a_derived_goal_is_carried_out() -> None:
    problem = doors(goal="(and (at r1 h) (way g k) (not (shut-in r1)))", init="(at r1 k) (open d3)")

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, BOTH))
        assert result.goal, result.reason
        assert [(call.started, call.ended) for call in result.calls] == [(0.0, 2.0), (2.0, 6.0)]

    simulate(problem, scenario)


def test_a_derived_precondition_that_is_false_says_what_is_wanting() -> None:
    problem = doors("(at r1 k)")

    async def scenario(simulation: Simulation) -> None:
        graph = plan_graph(problem, timed("0 4 go r1 k h"))
        result = await simulation.run(graph)
        assert [failure.cause for failure in result.failures] == ["precondition_false"]
        assert result.failures[0].expected == "(way k h)"
        assert result.failures[0].observed.startswith("(way k h) is false for want of (open d")
        decision = simulation.decide(graph, result)
        assert isinstance(decision, PlanAgain)
        assert decision.why.startswith("go(r1, k, h) would go on although (way k h) is false for want of (open d")

    simulate(problem, scenario)


def test_a_derived_over_all_condition_that_breaks_is_noticed_and_planned_around() -> None:
    """A door falls shut behind the robot's back: the way is gone, a new plan opens another."""
    problem = doors("(at r1 k) (open d1) (open d3)")

    async def scenario(simulation: Simulation) -> None:
        graph = plan_graph(problem, timed("0 4 go r1 k h"))
        result = await simulation.run(graph)
        assert [failure.cause for failure in result.failures] == ["invariant_false"]
        assert result.failures[0].observed.startswith("(way k h) is false for want of (open d")
        assert result.calls[0].ended == pytest.approx(1.01)
        assert isinstance(simulation.decide(graph, result), PlanAgain)
        result = await simulation.run(plan_graph(simulation.now(), timed("0 2 open-door d2", "2.001 4 go r1 k h")))
        assert result.goal, result.reason
        assert simulation.truth(("at", "r1", "h")) is True

    simulate(problem, scenario, changed(1.0, {("open", "d1"): False}))


def test_a_base_fact_that_breaks_does_no_harm_while_the_derived_one_holds() -> None:
    problem = doors("(at r1 k) (open d1) (open d2) (open d3)")

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert result.goal
        assert result.failures == ()

    simulate(problem, scenario, changed(1.0, {("open", "d1"): False}))


def test_nobody_who_watches_the_doors_leaves_the_world_to_find_out() -> None:
    problem = doors("(at r1 k) (open d1)")
    bindings = Bindings({"go": Binding(retries=0)}, assumed=frozenset({"open"}))

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert [failure.cause for failure in result.failures] == ["aborted"]
        assert result.failures[0].observed.endswith("(way k h) was not so all the time")

    simulate(problem, scenario, changed(1.0, {("open", "d1"): False}), bindings)


def test_the_rest_of_a_plan_is_resumed_if_its_derived_conditions_still_hold() -> None:
    problem = doors("(at r1 k)")
    bindings = Bindings({"go": Binding(retries=0)})

    async def scenario(simulation: Simulation) -> None:
        graph = plan_graph(problem, BOTH)
        result = await simulation.run(graph)
        assert [failure.cause for failure in result.failures] == ["aborted"]
        decision = simulation.decide(graph, result)
        assert isinstance(decision, ResumePlan)
        assert [str(call.action) for call in decision.rest.calls] == ["go(r1, k, h)"]
        assert (await simulation.run(decision.rest)).goal

    simulate(problem, scenario, Faults((Fault("go", FaultKind.ABORT, times=1),)), bindings)


def test_a_late_report_about_what_is_below_a_derived_fact_is_waited_for() -> None:
    problem = doors("(at r1 k)")

    async def scenario(simulation: Simulation) -> None:
        simulation.knowledge.world.sense({"open"}, lag=3.0)
        asyncio.get_running_loop().call_later(2.5, simulation.backend.robots.world.change, {("open", "d1"): True})
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert result.goal, result.reason
        assert result.calls[0].started == 2.5

    simulate(problem, scenario)


TELEPORT = replace(
    DOMAIN.actions["go"],
    precondition=TRUE,
    start_effects=(Set(("open", "d1"), Constant(True)),),
    end_condition=Holds(("way", "?a", "?b")),
    end_effects=(Set(("open", "d1"), Constant(False)), Set(("at", "?r", "?b"), Constant(True))),
)


def test_what_an_action_changes_below_a_derived_fact_is_not_asked_of_it_before_or_after() -> None:
    """It opens the door that it needs to be open, and shuts it: neither can be seen before or after."""
    problem = replace(doors("(at r1 k)"), domain=replace(DOMAIN, actions={"go": TELEPORT}))

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert [call.outcome for call in result.calls] == ["succeeded"]

    simulate(problem, scenario)


def test_a_hidden_change_of_a_derived_fact_is_refused_before_anything_starts() -> None:
    with pytest.raises(InputError, match="facts of way follow from rules; they are neither set nor reported"):
        simulated_backend(doors(), Bindings(), changed(1.0, {("way", "k", "h"): True}))


# --- objects as values --------------------------------------------------------------------------

TRAYS = """
(define (domain trays) (:requirements :durative-actions :typing :numeric-fluents)
  (:types robot room thing - object)
  (:predicates (greeted ?r - robot))
  (:functions (battery))
  (:durative-action move :parameters (?r - robot ?a ?b - room) :duration (= ?duration 4) :condition () :effect ())
  (:durative-action fetch :parameters (?r - robot) :duration (= ?duration 3) :condition () :effect ())
  (:action greet :parameters (?r - robot) :precondition () :effect (greeted ?r)))
"""


def at(robot: str, room: str) -> Condition:
    return Compare("=", ValueOf(("place", robot)), Constant(room))


def put(fluent: Fluent, room: str) -> Set:
    return Set(fluent, Constant(room))


def trays() -> Domain:
    """Where a robot is, is a value: ``(place r1)``; on its way it is nowhere. It fetches things from where they are wanted."""
    domain = parse_domain(TRAYS)
    robot, room = Variable("?r", ("robot",)), ("room",)
    functions = {**domain.functions, "place": Declaration("place", (robot,), room), "wanted": Declaration("wanted", (robot,), room)}
    move = replace(
        domain.actions["move"],
        precondition=at("?r", "?a"),
        start_effects=(put(("place", "?r"), UNDEFINED),),
        end_effects=(put(("place", "?r"), "?b"),),
    )
    fetch = replace(
        domain.actions["fetch"],
        precondition=Not(Compare("=", ValueOf(("place", "?r")), ValueOf(("wanted", "?r")))),
        end_effects=(Set(("place", "?r"), ValueOf(("wanted", "?r"))),),
    )
    greet = replace(domain.actions["greet"], precondition=at("?r", "hall"))
    return replace(domain, functions=functions, actions={"move": move, "fetch": fetch, "greet": greet})


def tray_problem(init: dict[Fluent, Value], goal: Condition) -> Problem:
    things = "(:objects r1 r2 - robot hall lab yard - room cup - thing)"
    problem = parse_problem(f"(define (problem p) (:domain trays) {things} (:init) (:goal (and)))", trays())
    return replace(problem, init=init, goal=goal)


R1, R2 = ("place", "r1"), ("place", "r2")
IN_LAB = tray_problem({R1: "hall"}, at("r1", "lab"))
TO_LAB = timed("0 4 move r1 hall lab")


def test_objects_order_calls_like_facts() -> None:
    plan = timed("0 4 move r1 hall lab", "4.001 4 move r1 lab yard", "0 4 move r2 hall lab", "8.002 0 greet r1")
    graph = plan_graph(tray_problem({R1: "hall", R2: "hall"}, at("r1", "yard")), plan)
    assert shown(graph)[0] == "end of #0 < start of #1 ((place r1))"
    assert not any(2 in (one.before.call, one.after.call) for one in graph.orderings)


def test_a_robot_whose_place_is_a_value_arrives() -> None:
    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(IN_LAB, TO_LAB))
        assert result.goal, result.reason
        assert (simulation.truth(R1), simulation.knowledge.value(R1)) == ("lab", "lab")

    simulate(IN_LAB, scenario)


def test_on_the_way_it_is_nowhere() -> None:
    places: list[object] = []

    async def scenario(simulation: Simulation) -> None:
        asyncio.get_running_loop().call_later(2.0, lambda: places.append(simulation.knowledge.value(R1)))
        assert (await simulation.run(plan_graph(IN_LAB, TO_LAB))).goal

    simulate(IN_LAB, scenario)
    assert places == [UNDEFINED]


def test_a_robot_that_is_nowhere_is_not_where_it_is_wanted() -> None:
    problem = replace(IN_LAB, init={("wanted", "r1"): "lab"})

    async def scenario(simulation: Simulation) -> None:
        assert (await simulation.run(plan_graph(problem, timed("0 3 fetch r1")))).goal

    simulate(problem, scenario)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"place"})])
def test_an_object_that_does_not_come_is_missed_if_it_is_sensed(assumed: frozenset[str]) -> None:
    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(IN_LAB, TO_LAB))
        assert result.goal is bool(assumed)
        if not assumed:
            assert [(one.cause, one.expected) for one in result.failures] == [("effects_missing", "(= (place r1) lab)")]
        assert simulation.truth(R1) == "hall"

    simulate(IN_LAB, scenario, Faults((Fault("move", FaultKind.NO_EFFECT),)), Bindings(assumed=assumed))


def test_an_aborted_move_leaves_the_robot_where_it_was_known_to_be() -> None:
    async def scenario(simulation: Simulation) -> None:
        graph = plan_graph(IN_LAB, TO_LAB)
        result = await simulation.run(graph)
        assert [one.cause for one in result.failures] == ["aborted"]
        assert (simulation.truth(R1), simulation.knowledge.value(R1)) == ("hall", "hall")
        assert isinstance(simulation.decide(graph, result), ResumePlan)

    faults = Faults((Fault("move", FaultKind.ABORT),))
    simulate(IN_LAB, scenario, faults, Bindings({"move": Binding(retries=0)}, assumed=frozenset({"place"})))


def test_a_robot_that_was_carried_away_is_found_by_the_precondition() -> None:
    async def scenario(simulation: Simulation) -> None:
        simulation.backend.robots.world.change({R1: "yard"})
        graph = plan_graph(IN_LAB, TO_LAB)
        result = await simulation.run(graph)
        assert [(one.cause, one.observed) for one in result.failures] == [("precondition_false", "(place r1) is yard")]
        assert isinstance(simulation.decide(graph, result), PlanAgain)
        assert simulation.now().init[R1] == "yard"
        assert (await simulation.run(plan_graph(simulation.now(), timed("0 4 move r1 yard lab")))).goal

    simulate(IN_LAB, scenario)


def test_a_robot_that_is_there_does_not_move() -> None:
    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(IN_LAB, TO_LAB))
        assert result.goal
        assert [call.outcome for call in result.calls] == ["already true"]

    simulate(replace(IN_LAB, init={R1: "lab"}), scenario)


def test_a_value_read_at_the_end_is_the_one_it_has_then() -> None:
    problem = tray_problem({R1: "hall", ("wanted", "r1"): "lab"}, at("r1", "yard"))

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 3 fetch r1")))
        assert result.goal, result.reason

    simulate(problem, scenario, changed(1.0, {("wanted", "r1"): "yard"}))


def test_a_goal_field_may_be_an_object_that_is_known() -> None:
    bindings = Bindings({"fetch": Binding(goal={"robot": "?r", "to": "(wanted ?r)"})})
    wanted = tray_problem({R1: "hall", ("wanted", "r1"): "lab"}, at("r1", "lab"))

    async def scenario(simulation: Simulation) -> None:
        graph = plan_graph(wanted, timed("0 3 fetch r1"))
        data = goal_data(graph.calls[0].action, bindings.of("fetch"), ("robot", "to"), EvaluationContext(simulation.knowledge))
        assert data == ({"robot": "r1", "to": "lab"}, ())
        assert (await simulation.run(graph)).goal
        for nothing in (UNKNOWN, UNDEFINED):
            simulation.knowledge.world.update({("wanted", "r1"): nothing})
            assert goal_data(graph.calls[0].action, bindings.of("fetch"), None, EvaluationContext(simulation.knowledge))[1] == ("to",)

    simulate(wanted, scenario, bindings=bindings)


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


# --- decided at the start -----------------------------------------------------------------------

MOPS = """
(define (domain mops) (:requirements :durative-actions :conditional-effects)
  (:predicates (wet) (clean) (streaked) (seen) (ready))
  (:durative-action mop :parameters () :duration (= ?duration 5) :condition () :effect (at start (not (wet))))
  (:durative-action hose :parameters () :duration (= ?duration 2) :condition () :effect (at end (wet)))
  (:durative-action look :parameters () :duration (= ?duration 1) :condition () :effect (at end (seen))))
"""
MOP = parse_domain(MOPS)
MOP = replace(
    MOP,
    actions={
        **MOP.actions,
        "mop": replace(
            MOP.actions["mop"],
            end_effects=(
                When(Holds(("wet",)), (Set(("clean",), Constant(True)),), early=True),
                When(Holds(("wet",)), (Set(("streaked",), Constant(True)),)),
            ),
        ),
    },
)


def mops(init: str, goal: str) -> Problem:
    return parse_problem(f"(define (problem p) (:domain mops) (:init {init}) (:goal {goal}))", MOP)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"wet", "clean", "streaked"})])
@pytest.mark.parametrize("wet", [True, False])
def test_an_early_condition_is_decided_before_the_start_changes_it(wet: bool, assumed: frozenset[str]) -> None:
    problem = mops("(wet)" if wet else "", f"(and {'(clean)' if wet else '(not (clean))'} (not (streaked)))")
    graph = plan_graph(problem, timed("0 5 mop"))
    assert why_not(Progress.beginning(graph), initial_knowledge(problem)) == ""

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(graph)
        assert result.goal, result.reason
        for state in (simulation.truth, simulation.knowledge.value):
            assert (state(("clean",)) is True, state(("streaked",)) is True) == (wet, False)

    simulate(problem, scenario, bindings=Bindings(assumed=assumed))


def test_a_condition_that_is_not_early_is_decided_at_the_end() -> None:
    problem = mops("", "(and (streaked) (not (clean)))")
    plan = timed("0 5 mop", "1 2 hose")
    assert why_not(Progress.beginning(plan_graph(problem, plan)), initial_knowledge(problem)) == ""

    async def scenario(simulation: Simulation) -> None:
        assert (await simulation.run(plan_graph(problem, plan))).goal

    simulate(problem, scenario)


def test_an_effect_decided_at_the_start_is_missed_at_the_end() -> None:
    problem = mops("(wet)", "(clean)")

    async def scenario(simulation: Simulation) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 5 mop")))
        assert [(one.cause, one.expected) for one in result.failures] == [("effects_missing", "(not (wet)) (clean)")]

    simulate(problem, scenario, Faults((Fault("mop", FaultKind.NO_EFFECT),)), Bindings({"mop": Binding(retries=0)}))


def test_the_start_reads_an_early_condition_and_the_end_writes() -> None:
    schema = MOP.actions["mop"]
    early = replace(schema, start_effects=(), end_effects=schema.end_effects[:1])
    look = replace(MOP.actions["look"], precondition=Holds(("clean",)))
    domain = replace(MOP, actions={**MOP.actions, "mop": early, "look": look})
    problem = replace(mops("", "(seen)"), domain=domain)
    graph = plan_graph(problem, timed("0 2 hose", "2.001 5 mop", "7.002 1 look"))
    assert shown(graph) == ["end of #0 < start of #1 ((wet))", "end of #1 < start of #2 ((clean))"]
    later = plan_graph(problem, timed("0 5 mop", "1 2 hose"))
    assert "start of #0 < end of #1 ((wet))" in shown(later)
