"""An answer to the question why: a tree of statements, each with how it is known and the reasons for it.

What is proved may carry a claim: what another planner, or a validator, can check on its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from textwrap import indent
from typing import Any, TypeAlias

from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem


class Known(Enum):
    """The source of a statement."""

    GIVEN = "given"
    """It stands in the domain, in the problem, or in what is known of the world."""
    PLAN = "proved by a plan"
    """A plan shows it, which both validators accept."""
    SIMULATION = "proved by simulation"
    """The plan was simulated, with and without what it is about."""
    RELAXATION = "proved by reachability"
    """Not even if nothing were ever undone, in no order of actions."""
    SEARCH = "proved by search"
    """A planner has searched all states."""
    JOURNAL = "observed"
    """The journal says so."""
    NOT_PROVED = "not proved"

    @property
    def is_certain(self) -> bool:
        """Whether it is given, observed or proved."""
        return self is not Known.NOT_PROVED


@dataclass(frozen=True)
class _AboutPlan:
    problem: Problem
    plan: Plan


class Solves(_AboutPlan):
    """The claim that a plan solves a problem."""


class Fails(_AboutPlan):
    """The claim that a plan does not solve a problem."""


class Best(_AboutPlan):
    """The claim that no plan solves a problem better than this one."""


@dataclass(frozen=True, slots=True)
class Unsolvable:
    """The claim that no plan solves a problem."""

    problem: Problem


@dataclass(frozen=True, slots=True)
class NoSmallerChange:
    """The claim that no plan solves a problem after a change of fewer facts than so many, those of the goal left as they are."""

    problem: Problem
    facts: int


Claim: TypeAlias = Solves | Fails | Unsolvable | Best | NoSmallerChange


@dataclass(frozen=True, slots=True)
class Answer:
    """A statement, how it is known, the reasons for it, and claims that others can check."""

    statement: str
    known: Known
    reasons: tuple[Answer, ...] = ()
    claims: tuple[Claim, ...] = ()

    def every(self) -> Iterator[Answer]:
        """Yield the answer and all its reasons, outer ones first."""
        yield self
        for reason in self.reasons:
            yield from reason.every()

    def as_json(self) -> dict[str, Any]:
        """Return the tree as JSON has it."""
        return {
            "statement": self.statement,
            "known": self.known.value,
            "certain": self.known.is_certain,
            "reasons": [reason.as_json() for reason in self.reasons],
        }

    def __str__(self) -> str:
        return "\n".join((f"{self.statement} [{self.known.value}]", *(indent(str(reason), "  ") for reason in self.reasons)))
