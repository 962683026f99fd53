"""A scenario: a world, what is wanted there, what goes wrong with robots, and when the processes are killed that care for it."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final
from uuid import UUID

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.logic.conditions import Condition
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Wanted
from tests.support.pddl.problems import fleet_texts, read_goal
from tests.support.tasks.kills.instants import Instant, random_instant

ROBOTS: Final = 3
PLACES: Final = 7
TEXTS: Final = fleet_texts(ROBOTS, ROBOTS, PLACES, counts=True)
"""A domain and a problem of robots and parcels; whatever is done twice, or noted twice, is counted twice."""


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
        domain, problem = TEXTS
        return parse_problem(problem, parse_domain(domain))

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
