"""A tiny PDDL world for tests: robots on a ring of rooms with a door, and a lamp that needs holding."""

from __future__ import annotations

from planner_bridge.model import Problem
from planner_bridge.pddl import parse_domain, parse_problem

ROOMS = """
(define (domain rooms)
  (:requirements :strips :typing :negative-preconditions)
  (:types robot room - object)
  (:predicates (at ?r - robot ?a - room) (way ?a ?b - room) (clean ?a - room))
  (:functions (total-cost) (energy ?r - robot))
  (:action move :parameters (?r - robot ?a ?b - room)
    :precondition (and (at ?r ?a) (way ?a ?b))
    :effect (and (not (at ?r ?a)) (at ?r ?b) (increase (total-cost) 1)))
  (:action sweep :parameters (?r - robot ?a - room)
    :precondition (and (at ?r ?a) (not (clean ?a)))
    :effect (clean ?a)))
"""

MATCHES = """
(define (domain matches)
  (:requirements :durative-actions :typing)
  (:types match fuse - object)
  (:predicates (light ?m - match) (free) (unused ?m - match) (mended ?f - fuse))
  (:durative-action strike :parameters (?m - match) :duration (= ?duration 8)
    :condition (and (at start (unused ?m)) (over all (light ?m)))
    :effect (and (at start (not (unused ?m))) (at start (light ?m)) (at end (not (light ?m)))))
  (:durative-action mend :parameters (?f - fuse ?m - match) :duration (= ?duration 5)
    :condition (and (at start (free)) (over all (light ?m)))
    :effect (and (at start (not (free))) (at end (mended ?f)) (at end (free)))))
"""


def rooms(init: str = "(at r1 a) (at r2 a)", goal: str = "(and (at r1 c) (at r2 c))", ways: str = "ab bc ad dc") -> Problem:
    """Rooms a, b, c, d; by default two ways from a to c, over b and over d."""
    links = " ".join(f"(way {way[0]} {way[1]})" for way in ways.split())
    things = "(:objects r1 r2 - robot a b c d - room)"
    text = f"(define (problem p) (:domain rooms) {things} (:init {init} {links} (= (total-cost) 0)) (:goal {goal}))"
    return parse_problem(text, parse_domain(ROOMS))


def matches(fuses: int = 2) -> Problem:
    """As many matches as fuses; a fuse is mended while a match burns."""
    things = " ".join(f"m{n}" for n in range(fuses)) + " - match " + " ".join(f"f{n}" for n in range(fuses)) + " - fuse"
    init = "(free) " + " ".join(f"(unused m{n})" for n in range(fuses))
    goal = " ".join(f"(mended f{n})" for n in range(fuses))
    return parse_problem(
        f"(define (problem p) (:domain matches) (:objects {things}) (:init {init}) (:goal (and {goal})))", parse_domain(MATCHES)
    )
