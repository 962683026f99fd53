"""Derived facts: rules say when they hold; nobody writes them (PDDL 2.2, derived predicates)."""

from __future__ import annotations

from dataclasses import dataclass

from pnm.conditions import Condition
from pnm.expressions import Variable


@dataclass(frozen=True, slots=True)
class Rule:
    """The facts of this name hold for every choice of objects for which the condition does.

    Several rules may derive facts of one name: one that holds is enough.
    """

    name: str
    variables: tuple[Variable, ...]
    condition: Condition
