"""Small domains and problems in PDDL to which tests add what they are about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from pnm.core.logic.domain import ActionSchema


@dataclass(frozen=True)
class Texts:
    """A domain and a problem in one line each and without their last parenthesis, so that what a test adds stands in line 2.

    If `strict`, what is added may cause no warnings, and is read again as an equal model after it was written.
    """

    domain: str
    problem: str = "(define (problem p) (:domain d) (:objects r2 - robot kitchen - room)"
    strict: bool = False
    parameters: str = ""
    """Of the actions that tests write."""
    duration: str = ""

    def domain_with(self, text: str) -> Domain:
        """Read the domain with an addition."""
        domain = parse_domain(f"{self.domain}\n{text})")
        if self.strict:
            assert domain.warnings == ()
            assert parse_domain(write_domain(domain)) == domain
        return domain

    def action(self, parts: str) -> ActionSchema:
        """Read an action with these parts."""
        return self.domain_with(f"(:action a {self.parameters}{parts})").actions["a"]

    def durative(self, parts: str) -> ActionSchema:
        """Read a durative action with these parts."""
        return self.domain_with(f"(:durative-action a {self.parameters}{self.duration}{parts})").actions["a"]

    def problem_with(self, text: str, domain: str = "") -> Problem:
        """Read the problem with an addition, to a domain that may have one as well."""
        problem = parse_problem(f"{self.problem}\n{text})", self.domain_with(domain))
        if self.strict:
            assert problem.warnings == ()
            assert parse_problem(write_problem(problem), problem.domain) == problem
        return problem


_DECLARED: Final = (
    "(:types robot room - thing) (:constants hall - room)"
    " (:predicates (at{} ?r - robot ?l - room) (idle)) (:functions (charge ?r - robot) (total-cost))"
)
SMALL: Final = Texts(f"(define (domain d) {_DECLARED.format('')}")
DECLARING: Final = Texts(f"(define (domain d) (:requirements :typing :action-costs :negative-preconditions) {_DECLARED.format('-room')}")
"""The same with the requirements it needs, so that it causes no warnings."""
EXTENDED: Final = Texts(
    "(define (domain d)"
    " (:requirements :adl :fluents :durative-actions :duration-inequalities :derived-predicates :preferences :constraints"
    " :timed-initial-literals :hierarchy)"
    " (:types robot room - thing closet - room) (:constants hall - room)"
    " (:predicates (at ?r - robot ?l - room) (dirty ?l - room) (linked ?a ?b - room) (near ?a ?b - room) (idle) (busy))"
    " (:functions (charge ?r - robot) (area ?l - room) (total-cost) - number"
    " (home ?r - robot) (place ?r - robot) - room (owner ?l - room) - robot)",
    strict=True,
    parameters=":parameters (?r - robot ?l - room) ",
    duration=":duration () ",
)
"""More of everything, for what PDDL has beyond facts and numbers."""


def warnings(model: Domain | Problem) -> list[str]:
    """Return the warnings of what was read, from the line on."""
    return [str(one).partition(".pddl:")[2] for one in model.warnings]
