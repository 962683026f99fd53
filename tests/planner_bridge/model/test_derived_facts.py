"""Derived facts, and conditions of effects that are decided at the start, mean the same in plans, runs and replanning."""

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
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import Ordering, PlanGraph
from pnm.errors import InputError
from tests.support.runs.plan_graphs import any_order, shown
from tests.support.tasks.planned_runs import SimulatedSite, change_at, on_site, timed

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


@on_site(doors(goal="(and (at r1 h) (way g k) (not (shut-in r1)))", init="(at r1 k) (open d3)"))
async def test_a_plan_with_derived_conditions_and_a_derived_goal_is_carried_out(site: SimulatedSite) -> None:
    result = await site.carry_out("0 2 open-door d1", "2.001 4 go r1 k h")
    assert result.goal, result.reason
    assert [(call.started, call.ended) for call in result.calls] == [(0.0, 2.0), (2.0, 6.0)]


@on_site(doors("(at r1 k)"))
async def test_a_derived_precondition_that_is_false_says_what_is_wanting(site: SimulatedSite) -> None:
    graph = plan_graph(site.problem, timed("0 4 go r1 k h"))
    result = await site.run(graph)
    (failure,) = result.failures
    assert (failure.cause, failure.expected) == ("precondition_false", "(way k h)")
    assert failure.observed.startswith("(way k h) is false for want of (open d")
    decision = site.decide(graph, result)
    assert isinstance(decision, PlanAgain)
    assert decision.why.startswith("go(r1, k, h) would go on although (way k h) is false for want of (open d")


D1_SHUTS = change_at(1.0, {("open", "d1"): False})


@on_site(doors("(at r1 k) (open d1) (open d3)"), D1_SHUTS)
async def test_a_derived_over_all_condition_that_breaks_is_noticed_and_planned_around(site: SimulatedSite) -> None:
    """A door falls shut behind the robot's back: the way is gone, a new plan opens another."""
    graph = plan_graph(site.problem, timed("0 4 go r1 k h"))
    result = await site.run(graph)
    (failure,) = result.failures
    assert failure.cause == "invariant_false"
    assert failure.observed.startswith("(way k h) is false for want of (open d")
    assert result.calls[0].ended == pytest.approx(1.0)
    assert isinstance(site.decide(graph, result), PlanAgain)
    result = await site.run(plan_graph(site.now(), timed("0 2 open-door d2", "2.001 4 go r1 k h")))
    assert result.goal, result.reason
    assert site.truth(("at", "r1", "h")) is True


@on_site(doors("(at r1 k) (open d1) (open d2) (open d3)"), D1_SHUTS)
async def test_a_base_fact_that_breaks_does_no_harm_while_the_derived_one_holds(site: SimulatedSite) -> None:
    result = await site.carry_out("0 4 go r1 k h")
    assert (result.goal, result.failures) == (True, ())


@on_site(doors("(at r1 k) (open d1)"), D1_SHUTS, Bindings({"go": Binding(retries=0)}, assumed=frozenset({"open"})))
async def test_nobody_who_watches_the_doors_leaves_the_world_to_find_out(site: SimulatedSite) -> None:
    (failure,) = (await site.carry_out("0 4 go r1 k h")).failures
    assert failure.cause == "aborted"
    assert failure.observed.endswith("(way k h) was not true all the time")


@on_site(doors("(at r1 k)"))
async def test_a_late_report_about_what_is_below_a_derived_fact_is_waited_for(site: SimulatedSite) -> None:
    site.knowledge.world.sense({"open"}, lag=3.0)
    asyncio.get_running_loop().call_later(2.5, site.backend.robots.world.change, {("open", "d1"): True})
    result = await site.carry_out("0 4 go r1 k h")
    assert result.goal, result.reason
    assert result.calls[0].started == 2.5


@on_site(doors("(at r1 k)"))
async def test_what_an_action_changes_below_a_derived_fact_is_not_asked_of_it_before_or_after(site: SimulatedSite) -> None:
    """It opens the door that it needs to be open, and shuts it: neither can be seen before or after."""
    result = await site.carry_out("0 4 burst-through r1 k h")
    assert [call.outcome for call in result.calls] == ["succeeded"]


def test_a_hidden_change_of_a_derived_fact_is_refused_before_anything_starts() -> None:
    with pytest.raises(InputError, match="facts of way follow from rules; they are neither set nor reported"):
        simulated_backend(doors(), Bindings(), change_at(1.0, {("way", "k", "h"): True}))


# --- decided at the start ---

MOPS = parse_domain("""
(define (domain mops) (:requirements :durative-actions :conditional-effects)
  (:predicates (wet) (clean) (streaked) (seen))
  (:durative-action mop :parameters () :duration (= ?duration 5) :condition ()
    :effect (and (at start (not (wet))) (when (at start (wet)) (at end (clean))) (at end (when (wet) (streaked)))))
  (:durative-action wipe :parameters () :duration (= ?duration 5) :condition () :effect (when (at start (wet)) (at end (clean))))
  (:durative-action hose :parameters () :duration (= ?duration 2) :condition () :effect (at end (wet)))
  (:durative-action look :parameters () :duration (= ?duration 1) :condition (at start (clean)) :effect (at end (seen))))
""")


def mops(init: str, goal: str) -> Problem:
    return parse_problem(f"(define (problem p) (:domain mops) (:init {init}) (:goal {goal}))", MOPS)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"wet", "clean", "streaked"})])
@pytest.mark.parametrize("wet", [True, False])
def test_an_early_condition_is_decided_before_the_start_changes_it(wet: bool, assumed: frozenset[str]) -> None:
    problem = mops("(wet)" if wet else "", f"(and {'(clean)' if wet else '(not (clean))'} (not (streaked)))")
    graph = plan_graph(problem, timed("0 5 mop"))
    assert why_not(Progress.beginning(graph), initial_knowledge(problem)) == ""

    @on_site(problem, bindings=Bindings(assumed=assumed))
    async def scenario(site: SimulatedSite) -> None:
        result = await site.run(graph)
        assert result.goal, result.reason
        for state in (site.truth, site.knowledge.value):
            assert (state(("clean",)) is True, state(("streaked",)) is True) == (wet, False)

    scenario()


@on_site(mops("", "(and (streaked) (not (clean)))"))
async def test_a_condition_that_is_not_early_is_decided_at_the_end(site: SimulatedSite) -> None:
    graph = plan_graph(site.problem, timed("0 5 mop", "1 2 hose"))
    assert why_not(Progress.beginning(graph), initial_knowledge(site.problem)) == ""
    assert (await site.run(graph)).goal


@on_site(mops("(wet)", "(clean)"), Faults((Fault("mop", FaultKind.NO_EFFECT),)), Bindings({"mop": Binding(retries=0)}))
async def test_an_effect_decided_at_the_start_is_missed_at_the_end(site: SimulatedSite) -> None:
    result = await site.carry_out("0 5 mop")
    assert [(one.cause, one.expected) for one in result.failures] == [("effects_missing", "(not (wet)) (clean)")]


def test_the_start_reads_an_early_condition_and_the_end_writes() -> None:
    problem = mops("", "(seen)")
    graph = plan_graph(problem, timed("0 2 hose", "2.001 5 wipe", "7.002 1 look"))
    assert shown(graph) == ["end of #0 < start of #1 ((wet))", "end of #1 < start of #2 ((clean))"]
    later = plan_graph(problem, timed("0 5 wipe", "1 2 hose"))
    assert "start of #0 < end of #1 ((wet))" in shown(later)
