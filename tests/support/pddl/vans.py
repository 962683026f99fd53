"""Vans that drive between places and serve them: a world in which actions have durations."""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem

VANS = """
(define (domain vans)
  (:requirements :typing :durative-actions :numeric-fluents)
  (:types van place)
  (:predicates (at ?v - van ?p - place) (way ?from ?to - place) (served ?p - place))
  (:functions (seconds ?from ?to - place))
  (:durative-action drive :parameters (?v - van ?from ?to - place) :duration (= ?duration (seconds ?from ?to))
    :condition (and (at start (at ?v ?from)) (at start (way ?from ?to)))
    :effect (and (at start (not (at ?v ?from))) (at end (at ?v ?to))))
  (:durative-action serve :parameters (?v - van ?p - place) :duration (= ?duration 5)
    :condition (over all (at ?v ?p))
    :effect (at end (served ?p))))
"""


def vans(at: str, *ways: str, goal: str = "(and)") -> Problem:
    """Vans at places; a way is `from to seconds`, in both directions."""
    facts, names = [], {part for text in (at, *ways) for part in text.split() if part.isalpha()}
    for way in ways:
        a, b, seconds = way.split()
        facts += [f"(way {x} {y}) (= (seconds {x} {y}) {seconds})" for x, y in ((a, b), (b, a))]
    where = dict(zip(at.split()[::2], at.split()[1::2], strict=True))
    facts += [f"(at {van} {place})" for van, place in where.items()]
    things = f"{' '.join(where)} - van {' '.join(sorted(names))} - place"
    return parse_problem(
        f"(define (problem p) (:domain vans) (:objects {things}) (:init {' '.join(facts)}) (:goal {goal}))", parse_domain(VANS)
    )
