"""The neutral plan: calls of actions, and which event of which call must wait for which.

A call has two events, its start and its end. An ordering says that one event comes after
another and names the facts that the order protects. Any partial order can be said this way,
sequential and time-triggered plans included. Knows nothing of PDDL or of nets.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from graphlib import CycleError, TopologicalSorter
from math import inf

from pnm.conditions import TRUE, Condition
from pnm.effects import Effects
from pnm.errors import PnmError
from pnm.expressions import Fluent, show
from pnm.rules import NO_RULES, Rules


class PlanGraphError(PnmError):
    """The orderings of a plan contradict each other or name a call that is not there."""


@dataclass(frozen=True, slots=True)
class GroundAction:
    """An action with objects for its parameters: what must hold, what it changes, how long it takes.

    An instantaneous PDDL action has no duration here; its precondition must hold at the start
    and its effects are there at the end, however long the robot takes.
    """

    name: str
    arguments: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    """The names of the arguments, without ``?``."""
    precondition: Condition = TRUE
    """Must hold when the action starts."""
    invariant: Condition = TRUE
    """Must hold all the time between start and end."""
    end_condition: Condition = TRUE
    """Must hold just before the end effects."""
    start_effects: Effects = ()
    end_effects: Effects = ()
    duration: float | None = None
    """Planned seconds from start to end; None when nothing is known about it."""

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments)})"


@dataclass(frozen=True, slots=True)
class ActionCall:
    """One occurrence of a ground action in a plan, named by its position."""

    index: int
    action: GroundAction
    planned: float = 0.0
    """Seconds after the moment the plan starts from at which its planner had the call start."""
    release: float = 0.0
    """Seconds after that moment before which the call must not start."""
    deadline: float = inf
    """Seconds after that moment by which the call must have ended."""
    lasting: frozenset[Fluent] = frozenset()
    """Fluents written at the start that are still the action's own doing when it ends."""

    def __str__(self) -> str:
        return f"{self.action}#{self.index}"


class Moment(Enum):
    """The two events of a call."""

    START = "start"
    END = "end"


@dataclass(frozen=True, slots=True)
class PlanEvent:
    """The start or the end of a call."""

    call: int
    moment: Moment

    def __str__(self) -> str:
        return f"{self.moment.value} of #{self.call}"


@dataclass(frozen=True, slots=True)
class Ordering:
    """`after` waits for `before`."""

    before: PlanEvent
    after: PlanEvent
    protects: tuple[Fluent, ...] = ()
    """The facts for whose sake the order must be kept."""
    delay: float = 0.0
    """Seconds that `after`, which is then a start, must come later than `before`, at least."""

    def __str__(self) -> str:
        reason = f" ({', '.join(map(show, self.protects))})" if self.protects else ""
        delay = f" + {self.delay:g} s" if self.delay else ""
        return f"{self.before}{delay} < {self.after}{reason}"


@dataclass(frozen=True)
class PlanGraph:
    """Calls, orderings between their events, and the goal that holds after all of them.

    Raises:
        PlanGraphError: an ordering names a call that is not there, or the orderings form a cycle.
    """

    calls: tuple[ActionCall, ...]
    orderings: tuple[Ordering, ...] = ()
    goal: Condition = TRUE
    rules: Rules = NO_RULES
    """What derives facts that its conditions mention."""
    due: float = 0.0
    """Seconds after the moment the plan starts from before which the goal is not looked at: time itself does the last part."""

    def __post_init__(self) -> None:
        for position, call in enumerate(self.calls):
            if call.index != position:
                raise PlanGraphError(f"{call} stands at position {position}")
        for ordering in self.orderings:
            for event in (ordering.before, ordering.after):
                if not 0 <= event.call < len(self.calls):
                    raise PlanGraphError(f"{ordering} names a call that is not in the plan")
            if ordering.delay and ordering.after.moment is Moment.END:
                raise PlanGraphError(f"{ordering} would delay an end, which comes when the action's time is up")
        self.in_order()

    def in_order(self) -> tuple[PlanEvent, ...]:
        """Return all events in an order that keeps every start before its end and every ordering."""
        before: dict[PlanEvent, list[PlanEvent]] = {}
        for call in self.calls:
            start, end = PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END)
            before.setdefault(start, [])
            before.setdefault(end, []).append(start)
        for ordering in self.orderings:
            before[ordering.after].append(ordering.before)
        try:
            return tuple(TopologicalSorter(before).static_order())
        except CycleError as error:
            raise PlanGraphError(f"the orderings form a cycle: {' < '.join(map(str, error.args[1]))}") from error

    def __repr__(self) -> str:
        return f"<PlanGraph {len(self.calls)} calls, {len(self.orderings)} orderings>"
