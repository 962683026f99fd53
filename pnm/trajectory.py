"""What must be so over a whole course of states, not only at its end (PDDL 3.0, state-trajectory constraints)."""

from __future__ import annotations

from dataclasses import dataclass

from pnm.conditions import Condition
from pnm.expressions import Variable


@dataclass(frozen=True, slots=True)
class Constraint:
    """One constraint, for every choice of objects for its variables."""

    operator: str
    """``always``, ``sometime``, ``at-most-once``, ``sometime-after``, ``sometime-before``, ``within``,
    ``always-within``, ``hold-during``, ``hold-after`` or ``at end``."""
    conditions: tuple[Condition, ...]
    """In the order in which PDDL writes them: one, or two for ``sometime-after``, ``sometime-before`` and ``always-within``."""
    times: tuple[float, ...] = ()
    """Seconds from the start, in the order in which PDDL writes them."""
    variables: tuple[Variable, ...] = ()
    """Of the quantifiers around it, outermost first."""
