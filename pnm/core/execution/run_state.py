"""State of a run besides its marking: the time, stop and pause, timers; and the machine indexed by integers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heappop, heappush
from math import inf
from typing import Final

from pnm.core.execution.call_results import CallResults
from pnm.core.execution.events import Pause, Stop
from pnm.core.execution.handover import UnderWay
from pnm.core.machine.machine import (
    Accepts,
    AlreadyTrue,
    ConditionFalse,
    ConditionTrue,
    ConditionUnknown,
    DataMissing,
    EffectsMissing,
    EffectsSeen,
    Ends,
    InvariantFalse,
    OnFailure,
    PetriNetMachine,
    Rule,
    TransitionAction,
)
from pnm.core.machine.requests import Ended, Report
from pnm.core.net.firing_engine import Engine

_KNOWING: Final = (ConditionTrue, ConditionFalse, ConditionUnknown, InvariantFalse, AlreadyTrue, DataMissing, EffectsSeen, EffectsMissing)
"""Guards whose answer may change when facts change."""


@dataclass
class MachineIndex:
    """The index of a machine's places and transitions. Nothing changes once it is made."""

    machine: PetriNetMachine
    rules: list[Rule] = field(init=False)
    """For every transition, its rule."""
    reported: dict[int, list[int]] = field(init=False)
    """For every call, the transitions that reports about its request open."""
    records: frozenset[int] = field(init=False)
    """Places at which nothing is decided."""
    resources: frozenset[int] = field(init=False)
    takes: frozenset[int] = field(init=False)
    """Transitions that take resources; what is taken over has its own."""
    gives: frozenset[int] = field(init=False)
    """Transitions that give resources back."""
    alive: tuple[int, ...] = field(init=False)
    settling: dict[int, int] = field(init=False)
    restarts: frozenset[int] = field(init=False)
    failures: dict[int, int] = field(init=False)
    goal: int = field(init=False)
    failed: int = field(init=False)

    def __post_init__(self) -> None:
        machine, compiled = self.machine, self.machine.compiled
        ids = compiled.place_id
        self.rules = [machine.rules[name] for name in compiled.transitions]
        self.reported = {}
        for transition, rule in enumerate(self.rules):
            if isinstance(rule.guard, Accepts | Ends):
                self.reported.setdefault(rule.guard.call, []).append(transition)
        self.records = frozenset(ids[place] for place in machine.record_places)
        self.resources = frozenset(ids[place] for place in machine.resource_places)
        self.takes = frozenset(
            transition for transition in self._touching(compiled.inputs) if self.rules[transition].action is not TransitionAction.ADOPT
        )
        self.gives = self._touching(compiled.outputs)
        self.alive = tuple(ids[place] for place in machine.alive_places)
        self.settling = {ids[place]: call for place, call in machine.settling_places.items()}
        self.restarts = frozenset(ids[place] for place in machine.restart_places)
        self.failures = {ids[place]: call for place, call in machine.failure_places.items()}
        self.goal, self.failed = ids[machine.goal_place], ids[machine.failed_place]

    @cached_property
    def listening(self) -> list[bool]:
        """For every place, whether what is decided there may change when facts change."""
        return [
            any(isinstance(self.rules[transition].guard, _KNOWING) for transition, _ in arcs) for arcs in self.machine.compiled.consumers
        ]

    def _touching(self, arcs: list[list[tuple[int, int]]]) -> frozenset[int]:
        if not self.resources:  # most machines have none, and this is made for every machine
            return frozenset()
        return frozenset(transition for transition, touched in enumerate(arcs) if any(place in self.resources for place, _ in touched))


class Timers:
    """Times at which undecided places are asked again. The mutable state is the queue and, by place, the time set last."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int]] = []
        self._set: dict[int, float] = {}

    def set(self, place: int, time: float) -> None:
        """Set the time at which the place is asked again; earlier entries stay, for asking once too often does no harm."""
        if self._set.get(place) != time:
            self._set[place] = time
            heappush(self._queue, (time, place))

    @property
    def next(self) -> float:
        """The next of the times; infinite if there is none."""
        return self._queue[0][0] if self._queue else inf

    def due(self, now: float) -> Iterator[int]:
        """Yield, and forget, the places whose time has come."""
        while self._queue and self._queue[0][0] <= now:
            _, place = heappop(self._queue)
            self._set.pop(place, None)
            yield place


@dataclass
class RunState:
    """State of a run that guards read besides knowledge. The mutable state is what has a default."""

    engine: Engine
    index: MachineIndex
    results: CallResults
    origin: float | None = None
    """The time from which releases count."""
    has_begun: bool = False
    now: float = -inf
    stop: Stop | None = None
    """The request to stop, if there was one."""
    pause: Pause | None = None
    """The request to pause, until the run is resumed."""
    adopted: dict[int, UnderWay] = field(default_factory=dict)
    """Requests of another run that are still to be taken over, by call."""
    marked_at: dict[int, float] = field(default_factory=dict)
    """When places were marked last."""

    @property
    def passed(self) -> float:
        """The seconds since the plan's start."""
        return self.now - (self.origin or 0.0)

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return bool(self.engine.tokens[self.index.goal] or self.engine.tokens[self.index.failed])

    @property
    def failing(self) -> bool:
        """Whether the run can no longer succeed."""
        return bool(self.results.failures) or self.stop is not None

    @property
    def ending(self) -> bool:
        """Whether nothing more is started."""
        return self.failing or any(self.engine.tokens[place] for place in self.index.restarts)

    @property
    def cancels(self) -> bool:
        """Whether running calls shall be cancelled."""
        cancelled = self.stop is not None and self.stop.cancel
        return cancelled or (self.ending and self.index.machine.on_failure is OnFailure.CANCEL)

    @property
    def suspends(self) -> bool:
        """Whether running calls shall be cancelled, to begin anew later."""
        return self.pause is not None and self.pause.at_once

    @property
    def idle(self) -> bool:
        """Whether no call is under way."""
        return not any(self.engine.tokens[place] for place in self.index.alive)


def admits(rule: Rule, report: Report) -> bool:
    """Return whether the report opens the guard of the rule, which belongs to its call."""
    if isinstance(report, Ended):
        return isinstance(rule.guard, Ends) and report.outcome.kind in rule.guard.kinds
    return isinstance(rule.guard, Accepts)
