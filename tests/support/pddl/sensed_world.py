"""A small world of robots, for tests of what their sensors report."""

from __future__ import annotations

from planner_bridge.pddl import parse_domain, parse_problem

DOMAIN = parse_domain(
    """(define (domain d) (:requirements :adl :fluents :derived-predicates)
    (:types robot place - object arm - robot)
    (:predicates (charged ?r - robot) (at ?r - robot ?p - place) (ready ?r - robot) (dark))
    (:functions (battery ?r - robot) - number (location ?r - robot) - place)
    (:derived (ready ?r - robot) (charged ?r))
    (:action wait :parameters (?r - robot)))"""
)


PROBLEM = parse_problem("(define (problem p) (:domain d) (:objects r1 r-2 - robot a1 - arm kitchen hall - place) (:goal (dark)))", DOMAIN)


KNOWN = PROBLEM.vocabulary
