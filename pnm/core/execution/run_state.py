"""State of a run besides its marking: the time, stop and pause, timers; and the machine indexed by integers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from math import inf
from typing import Final
from weakref import WeakKeyDictionary

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
from pnm.core.net.firing_engine import CompiledNet, Engine

_KNOWING: Final = (ConditionTrue, ConditionFalse, ConditionUnknown, InvariantFalse, AlreadyTrue, DataMissing, EffectsSeen, EffectsMissing)
"""Guards whose answer may change when facts change."""


@dataclass(frozen=True, slots=True)
class MachineIndex:
    """The index of a machine's places and transitions."""

    rules: list[Rule]
    """For every transition, its rule."""
    choices: list[tuple[int, ...]]
    """For every place, the transitions that are decided on there, in their order."""
    reported: dict[int, list[int]]
    """For every call, the transitions that reports about its request open."""
    awaiting: frozenset[int]
    """Places at which a report is waited for."""
    listening: frozenset[int]
    """Places at which what is decided may change when facts change."""
    records: frozenset[int]
    """Places at which nothing is decided."""
    resources: frozenset[int]
    takes: frozenset[int]
    """Transitions that take resources; what is taken over has its own."""
    gives: frozenset[int]
    """Transitions that give resources back."""
    alive: tuple[int, ...]
    settling: dict[int, int]
    restarts: frozenset[int]
    failures: dict[int, int]
    fails: list[tuple[int, ...]]
    """For every transition, the failure places that it marks."""
    goal: int
    failed: int
    on_failure: OnFailure


_INDICES: Final[WeakKeyDictionary[CompiledNet, MachineIndex]] = WeakKeyDictionary()


def index_of(machine: PetriNetMachine) -> MachineIndex:
    """Return the index of a machine, which is made once."""
    found = _INDICES.get(machine.compiled)
    if found is None:
        found = _INDICES[machine.compiled] = _indexed(machine)
    return found


def _indexed(machine: PetriNetMachine) -> MachineIndex:
    compiled = machine.compiled
    ids = compiled.place_id
    rules = [machine.rules[name] for name in compiled.transitions]
    reported: dict[int, list[int]] = {}
    for transition, rule in enumerate(rules):
        if isinstance(rule.guard, Accepts | Ends):
            reported.setdefault(rule.guard.call, []).append(transition)
    by_report = {transition for transitions in reported.values() for transition in transitions}
    knowing = {transition for transition, rule in enumerate(rules) if isinstance(rule.guard, _KNOWING)}
    resources = frozenset(ids[place] for place in machine.resource_places)
    failures = {ids[place]: call for place, call in machine.failure_places.items()}

    def touching(arcs: list[list[tuple[int, int]]]) -> Iterator[int]:
        if resources:  # most machines have none
            yield from (transition for transition, touched in enumerate(arcs) if any(place in resources for place, _ in touched))

    return MachineIndex(
        rules,
        [tuple(transition for transition, _ in arcs if transition not in by_report) for arcs in compiled.consumers],
        reported,
        frozenset(place for transition in by_report for place, _ in compiled.inputs[transition]),
        frozenset(place for transition in knowing for place, _ in compiled.inputs[transition]),
        frozenset(ids[place] for place in machine.record_places),
        resources,
        frozenset(transition for transition in touching(compiled.inputs) if rules[transition].action is not TransitionAction.ADOPT),
        frozenset(touching(compiled.outputs)),
        tuple(ids[place] for place in machine.alive_places),
        {ids[place]: call for place, call in machine.settling_places.items()},
        frozenset(ids[place] for place in machine.restart_places),
        failures,
        [tuple(place for place, _ in arcs if place in failures) for arcs in compiled.outputs],
        ids[machine.goal_place],
        ids[machine.failed_place],
        machine.on_failure,
    )


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
        return self.failing or (bool(self.index.restarts) and any(self.engine.tokens[place] for place in self.index.restarts))

    @property
    def cancels(self) -> bool:
        """Whether running calls shall be cancelled."""
        cancelled = self.stop is not None and self.stop.cancel
        return cancelled or (self.ending and self.index.on_failure is OnFailure.CANCEL)

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
