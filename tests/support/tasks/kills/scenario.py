"""A scenario: a world, what is wanted there, what goes wrong with robots, and when the processes are killed that care for it."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final
from uuid import UUID

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.logic.conditions import Condition
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Wanted
from tests.support.pddl.problems import read_goal
from tests.support.tasks.kills.instants import Instant, random_instant

ROBOTS: Final = 3
PLACES: Final = 7
COURIERS: Final = """
(define (domain couriers)
  (:requirements :typing :numeric-fluents)
  (:types robot parcel room - object)
  (:predicates (at ?r - robot ?a - room) (way ?a ?b - room) (in ?p - parcel ?a - room) (has ?r - robot ?p - parcel) (free ?r - robot))
  (:functions (moves ?r - robot) (picks ?p - parcel))
  (:action move :parameters (?r - robot ?a ?b - room)
    :precondition (and (at ?r ?a) (way ?a ?b))
    :effect (and (not (at ?r ?a)) (at ?r ?b) (increase (moves ?r) 1)))
  (:action pick :parameters (?r - robot ?p - parcel ?a - room)
    :precondition (and (at ?r ?a) (in ?p ?a) (free ?r))
    :effect (and (not (in ?p ?a)) (has ?r ?p) (not (free ?r)) (increase (picks ?p) 1)))
  (:action drop :parameters (?r - robot ?p - parcel ?a - room)
    :precondition (and (at ?r ?a) (has ?r ?p))
    :effect (and (in ?p ?a) (not (has ?r ?p)) (free ?r))))
"""
"""Robots and parcels; whatever is done twice, or noted twice, is counted twice."""


@dataclass(frozen=True)
class Scenario:
    """What happens.

    Args:
        tasks: what is wanted.
        deaths: when the processes die, one after the other; the one after them does not.
        faults: what goes wrong with the robots.
    """

    tasks: tuple[Wanted, ...]
    deaths: tuple[Instant, ...]
    faults: Faults = NO_FAULTS
    settings: Settings = field(
        default_factory=lambda: Settings(improve=0.0, bindings=_BINDINGS, limits=Limits(forbid_after=3, backoff=0.0, replans=20))
    )

    @cached_property
    def problem(self) -> Problem:
        """The world, and what its goals may speak of."""
        return parse_problem(problem_text("(and)"), _DOMAIN)

    def read_goal(self, text: str) -> Condition:
        """Return the goal of a text."""
        return read_goal(self.problem, text)


def random_scenario(number: int) -> Scenario:
    """Draw the scenario of this number."""
    rng = random.Random(number)
    parcels = rng.sample(range(ROBOTS), rng.randrange(2, ROBOTS + 1))
    tasks = tuple(
        Wanted(UUID(int=position + 1), f"(in p{parcel} a{rng.randrange(PLACES)})", rng.choice([0, 0, 1]))
        for position, parcel in enumerate(parcels)
    )
    names = ("move", "pick", "drop")
    kinds = (FaultKind.ABORT, FaultKind.REJECT, FaultKind.SLOW)
    faults = [Fault(rng.choice(names), rng.choice(kinds), after=rng.randrange(6), times=1) for _ in range(rng.choice([0, 0, 1, 2]))]
    return Scenario(tasks, tuple(random_instant(rng) for _ in range(30)), Faults(tuple(faults)))


_BINDINGS: Final = Bindings({name: Binding(resources=("{r}",), retries=1) for name in ("move", "pick", "drop")})
_DOMAIN: Final[Domain] = parse_domain(COURIERS)


def problem_text(goal: str) -> str:
    """Return the problem with this goal: rooms in a ring, a robot and a parcel in each of the first."""
    ring = [f"(way a{n} a{m})" for n in range(PLACES) for m in ((n + 1) % PLACES, (n - 1) % PLACES)]
    init = [f"(at r{n} a{n}) (free r{n}) (in p{n} a{n}) (= (moves r{n}) 0) (= (picks p{n}) 0)" for n in range(ROBOTS)]
    things = " ".join(f"{letter}{n} - {kind}" for letter, kind in (("r", "robot"), ("p", "parcel")) for n in range(ROBOTS))
    rooms = " ".join(f"a{n}" for n in range(PLACES))
    return f"(define (problem p) (:domain couriers) (:objects {things} {rooms} - room) (:init {' '.join(init + ring)}) (:goal {goal}))"
