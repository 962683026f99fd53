"""Is the machine sound? Proved before it runs, block by block; or by its whole state space.

*Sound* means: whatever its servers and the world answer, and whenever it is told to stop, the
machine ends, with exactly one token on its goal place or on its failed place and none elsewhere
but on record places; no place ever holds two tokens, a budget never more than it began with. A run
that is paused goes on when it is told to, and each pause may have calls begin anew: so it ends if it
is paused finitely often.

`explore` walks through all states: the oracle, for machines of a few calls. `verify` is linear
in the number of calls, and trusts nothing but the net and the rules. Every block (the transitions
of one step) is explored on its own, once per shape, with its inputs supplied at any moment and
what it holds taken as one step that comes to an end; at every place some exit opens in finite
time for any answer; every place between blocks has one writing and one reading block, neighbours
or a step and what holds it; and what neighbours wait for has no cycle. By induction along that
order, and from the innermost steps outwards, each block gets its inputs once and gives its outputs
once whenever it is entered.

A block takes all of its resources at once, while it has none, gives them back whatever happens, and
waits neither for other blocks nor for what it holds as long as it has them. So whoever has resources
comes to an end without anybody else's help, and whoever waits for some gets them in the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from math import isfinite
from typing import Final

from pnm.actions.base import OutcomeKind
from pnm.blocks import Anatomy, Event, step_of
from pnm.conditions import Condition
from pnm.machine import (
    Accepts,
    After,
    Always,
    Deed,
    Denied,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ends,
    Guard,
    Holding,
    OnFailure,
    PetriNetMachine,
)
from pnm.state_space import Inside, Part, Unsound, explore_part

_REMEMBERED: Final = 1000
_FOUND_GOOD: Final[dict[object, int]] = {}
"""Shapes of blocks that were explored, and how many states they have; the oldest is forgotten first."""


@dataclass(frozen=True, slots=True)
class Proof:
    """What was proved, and how much work it was."""

    calls: int
    shapes: int
    """Blocks that differ."""
    states: int
    """States explored in all of them."""

    def __str__(self) -> str:
        return f"sound: {self.calls} calls of {self.shapes} shapes, {self.states} states explored"


def verify(machine: PetriNetMachine) -> Proof:
    """Prove the machine sound.

    Raises:
        Unsound: it is not, or not of the form that `pnm.generation` makes.
    """
    anatomy = Anatomy(machine)
    shapes: dict[object, int] = {}
    waits: dict[Event, set[Event]] = {}
    for owner, names in anatomy.transitions.items():
        block = anatomy.block(owner)
        _check_exits(block.part)
        _check_rules(machine, owner, names)
        anatomy.note_waits(block, waits)
        shape = _shape(block.part)
        shapes[shape] = _explored(shape, block.part)
    _check_order(waits)
    return Proof(len(machine.plan.calls), len(shapes), sum(shapes.values()))


def _explored(shape: object, part: Part) -> int:
    """Explore a block, unless one of its shape has been found good before: a task proves many machines of the same few shapes."""
    if shape not in _FOUND_GOOD:
        states = explore_part(part)
        if len(_FOUND_GOOD) == _REMEMBERED:
            _FOUND_GOOD.pop(next(iter(_FOUND_GOOD)))
        _FOUND_GOOD[shape] = states
    return _FOUND_GOOD[shape]


def explore(machine: PetriNetMachine) -> int:
    """Walk through every state of a small machine and return their number.

    Raises:
        Unsound: some state is wrong, or there are more than `MAX_STATES`.
    """
    goal, failed = machine.goal_place, machine.failed_place

    def is_proper(left: Mapping[str, int]) -> str:
        return "" if left in ({goal: 1}, {failed: 1}) else f"it ends in {dict(left)}"

    steps = tuple(step_of(machine, name) for name in machine.rules)
    records = machine.record_places
    return explore_part(
        Part(
            machine.net.places,
            steps,
            machine.initial,
            (),
            frozenset(machine.failure_places),
            records,
            machine.counter_places,
            machine.on_failure is OnFailure.CANCEL,
            is_proper,
            restarts=frozenset(machine.restart_places),
            resources=machine.resource_places,
        )
    )


# --- checks --------------------------------------------------------------------------------


def _check_exits(part: Part) -> None:
    """Check that at every place some exit is open for any answer the world can give."""
    exits: dict[str, list[Guard]] = {}
    for step in part.steps:
        for place in step.inputs:
            if place not in part.records | part.resources and not isinstance(step.guard, Inside):
                exits.setdefault(place, []).append(step.guard)
    for place, guards in exits.items():
        outcomes = [guard.kinds for guard in guards if isinstance(guard, Ends)]
        if outcomes and frozenset().union(*outcomes) != frozenset(OutcomeKind):
            raise Unsound(f"{place} has no exit for {set(OutcomeKind) - frozenset().union(*outcomes)}")
        if any(isinstance(guard, Always) or _is_timed(guard) or _completes(guard, guards) for guard in guards):
            continue
        for guard in guards:
            if isinstance(guard, Holding):
                raise Unsound(f"{place} has no exit for when {guard.condition} does not hold")
            if isinstance(guard, EffectsSeen):
                raise Unsound(f"{place} has no exit for when the effects are not seen")
        raise Unsound(f"{place} has no exit that is sure to open in finite time")


def _completes(guard: Guard, guards: list[Guard]) -> bool:
    """Tell whether the guard opens, in finite time, whenever another one does not."""
    match guard:
        case Denied(condition):
            return Holding(condition) in guards
        case EffectsMissing(call):
            return EffectsSeen(call) in guards
        case _:
            return False


def _is_timed(guard: Guard) -> bool:
    match guard:
        case After(seconds):
            return isfinite(seconds)
        case Due(seconds, since):
            return all(map(isfinite, (seconds, *(delay for _, delay in since))))
        case _:
            return False


def _check_rules(machine: PetriNetMachine, call: int | None, names: list[str]) -> None:
    """Check that the rules of a block speak of its own call, and that requests and the goal are what they seem."""
    waiting = {place for name in names if isinstance(machine.rules[name].guard, Accepts) for place in machine.net.inputs[name]}
    for name in names:
        rule, outputs = machine.rules[name], machine.net.outputs[name]
        if getattr(rule.guard, "call", call) != call:
            raise Unsound(f"{name} listens to another call")
        if (rule.deed is Deed.SEND) is not bool(waiting & set(outputs)):
            raise Unsound(f"{name} does not send the request that is waited for, or sends one that is not")
        if any(machine.failure_places.get(place, call) != call for place in outputs):
            raise Unsound(f"{name} marks the failure of another call")
        if machine.goal_place in outputs and rule.guard != Holding(machine.plan.goal):
            raise Unsound(f"{name} marks the goal place without asking for the goal")


def _check_order(waits: Mapping[Event, set[Event]]) -> None:
    try:
        TopologicalSorter(waits).prepare()
    except CycleError as error:
        raise Unsound(f"blocks wait for each other: {error.args[1]}") from error


def _shape(part: Part) -> object:
    """Return what two blocks that behave alike have in common: everything but names, times and what conditions say."""
    number = {place: index for index, place in enumerate(part.places)}
    conditions: dict[Condition, int] = {}
    for step in part.steps:
        if isinstance(step.guard, Holding | Denied):
            conditions.setdefault(step.guard.condition, len(conditions))
    steps = tuple(
        (
            type(step.guard).__name__,
            conditions[step.guard.condition] if isinstance(step.guard, Holding | Denied) else None,
            tuple((number[place], weight) for place, weight in step.inputs.items()),
            tuple((number[place], weight) for place, weight in step.outputs.items()),
        )
        for step in part.steps
    )
    marked = tuple((number[place], tokens) for place, tokens in part.initial.items())
    roles = tuple(
        (
            *(place in part.records, place in part.counters, place in part.failures, place in part.early, place in part.restarts),
            place in part.resources,
        )
        for place in part.places
    )
    supplies = tuple(tuple(number[place] for place in supply) for supply in part.supplies)
    return steps, marked, roles, supplies, part.cancels, part.others_restart, part.repeats
