"""A part of a machine for its exploration: a whole machine, or a block of it with its inputs supplied from outside at any moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pnm.core.machine.machine import CallOutcome, Guard, InvariantFalse, PetriNetMachine, TransitionAction, is_check
from pnm.core.machine.plan_graph import Cause, Then
from pnm.core.net.net import Weights
from pnm.errors import PnmError


class Unsound(PnmError):
    """The machine can reach a state it must not reach; `trace` leads there."""

    def __init__(self, what: str, trace: Sequence[str] = ()) -> None:
        super().__init__(f"{what}{f'; after {chr(32).join(trace)}' if trace else ''}")
        self.trace = tuple(trace)


@dataclass(frozen=True, slots=True)
class Inside:
    """In the place of a guard: what happens inside a region, which takes its time but comes to an end."""


class Left(Enum):
    """How much of a counter is left."""

    ALL = "all"
    SOME = "some"
    NONE = "none"

    __hash__ = object.__hash__  # each is there once


class Count(NamedTuple):
    """What a step asks of a counter: a pair of places that one place stands for."""

    place: str
    cases: frozenset[Left]
    """Those in which the step is enabled."""
    possible: frozenset[Left]
    """All cases of this counter."""
    restores: bool | None
    """Whether the step moves a token back, or on; None if it takes all of them away."""


class Step(NamedTuple):
    """A transition of a part of a net, or all that happens inside a region."""

    name: str
    guard: Guard | Inside
    inputs: Weights
    outputs: Weights
    call: int | None = None
    """The call whose request its action and its guard are about, if there is one."""
    action: TransitionAction | None = None
    gives_up: bool = False
    """The request of the call is no longer waited for."""
    outcome: CallOutcome | None = None
    """The outcome of the call from then on; None when that stays as it is."""
    finds_cause: bool = False
    """Whether the run knows from then on why the call fails or is passed over, if it is."""
    settles: bool = False
    """Whether the plan may go on from then on: without the call after such a cause, or after the loop, the choice or all of its steps."""
    counted: Count | None = None
    """What it asks of a counter, which may be so or not at any time."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a machine with what surrounds it: inputs that come once, at any moment."""

    places: tuple[str, ...]
    steps: tuple[Step, ...]
    initial: Mapping[str, int]
    supplies: tuple[tuple[str, ...], ...] = ()
    """Sets of places that get their tokens from outside, each set at once."""
    failures: frozenset[str] = frozenset()
    records: frozenset[str] = frozenset()
    """Places that may stay marked."""
    counters: frozenset[str] = frozenset()
    """Those of them from which nothing starts: what takes from them is asked for at other places."""
    cancels: bool = False
    """Whether a failure has running calls cancelled."""
    outputs: frozenset[str] = frozenset()
    """Places that are marked in the end, each once: others take from them."""
    ends: frozenset[str] = frozenset()
    """Those of them that stand for the end: once one is marked, nothing else of the part is, and no request is alive."""
    finals: frozenset[str] = frozenset()
    """Final places: exactly one is marked in the end, if there are any."""
    goal: str = ""
    """The final place that is not marked while the run is ending."""
    early: frozenset[str] = frozenset()
    """Places that must be marked once nothing more can happen without the last supply."""
    restarts: frozenset[str] = frozenset()
    """Places that ask for the plan to begin anew."""
    others_restart: bool = False
    """Whether other parts may ask for that."""
    repeats: bool = False
    """Whether it may be entered again once it was left, with its counters as they then are."""
    resources: frozenset[str] = frozenset()
    """Places that others take from as well: a step that lacks nothing else is waited for, and the rules after it are not asked."""
    alive: frozenset[str] = frozenset()
    """Places of calls that are under way: one is marked for every request that is alive."""
    settling: frozenset[str] = frozenset()
    """Places at which effects of calls are looked for."""
    owed: tuple[int | None, ...] = ()
    """The calls that must have been carried out, or passed over as the plan says, when it ends and the run is not ending; None for a
    loop, a choice or the frame."""


def step_of(machine: PetriNetMachine, name: str) -> Step:
    """Return a transition with its guard, and with its action if it belongs to a call."""
    rule, inputs, outputs = machine.rules[name], machine.net.inputs[name], machine.net.outputs[name]
    about = getattr(rule.guard, "call", rule.call)
    if about != rule.call:
        raise Unsound(f"{name} listens to another call")
    if rule.call is None or rule.call >= len(machine.plan.calls):
        if rule.action is not None or isinstance(rule.guard, InvariantFalse) or hasattr(rule.guard, "call"):
            raise Unsound(f"{name} is about a request, and belongs to no call")
        return Step(name, rule.guard, inputs, outputs, finds_cause=rule.cause is not None and is_check(rule.guard))
    settles, recoveries = False, machine.plan.calls[rule.call].recoveries
    if rule.cause is not None and recoveries:
        # What is withheld before the call is sent is treated as if the server were not there.
        cause = Cause.UNAVAILABLE if rule.cause is Cause.WITHHELD else rule.cause
        settles = any(recovery.then is Then.SKIP and cause in recovery.causes for recovery in recoveries)
    return Step(name, rule.guard, inputs, outputs, rule.call, rule.action, rule.gives_up, rule.outcome, rule.cause is not None, settles)
