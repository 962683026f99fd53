"""Is the machine sound? Proved before it runs, block by block; or by its whole state space.

*Sound* means: whatever its servers and the world answer, and whenever it is told to stop, the
machine ends, with exactly one token on its goal place or on its failed place and none elsewhere
but on record places; no place ever holds two tokens, a budget never more than it began with.

`explore` walks through all states: the oracle, for machines of a few calls. `verify` is linear
in the number of calls, and trusts nothing but the net and the rules. Every block (the transitions
of one call) is explored on its own, once per shape, with its inputs supplied at any moment; at
every place some exit opens in finite time for any answer; every place between blocks has one
writing and one reading block; and what the blocks wait for has no cycle. By induction along that
order each block gets its inputs once and gives its outputs once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from math import isfinite
from typing import Final, TypeAlias

from pnm.actions.base import OutcomeKind
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
from pnm.net import Weights
from pnm.plan_graph import Moment
from pnm.state_space import Part, Step, Unsound, explore_part


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
        Unsound: it is not, or not of the form that `pnm.generate` makes.
    """
    owner = {name: rule.call for name, rule in machine.rules.items()}
    writers, readers = _blocks_at(machine, machine.net.outputs, owner), _blocks_at(machine, machine.net.inputs, owner)
    _check_channels(machine, writers, readers)
    steps: dict[int | None, list[str]] = {}
    for name, call in owner.items():
        steps.setdefault(call, []).append(name)
    shapes: dict[object, int] = {}
    waits: dict[_Event, set[_Event]] = {}
    for call, names in steps.items():
        block = _block(machine, call, names, writers, readers)
        _check_exits(block.part)
        _check_rules(machine, call, names)
        _note_channels(block, writers, waits)
        shape = _shape(block.part)
        if shape not in shapes:
            shapes[shape] = explore_part(block.part)
    _check_order(waits)
    return Proof(len(machine.plan.calls), len(shapes), sum(shapes.values()))


def explore(machine: PetriNetMachine) -> int:
    """Walk through every state of a small machine and return their number.

    Raises:
        Unsound: some state is wrong, or there are more than `MAX_STATES`.
    """
    goal, failed = machine.goal_place, machine.failed_place

    def is_proper(left: Mapping[str, int]) -> str:
        return "" if left in ({goal: 1}, {failed: 1}) else f"it ends in {dict(left)}"

    steps = tuple(_step(machine, name) for name in machine.rules)
    records = machine.record_places
    return explore_part(
        Part(
            machine.net.places,
            steps,
            machine.initial,
            (),
            frozenset(machine.failure_places),
            records,
            machine.on_failure is OnFailure.CANCEL,
            is_proper,
        )
    )


# --- blocks --------------------------------------------------------------------------------


def _blocks_at(machine: PetriNetMachine, weights: Mapping[str, Weights], owner: Mapping[str, int | None]) -> dict[str, set[int | None]]:
    """Return, for every place, the blocks whose transitions write it, or read it."""
    found: dict[str, set[int | None]] = {place: set() for place in machine.net.places}
    for transition, connected in weights.items():
        for place in connected:
            found[place].add(owner[transition])
    return found


def _check_channels(machine: PetriNetMachine, writers: Mapping[str, set[int | None]], readers: Mapping[str, set[int | None]]) -> None:
    for place in machine.net.places:
        outside = writers[place] - readers[place]
        if len(readers[place]) > 1 or len(outside) > 1 or len(writers[place]) > 2:
            raise Unsound(f"{place} connects more than two blocks")
        if place in machine.orderings:
            ordering = machine.orderings[place]
            if outside != {ordering.before.call} or readers[place] != {ordering.after.call}:
                raise Unsound(f"{place} does not connect the calls of its ordering {ordering}")


def _check_exits(part: Part) -> None:
    """Check that at every place some exit is open for any answer the world can give."""
    exits: dict[str, list[Guard]] = {}
    for step in part.steps:
        for place in step.inputs:
            if place not in part.records:
                exits.setdefault(place, []).append(step.guard)
    for place, guards in exits.items():
        outcomes = [guard.kinds for guard in guards if isinstance(guard, Ends)]
        if outcomes and frozenset().union(*outcomes) != frozenset(OutcomeKind):
            raise Unsound(f"{place} has no exit for {set(OutcomeKind) - frozenset().union(*outcomes)}")
        for guard in guards:
            if isinstance(guard, Holding) and Denied(guard.condition) not in guards:
                raise Unsound(f"{place} has no exit for when {guard.condition} does not hold")
            if isinstance(guard, EffectsSeen) and EffectsMissing(guard.call) not in guards:
                raise Unsound(f"{place} has no exit for when the effects are not seen")
        if not any(isinstance(guard, _SURE) or (_is_timed(guard)) for guard in guards):
            raise Unsound(f"{place} has no exit that is sure to open in finite time")


def _is_timed(guard: Guard) -> bool:
    match guard:
        case After(seconds):
            return isfinite(seconds)
        case Due(seconds, since):
            return all(map(isfinite, (seconds, *(delay for _, delay in since))))
        case _:
            return False


_SURE: Final = (Always, Denied, EffectsMissing)
"""Guards of which it is certain that they, or the guards they complement, open in finite time."""


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


_Event: TypeAlias = tuple[int | None, str]
"""The start or the end of a block; that of the frame around all calls is None."""


@dataclass(frozen=True, slots=True)
class _Block:
    """A block and what connects it to others."""

    call: int | None
    part: Part
    first: tuple[str, ...]
    """Inputs that its start waits for."""
    rest: tuple[str, ...]
    """Inputs that only its end waits for."""
    early: frozenset[str]
    """Outputs that its start gives."""


def _note_channels(block: _Block, writers: Mapping[str, set[int | None]], waits: dict[_Event, set[_Event]]) -> None:
    """Note which events of other blocks the events of this block wait for."""
    start, end = (block.call, "start"), (block.call, "end")
    waits.setdefault(end, set()).add(start)
    for places, event in ((block.first, end if block.call is None else start), (block.rest, end)):
        for place in places:
            (writer,) = writers[place] - {block.call}
            waits.setdefault(event, set()).add((writer, f"start of {place}"))
    for place in block.part.places:
        waits.setdefault((block.call, f"start of {place}"), set()).add(start if place in block.early else end)


def _check_order(waits: Mapping[_Event, set[_Event]]) -> None:
    try:
        TopologicalSorter(waits).prepare()
    except CycleError as error:
        raise Unsound(f"blocks wait for each other: {error.args[1]}") from error


def _block(
    machine: PetriNetMachine,
    call: int | None,
    names: list[str],
    writers: Mapping[str, set[int | None]],
    readers: Mapping[str, set[int | None]],
) -> _Block:
    """Cut the block of one call, or the frame around all calls, out of the machine."""
    steps = tuple(_step(machine, name) for name in names)
    places = tuple(dict.fromkeys(place for step in steps for place in (*step.inputs, *step.outputs)))
    inputs = [place for place in places if call in readers[place] and writers[place] - {call}]
    outputs = [
        place
        for place in places
        if call in writers[place] and (readers[place] - {call} or place in (machine.goal_place, machine.failed_place))
    ]
    first = [place for place in inputs if not any(place in step.outputs for step in steps) and not _is_awaited(place, steps)]
    rest = [place for place in inputs if place not in first]
    for together in (first, rest):
        for step in steps:
            if 0 < sum(place in step.inputs for place in together) < len(together):
                raise Unsound(f"{step.name} takes only some of the inputs {together}")
    records = machine.record_places
    finals = {machine.goal_place, machine.failed_place}
    if call is None:
        early = frozenset(outputs) - finals
    else:
        early = frozenset(
            place for place in outputs if place in machine.orderings and machine.orderings[place].before.moment is Moment.START
        )

    def is_proper(left: Mapping[str, int]) -> str:
        ends = [place for place in left if place in finals]
        expected = {**dict.fromkeys((place for place in outputs if place not in finals), 1), **dict.fromkeys(ends[:1], 1)}
        if call is None and (len(ends) != 1 or left != expected):
            return f"it ends in {dict(left)}"
        return "" if left == expected else f"it leaves {dict(left)} in place of {expected}"

    supplies = tuple(tuple(together) for together in (first, rest) if together)
    part = Part(
        places,
        steps,
        {place: machine.initial[place] for place in places if machine.initial[place]},
        supplies,
        frozenset(place for place in places if place in machine.failure_places),
        records & frozenset(places),
        machine.on_failure is OnFailure.CANCEL,
        is_proper,
        early if rest or call is None else frozenset(),
    )
    return _Block(call, part, tuple(first), tuple(rest), early)


def _is_awaited(place: str, steps: tuple[Step, ...]) -> bool:
    return any(place in step.inputs and place in step.outputs for step in steps)


def _step(machine: PetriNetMachine, name: str) -> Step:
    return Step(name, machine.rules[name].guard, machine.net.inputs[name], machine.net.outputs[name])


def _shape(part: Part) -> object:
    """Return what two blocks that behave alike have in common: everything but names, conditions and times."""
    number = {place: index for index, place in enumerate(part.places)}
    steps = tuple(
        (
            type(step.guard).__name__,
            tuple((number[place], weight) for place, weight in step.inputs.items()),
            tuple((number[place], weight) for place, weight in step.outputs.items()),
        )
        for step in part.steps
    )
    marked = tuple((number[place], tokens) for place, tokens in part.initial.items())
    roles = tuple((place in part.records, place in part.failures, place in part.early) for place in part.places)
    return steps, marked, roles, tuple(tuple(number[place] for place in supply) for supply in part.supplies), part.cancels
