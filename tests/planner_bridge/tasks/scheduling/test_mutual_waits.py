"""Tasks that might wait for each other: what makes way for one comes to nothing meanwhile."""

from __future__ import annotations

from dataclasses import replace

from planner_bridge.pddl import parse_domain, parse_problem
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Code
from tests.support.tasks.node import EAGER, SlowPerson, simulated
from tests.support.tasks.simulation import TaskSimulation

KITCHEN = """
(define (domain kitchen)
  (:requirements :durative-actions)
  (:predicates (cold) (warm) (baked) (served))
  (:durative-action heat :parameters () :duration (= ?duration 8)
    :condition (and (at start (cold)) (over all (warm)))
    :effect (and (at start (not (cold))) (at start (warm)) (at end (not (warm)))))
  (:durative-action bake :parameters () :duration (= ?duration 5) :condition (over all (warm)) :effect (at end (baked)))
  (:durative-action serve :parameters () :duration (= ?duration 1) :condition (at start (cold)) :effect (at end (served))))
"""
PROBLEM = parse_problem("(define (problem p) (:domain kitchen) (:init (cold)) (:goal (and)))", parse_domain(KITCHEN))
ASKED_BEFORE = replace(EAGER, bindings=Bindings({"bake": Binding(ask={"word": "May I?"}, goal={"word": "$word"})}))


@simulated(PROBLEM, chosen=ASKED_BEFORE, source=SlowPerson())
async def test_nobody_waits_for_a_call_that_is_over_and_only_waits_for_another_one_of_a_task_that_makes_way(simulation: TaskSimulation):
    low = await simulation.begun("(baked)")
    await simulation.sees(low, "ended", "heat")  # whose end counts once what needs it warm has been baked, and that waits for an answer
    high = simulation.want("(served)", priority=1)  # there would be a plan if heating could still be undone
    assert await simulation.ended_with(high, low) == [Code.NO_PLAN, Code.CONDITION_LOST]
