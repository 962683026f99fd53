"""Simulated robots that fail, and the time from each failure to the begin of the next plan."""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from tests.support.runs.timing import FailureClock

SPEED = 50.0


_TOUR = """
(define (domain tour) (:requirements :typing :durative-actions) (:types robot place camera)
  (:predicates (at ?r - robot ?p - place) (linked ?a ?b - place) (inspected ?p - place))
  (:durative-action go :parameters (?r - robot ?a ?b - place) :duration (= ?duration 0.1)
    :condition (and (at start (at ?r ?a)) (over all (linked ?a ?b))) :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))
  (:durative-action inspect :parameters (?r - robot ?a - place ?c - camera) :duration (= ?duration 0.1)
    :condition (over all (at ?r ?a)) :effect (at end (inspected ?a))))
"""


def tour(calls: int) -> Problem:
    """A robot that goes from place to place and inspects each, with one of three cameras."""
    places = range(1, calls // 2 + 1)
    text = f"(define (problem p) (:domain tour) (:objects r - robot p0 {' '.join(f'p{one}' for one in places)} - place c1 c2 c3 - camera) "
    text += f"(:init (at r p0) {' '.join(f'(linked p{one - 1} p{one}) (linked p{one} p{one - 1})' for one in places)}) "
    text += f"(:goal (and {' '.join(f'(inspected p{one})' for one in places)})))"
    return parse_problem(text, parse_domain(_TOUR))


def faults(seed: int) -> Faults:
    """Two cameras are broken, so that nearly all of a tour is planned anew, twice."""
    return Faults((Fault("inspect", FaultKind.ABORT, times=2),), seed=seed)


def measured(problem: Problem, seeds: range) -> list[tuple[float, float]]:
    """Pursue the goal once for every seed; for every failure the seconds until a request follows, and those of the planner in them."""
    found: list[tuple[float, float]] = []
    for seed in seeds:
        clock, backend = FailureClock(), SimulatedBackend(robots_of(problem, Bindings(), faults(seed), speed=SPEED))
        limits = Limits(replans=30, seconds=60.0, forbid_after=1, backoff=0.0)
        settings = Settings(improve=0.0, limits=limits, on_failure=OnFailure.CONTINUE_OTHERS, on_change=OnChange.EAGER)
        run_async(achieve_at(backend, problem, settings, clock), virtual=False)
        found += clock.found
    return found
