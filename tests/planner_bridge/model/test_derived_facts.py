"""Derived facts mean the same in plans, runs and replanning."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import PlanAgain, Progress, why_not
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import Ordering, PlanGraph
from pnm.errors import InputError
from tests.support.runs.plan_graphs import any_order, shown
from tests.support.tasks.planned_runs import SimulatedSite, change_at, timed, with_site

DOMAIN = parse_domain("""
(define (domain doors) (:requirements :durative-actions :typing :adl :derived-predicates)
  (:types robot room door - object)
  (:predicates (at ?r - robot ?a - room) (joins ?d - door ?a ?b - room) (open ?d - door) (way ?a ?b - room) (shut-in ?r - robot))
  (:derived (way ?a ?b - room)
    (or (= ?a ?b) (exists (?c - room) (and (exists (?d - door) (and (joins ?d ?a ?c) (open ?d))) (way ?c ?b)))))
  (:derived (shut-in ?r - robot) (exists (?a - room) (and (at ?r ?a) (forall (?b - room) (or (= ?a ?b) (not (way ?a ?b)))))))
  (:durative-action go :parameters (?r - robot ?a ?b - room) :duration (= ?duration 4)
    :condition (and (at start (at ?r ?a)) (over all (way ?a ?b)))
    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))
  (:durative-action burst-through :parameters (?r - robot ?a ?b - room) :duration (= ?duration 4)
    :condition (at end (way ?a ?b)) :effect (and (at start (open d1)) (at end (not (open d1))) (at end (at ?r ?b))))
  (:durative-action open-door :parameters (?d - door) :duration (= ?duration 2) :condition () :effect (at end (open ?d)))
  (:durative-action close-door :parameters (?d - door) :duration (= ?duration 2) :condition () :effect (at start (not (open ?d))))
  (:durative-action ring :parameters (?r - robot) :duration (= ?duration 1) :condition (at start (shut-in ?r)) :effect ()))
""")


def doors(init: str = "(at r1 k)", goal: str = "(at r1 h)") -> Problem:
    """Kitchen, hall and garage: d1 leads from the kitchen to the hall, d2 to the garage, d3 from there to the hall."""
    joins = " ".join(f"(joins {door} {one} {other})" for door, one, other in DOORWAYS)
    things = "(:objects r1 r2 - robot k h g - room d1 d2 d3 - door)"
    return parse_problem(f"(define (problem p) (:domain doors) {things} (:init {joins} {init}) (:goal {goal}))", DOMAIN)


DOORWAYS = [(door, *pair) for door, pair in (("d1", "kh"), ("d2", "kg"), ("d3", "gh")) for pair in (pair, pair[::-1])]


def test_who_reads_a_derived_fact_waits_for_what_it_rests_on() -> None:
    graph = plan_graph(doors(), timed("0 2 open-door d1", "2.001 4 go r1 k h", "6.002 2 close-door d1"))
    assert sorted(shown(graph)) == [f"end of #{one} < start of #{other} ((open d1))" for one, other in ((0, 1), (0, 2), (1, 2))]
    assert graph.rules == DOMAIN.rules


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


def one_after_the_other(graph: PlanGraph, chooser: random.Random) -> PlanGraph:
    """The graph with all its events in one order that it allows."""
    pairs = pairwise(any_order(graph, chooser))
    return replace(graph, orderings=tuple(Ordering(*pair) for pair in pairs if pair[0].call != pair[1].call))


@given(st.sets(st.sampled_from(("d1", "d2", "d3"))), st.randoms(use_true_random=False))
def test_every_order_that_the_graph_allows_works(opened: set[str], chooser: random.Random) -> None:
    problem = doors(" ".join(("(at r1 k) (at r2 g)", *(f"(open {door})" for door in sorted(opened)))), goal="(and)")
    graph = plan_graph(problem, random_walk(problem, chooser))
    for _ in range(3):
        assert why_not(Progress.beginning(one_after_the_other(graph, chooser)), initial_knowledge(problem)) == ""


BOTH = timed("0 2 open-door d1", "2.001 4 go r1 k h")


def test_a_plan_with_derived_conditions_and_a_derived_goal_is_carried_out() -> None:
    problem = doors(goal="(and (at r1 h) (way g k) (not (shut-in r1)))", init="(at r1 k) (open d3)")

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, BOTH))
        assert result.goal, result.reason
        assert [(call.started, call.ended) for call in result.calls] == [(0.0, 2.0), (2.0, 6.0)]

    with_site(problem, scenario)


def test_a_derived_precondition_that_is_false_says_what_is_wanting() -> None:
    problem = doors("(at r1 k)")

    async def scenario(simulation: SimulatedSite) -> None:
        graph = plan_graph(problem, timed("0 4 go r1 k h"))
        result = await simulation.run(graph)
        assert [failure.cause for failure in result.failures] == ["precondition_false"]
        assert result.failures[0].expected == "(way k h)"
        assert result.failures[0].observed.startswith("(way k h) is false for want of (open d")
        decision = simulation.decide(graph, result)
        assert isinstance(decision, PlanAgain)
        assert decision.why.startswith("go(r1, k, h) would go on although (way k h) is false for want of (open d")

    with_site(problem, scenario)


def test_a_derived_over_all_condition_that_breaks_is_noticed_and_planned_around() -> None:
    """A door falls shut behind the robot's back: the way is gone, a new plan opens another."""
    problem = doors("(at r1 k) (open d1) (open d3)")

    async def scenario(simulation: SimulatedSite) -> None:
        graph = plan_graph(problem, timed("0 4 go r1 k h"))
        result = await simulation.run(graph)
        assert [failure.cause for failure in result.failures] == ["invariant_false"]
        assert result.failures[0].observed.startswith("(way k h) is false for want of (open d")
        assert result.calls[0].ended == pytest.approx(1.0)
        assert isinstance(simulation.decide(graph, result), PlanAgain)
        result = await simulation.run(plan_graph(simulation.now(), timed("0 2 open-door d2", "2.001 4 go r1 k h")))
        assert result.goal, result.reason
        assert simulation.truth(("at", "r1", "h")) is True

    with_site(problem, scenario, change_at(1.0, {("open", "d1"): False}))


def test_a_base_fact_that_breaks_does_no_harm_while_the_derived_one_holds() -> None:
    problem = doors("(at r1 k) (open d1) (open d2) (open d3)")

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert result.goal
        assert result.failures == ()

    with_site(problem, scenario, change_at(1.0, {("open", "d1"): False}))


def test_nobody_who_watches_the_doors_leaves_the_world_to_find_out() -> None:
    problem = doors("(at r1 k) (open d1)")
    bindings = Bindings({"go": Binding(retries=0)}, assumed=frozenset({"open"}))

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert [failure.cause for failure in result.failures] == ["aborted"]
        assert result.failures[0].observed.endswith("(way k h) was not true all the time")

    with_site(problem, scenario, change_at(1.0, {("open", "d1"): False}), bindings)


def test_a_late_report_about_what_is_below_a_derived_fact_is_waited_for() -> None:
    problem = doors("(at r1 k)")

    async def scenario(simulation: SimulatedSite) -> None:
        simulation.knowledge.world.sense({"open"}, lag=3.0)
        asyncio.get_running_loop().call_later(2.5, simulation.backend.robots.world.change, {("open", "d1"): True})
        result = await simulation.run(plan_graph(problem, timed("0 4 go r1 k h")))
        assert result.goal, result.reason
        assert result.calls[0].started == 2.5

    with_site(problem, scenario)


def test_what_an_action_changes_below_a_derived_fact_is_not_asked_of_it_before_or_after() -> None:
    """It opens the door that it needs to be open, and shuts it: neither can be seen before or after."""
    problem = doors("(at r1 k)")

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 4 burst-through r1 k h")))
        assert [call.outcome for call in result.calls] == ["succeeded"]

    with_site(problem, scenario)


def test_a_hidden_change_of_a_derived_fact_is_refused_before_anything_starts() -> None:
    with pytest.raises(InputError, match="facts of way follow from rules; they are neither set nor reported"):
        simulated_backend(doors(), Bindings(), change_at(1.0, {("way", "k", "h"): True}))
