"""Petri Net Machines: PNM = (Σ, PN, m₀, δ̂, P_g) of the 2019 paper.

Σ are the reports, knowledge changes and moments in time of `pnm.core.execution.events`; PN and m₀ are the net
and its initial marking; P_g are the goal places. δ̂ is written down as one *rule* per
transition: a guard, asked besides the preset, and the action, outcome and cause that its firing brings about.
`pnm.core.execution.run` evaluates the rules; nothing here has a clock or does I/O.

At a place with several consumers the rules are asked in the order of the net's transitions,
and the first open one fires.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from enum import Enum, StrEnum
from functools import cached_property
from typing import Final, NamedTuple

from pnm.core import notebook
from pnm.core.machine.bindings import Bindings, is_open
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import Always, Guard
from pnm.core.machine.plan_graph import Moment, Ordering, PlanGraph
from pnm.core.machine.requests import TransitionAction
from pnm.core.net.firing_engine import CompiledNet
from pnm.core.net.net import Marking, PetriNet
from pnm.core.net.no_collection import no_collection
from pnm.core.net.time_order import TimeOrder, time_order

_ALWAYS: Final = Always()


class CallOutcome(StrEnum):
    """Outcome of a call, so far or for good."""

    WAITING = "waiting"
    RUNNING = "running"
    """Its request is out."""
    SUSPENDED = "suspended"
    """Between two attempts: its last request has failed, or was cancelled for a pause, and the next one is not out yet."""
    HANDED_OVER = "handed over"
    """Another run goes on with its request."""
    SUCCEEDED = "succeeded"
    ALREADY_TRUE = "already true"
    """Not sent: its effects held."""
    SKIPPED = "skipped"
    """Not sent: the run came to its end before."""
    CANCELED = "canceled"
    UNCONFIRMED = "canceled, unconfirmed"
    """Cancelled, but its server has not confirmed that it stopped."""
    PASSED_OVER = "passed over"
    """Not successful, and the plan goes on all the same."""
    FAILED = "failed"


class Rule(NamedTuple):
    """δ̂ for one transition: its guard, and what its firing means for its call. Nothing else is known by its name."""

    name: str
    """The event for people and exports, such as ``start`` or ``aborted``; the same for every call."""
    guard: Guard = _ALWAYS
    call: int | None = None
    """The number of the step it belongs to, which most often is a call; None for the frame around all steps."""
    action: TransitionAction | None = None
    outcome: CallOutcome | None = None
    """The outcome of the call from now on; None when that stays as it is."""
    cause: Cause | None = None
    """Why the step is about to recover or has failed; None when no new cause arises."""
    expected: str = ""
    """What was expected at that point, for the text of a failure; empty where the guard explains it."""
    observed: str = ""
    """What was observed instead; ``{message}`` stands for the message of the request's end, which is all if this is empty."""
    gives_up: bool = False
    """The request is no longer waited for, although its server may still be at work."""
    replans: bool = False
    """The plan asks for a planner to find another way."""
    restarts: bool = False
    """The whole plan begins anew."""


def check_rule(cause: Cause, guard: Guard = _ALWAYS, call: int | None = None, action: TransitionAction | None = None) -> Rule:
    """Return the rule of a check, which goes by the name of the cause that it finds."""
    return Rule(cause.value, guard, call, action, cause=cause)


class OnFailure(Enum):
    """Policy for running calls once a failure place is marked."""

    DRAIN = "drain"
    CANCEL = "cancel"
    CONTINUE_OTHERS = "continue_others"
    """As drain; but the task does not wait for the end of the run before it goes on in another way."""


@dataclass(frozen=True, slots=True)
class Region:
    """Steps that are entered and left as a whole: all of the plan, the body of a loop, a branch, a chain of recovery."""

    owner: int | None
    """The number of the step that holds it; None for all of the plan."""
    steps: frozenset[int]
    first: Sequence[str]
    """Places that the owner marks, all at once."""
    last: Sequence[str]
    """Places that are marked when all steps are done, and that the owner takes all at once."""


@dataclass(frozen=True)
class PetriNetMachine:
    """A net with roles, rules, and what it was made from: a plan and bindings."""

    plan: PlanGraph
    bindings: Bindings
    """Limits and resources of its calls."""
    net: PetriNet
    initial: Marking
    rules: Mapping[str, Rule]
    """For every transition, what δ̂ asks and what its firing brings about."""
    goal_place: str
    failed_place: str
    failure_places: Mapping[str, int]
    """For every place that marks the failure of a step, the number of the step."""
    restart_places: Mapping[str, int]
    """For every place that asks for the plan to begin anew, the call that marks it."""
    budget_places: Set[str]
    """Places that count retries, recoveries and rounds left, and those spent."""
    resource_places: Mapping[str, str]
    """For every place whose tokens calls have for themselves as long as they are under way, the name of the resource."""
    settling_places: Mapping[str, int]
    """For every place at which a call has succeeded and its effects are still to be looked for, the number of the call."""
    alive_places: Set[str]
    """Places of calls that are under way: a request may be alive, or its effects are looked for."""
    blocks: Mapping[int, tuple[str, ...]]
    """For every step, the places of its block."""
    orderings: Mapping[str, Ordering]
    """For every place that stands for an ordering of the plan, that ordering."""
    regions: tuple[Region, ...]
    """The plan itself first."""
    on_failure: OnFailure = OnFailure.DRAIN

    @cached_property
    def start_place(self) -> str:
        """The place of the only token that is no counter and no resource."""
        (start,) = (place for place in self.initial if place not in self.record_places)
        return start

    @property
    def goal_places(self) -> frozenset[str]:
        """P_g: the run has reached its goal when one of these is marked."""
        return frozenset({self.goal_place})

    @property
    def capacities(self) -> Mapping[str, int]:
        """How many calls may have each resource at the same time, as far as its name is known before its calls start."""
        return {name: self.initial[place] for place, name in self.resource_places.items() if not is_open(name)}

    @cached_property
    def record_places(self) -> frozenset[str]:
        """Places that may stay marked at the end: counters and resources."""
        return self.counter_places | frozenset(self.resource_places)

    @cached_property
    def counter_places(self) -> frozenset[str]:
        """Failures, restarts asked for, and budgets: nothing starts from them, they are looked at from other places."""
        return frozenset(self.failure_places) | frozenset(self.restart_places).union(self.budget_places)

    @cached_property
    def border_places(self) -> frozenset[str]:
        """Places between steps and what holds them."""
        return frozenset(place for region in self.regions for place in (*region.first, *region.last))

    def role(self, place: str) -> str:
        """Return ``goal``, ``failure``, ``restart``, ``budget``, ``resource``, ``ordering`` or, for all other places, nothing."""
        if place == self.goal_place:
            return "goal"
        if place in self.failure_places or place == self.failed_place:
            return "failure"
        if place in self.restart_places:
            return "restart"
        if place in self.budget_places:
            return "budget"
        if place in self.resource_places:
            return "resource"
        return "ordering" if place in self.orderings else ""

    @cached_property
    def compiled(self) -> CompiledNet:
        """The net over integers, made once and shared by all runs."""
        with no_collection():
            return CompiledNet(self.net)

    @cached_property
    def time_order(self) -> TimeOrder:
        """The order of time of its places, in which pictures have them."""
        # Tokens that ends wait for come into the middle of a block, which begins elsewhere.
        awaited = {place for place, ordering in self.orderings.items() if ordering.after.moment is Moment.END}
        return time_order(self.net, self.start_place, self.record_places | awaited)

    def _repr_svg_(self) -> str | None:
        return notebook.MACHINE.draw(self)

    def __repr__(self) -> str:
        return f"<PetriNetMachine {len(self.plan.calls)} calls, {len(self.net.places)} places, {len(self.net.inputs)} transitions>"
