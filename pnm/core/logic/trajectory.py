"""Constraints on a whole trajectory of states, not only on its end (PDDL 3.0, state-trajectory constraints).

A constraint is *progressed* through the states of a trajectory: a constraint and a state
yield the constraints that the rest of the trajectory, this state included, must keep. So what is left
of it is always constraints, too, and can be handed to a planner. A violated constraint leaves
`IMPOSSIBLE`; a fulfilled one leaves nothing.

The meaning is that of A. Gerevini and D. Long, *Plan Constraints and Preferences in PDDL3* (2005).
A state is in force until the next one: ``hold-during`` and ``hold-after`` speak of the states that
are in force at some moment of their time, and so are looked at when that begins (`moments`).
Unknown neither fulfils nor violates. But when it is too late, because a deadline has passed or what
had to come later has come, then what is not known to have come true has not come true in time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf
from typing import Final

from pnm.core.logic.conditions import TOLERANCE, Any, Condition, Not, Witness, conjuncts, evaluate, ground, names, observed, unmet
from pnm.core.logic.expressions import NOTHING, Environment, State, Variable, choices


@dataclass(frozen=True, slots=True)
class Constraint:
    """One constraint, for every choice of objects for its variables."""

    operator: str
    """``always``, ``sometime``, ``at-most-once``, ``sometime-after``, ``sometime-before``, ``within``,
    ``always-within``, ``hold-during``, ``hold-after`` or ``at end``."""
    conditions: tuple[Condition, ...]
    """In the order in which PDDL writes them: one, or two for ``sometime-after``, ``sometime-before`` and ``always-within``."""
    times: tuple[float, ...] = ()
    """Seconds from the start, in the order in which PDDL writes them; of ``always-within``, seconds it may take."""
    variables: tuple[Variable, ...] = ()
    """Of the quantifiers around it, outermost first."""
    begun: bool = False
    """Of ``at-most-once``: the one time has begun before; it may go on but not begin again."""

    def __str__(self) -> str:
        text = f"({' '.join((self.operator, *(f'{time:.12g}' for time in self.times), *map(str, self.conditions)))})"
        return f"(forall ({' '.join(map(str, self.variables))}) {text})" if self.variables else text


IMPOSSIBLE: Final = Constraint("always", (Any(),))
"""The rest of a violated constraint: no trajectory keeps it."""


def instances(constraint: Constraint, state: State, env: Environment = NOTHING) -> tuple[Constraint, ...]:
    """Return the ground constraints: one for every choice of objects for the variables."""
    return tuple(
        replace(constraint, conditions=tuple(ground(condition, chosen) for condition in constraint.conditions), variables=())
        for chosen in choices(constraint.variables, state, env)
    )


# --- progression ---------------------------------------------------------------------------


def progressed(constraints: Iterable[Constraint], state: State, now: float = 0.0) -> tuple[Constraint, ...]:
    """Progress ground constraints through a state: return the constraints on the rest of the trajectory.

    The constraints are on the trajectory from its previous state on. The state begins `now`, later than that one; in seconds
    from the start of the whole trajectory.
    """
    left = [rest for constraint in constraints for rest in _progressed(constraint, state, now)]
    if IMPOSSIBLE in left:
        return (IMPOSSIBLE,)
    if len(left) < 2:
        return tuple(left)
    merged: dict[object, Constraint] = {}
    for rest in left:  # of several deadlines for the same condition, the earliest includes the others
        key = rest.conditions if rest.operator == "within" else rest
        if key not in merged or rest.times < merged[key].times:
            merged[key] = rest
    return tuple(merged.values())


def _progressed(constraint: Constraint, state: State, now: float) -> tuple[Constraint, ...]:
    truths = [evaluate(condition, state) for condition in constraint.conditions]
    match constraint.operator, truths, constraint.times:
        case "at end", [_], ():
            return (constraint,)
        case "always", [wanted], ():
            return (IMPOSSIBLE,) if wanted is False else (constraint,)
        case "sometime", [wanted], ():
            return () if wanted is True else (constraint,)
        case "within", [wanted], (limit,):
            if wanted is True and now <= limit + TOLERANCE:
                return ()
            return (constraint,) if now < limit - TOLERANCE else (IMPOSSIBLE,)
        case "at-most-once", [True], ():
            return (constraint if constraint.begun else replace(constraint, begun=True),)
        case "at-most-once", [wanted], ():
            over = constraint.begun and wanted is False
            return (Constraint("always", (Not(constraint.conditions[0]),)),) if over else (constraint,)
        case "sometime-after", [trigger, wanted], ():
            owed = trigger is True and wanted is not True
            return (constraint, Constraint("sometime", constraint.conditions[1:])) if owed else (constraint,)
        case "sometime-before", [later, earlier], ():
            if later is True:  # earlier is not early enough now
                return (IMPOSSIBLE,)
            return () if earlier is True else (constraint,)
        case "always-within", [trigger, wanted], (delay,):
            owed = trigger is True and wanted is not True
            deadline = Constraint("within", constraint.conditions[1:], (now + delay,))
            return (constraint, *_progressed(deadline, state, now)) if owed else (constraint,)
        case "hold-during", [wanted], (begin, end):
            if now >= end - TOLERANCE:
                return ()
            return (IMPOSSIBLE,) if now >= begin - TOLERANCE and wanted is False else (constraint,)
        case "hold-after", [wanted], (begin,):
            return (IMPOSSIBLE,) if now >= begin - TOLERANCE and wanted is False else (constraint,)
        case _:
            raise ValueError(f"not a ground constraint of PDDL 3.0: {constraint}")


def moments(constraint: Constraint) -> tuple[float, ...]:
    """Return the times at which the constraint must be progressed with the state then in force, even if no new one begins."""
    return constraint.times[:1] if constraint.operator in ("within", "hold-during", "hold-after") else ()


def is_fulfilled(constraints: Iterable[Constraint], state: State, now: float = 0.0) -> bool:
    """Return whether ground constraints are kept by a trajectory that ends with this state."""
    for left in progressed(constraints, state, now):
        owed = left == IMPOSSIBLE or left.operator in ("sometime", "within")
        if owed or (left.operator == "at end" and evaluate(left.conditions[0], state) is not True):
            return False
    return True


def shifted(constraint: Constraint, elapsed: float) -> Constraint:
    """Return the constraint with its times counted from `elapsed` seconds after the start of the whole trajectory."""
    if constraint.operator == "always-within":
        return constraint
    if constraint.operator == "hold-after" and constraint.times[0] <= elapsed + TOLERANCE:
        return Constraint("always", constraint.conditions, (), constraint.variables)
    return replace(constraint, times=tuple(max(0.0, time - elapsed) for time in constraint.times))


# --- watching ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ConstraintProgress:
    """The rest of a ground constraint while a trajectory is being observed.

    The changes of one moment may be reported in pieces and late. A fulfilment counts
    as soon as it is seen. A violation, or a condition that is forbidden from now on, counts only if it
    still looks so after the lag of the reports; facts that become known until then are taken to have held
    all the time.
    """

    rest: tuple[Constraint, ...]
    doubtful_since: float | None = None
    """The time since which `rest` looks violated, or a condition is forbidden."""

    def seen(self, state: State, now: float, lag: float) -> ConstraintProgress:
        """Return the progress after a look at the state, with reports that may be `lag` seconds late."""
        moment = now if self.doubtful_since is None else self.doubtful_since
        left = progressed(self.rest, state, moment)
        if now < moment + lag - TOLERANCE and any(new.operator == "always" and new not in self.rest for new in left):
            return ConstraintProgress(self.rest, moment)
        return ConstraintProgress(left)

    def next_look(self, now: float, lag: float) -> float:
        """Return when to look again even without a report."""
        if self.doubtful_since is not None:
            return self.doubtful_since + lag
        return min((time for left in self.rest for time in moments(left) if time > now + TOLERANCE), default=inf)

    @property
    def violated(self) -> bool:
        """Whether nothing can fulfil the constraint any more."""
        return IMPOSSIBLE in self.rest


def names_in(constraint: Constraint) -> frozenset[str]:
    """Return the predicates and functions the constraint mentions."""
    return frozenset().union(*map(names, constraint.conditions))


def observed_of(constraint: Constraint, state: Witness) -> str:
    """Return the observed values of the fluents in a ground constraint that is not fulfilled."""
    parts = [part for condition in constraint.conditions for part in unmet(condition, state) or conjuncts(condition)]
    return "; ".join(dict.fromkeys(observed(part, state) for part in parts))
