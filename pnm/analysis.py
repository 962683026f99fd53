"""Is the machine sound? Proved before it runs, block by block; or by its whole state space.

*Sound* means: whatever its servers and the world answer, and whenever it is told to stop, the
machine ends, with exactly one token on its goal place or on its failed place and none elsewhere
but on record places; no place ever holds two tokens, a budget never more than it began with.

`explore` walks through all states: the oracle, for machines of a few calls. `verify` is linear
in the number of calls. It trusts nothing but the net and the rules: every block (the transitions
of one call) is explored on its own, once per shape, with its inputs supplied at any moment; every
place between blocks has one writing and one reading block; and the orderings have no cycle. By
induction along the orderings, each block then gets its inputs once and gives its outputs once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from pnm.actions.base import OutcomeKind
from pnm.errors import PnmError
from pnm.machine import (
    AlreadyTrue,
    Always,
    CancelAsked,
    DataMissing,
    Denied,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Guard,
    Holding,
    OnFailure,
    PetriNetMachine,
)
from pnm.net import Weights

MAX_STATES: Final = 2_000_000


class Unsound(PnmError):
    """The machine can reach a state it must not reach; `trace` leads there."""

    def __init__(self, what: str, trace: Sequence[str] = ()) -> None:
        super().__init__(f"{what}{f'; after {chr(32).join(trace)}' if trace else ''}")
        self.trace = tuple(trace)


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


@dataclass(frozen=True, slots=True)
class Step:
    """A transition of a part of a net."""

    name: str
    guard: Guard
    inputs: Weights
    outputs: Weights


Tokens: TypeAlias = tuple[int, ...]


@dataclass(frozen=True)
class Part:
    """A part of a machine with what surrounds it: inputs that come once, at any moment."""

    places: tuple[str, ...]
    steps: tuple[Step, ...]
    initial: Mapping[str, int]
    supplies: tuple[tuple[str, ...], ...]
    """Sets of places that get their tokens from outside, each set at once."""
    failures: frozenset[str]
    records: frozenset[str]
    cancels: bool
    """Whether a failure has running calls cancelled."""
    is_proper: Callable[[Mapping[str, int]], str]
    """Tell what is wrong with a final marking of all but record places; empty when it is proper."""
    early: frozenset[str] = frozenset()
    """Places that must be marked once nothing more can happen without the last supply."""


def verify(machine: PetriNetMachine) -> Proof:
    """Prove the machine sound.

    Raises:
        Unsound: it is not, or not of the form that `pnm.generate` makes.
    """
    owner = {name: rule.call for name, rule in machine.rules.items()}
    writers, readers = _blocks_at(machine, machine.net.outputs, owner), _blocks_at(machine, machine.net.inputs, owner)
    _check_channels(machine, writers, readers)
    machine.plan.in_order()
    steps: dict[int | None, list[str]] = {}
    for name, call in owner.items():
        steps.setdefault(call, []).append(name)
    shapes: dict[object, int] = {}
    for call, names in steps.items():
        part = _block(machine, call, names, writers, readers)
        _check_exits(part)
        shape = _shape(part)
        if shape not in shapes:
            shapes[shape] = explore_part(part)
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


# --- the state space of a part -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _State:
    tokens: Tokens
    stop: int = 0
    """0: going on, 1: told to end, 2: told to cancel."""
    supplied: int = 0
    """How many of the supplies have come."""


@dataclass
class _Explorer:
    part: Part
    index: dict[str, int] = field(init=False)
    consumers: list[list[int]] = field(init=False)

    most: list[int] = field(init=False)
    """How many tokens each place may hold."""

    def __post_init__(self) -> None:
        self.index = {place: number for number, place in enumerate(self.part.places)}
        self.consumers = [[] for _ in self.part.places]
        for number, step in enumerate(self.part.steps):
            for place in step.inputs:
                self.consumers[self.index[place]].append(number)
        self.failures = [self.index[place] for place in self.part.failures]
        budget = sum(tokens for place, tokens in self.part.initial.items() if place in self.part.records)
        self.most = [budget if place in self.part.records - self.part.failures else 1 for place in self.part.places]

    def successors(self, state: _State) -> Iterator[tuple[str, _State]]:
        """Yield everything that can happen next."""
        for step in self._possible(state):
            yield step.name, _State(self._fired(state.tokens, step), state.stop, state.supplied)
        if state.supplied < len(self.part.supplies):
            tokens = list(state.tokens)
            for place in self.part.supplies[state.supplied]:
                tokens[self.index[place]] += 1
            yield "supply", _State(tuple(tokens), state.stop, state.supplied + 1)
        for stop in range(state.stop + 1, 3):
            yield "stop" if stop == 1 else "cancel", _State(state.tokens, stop, state.supplied)

    def _possible(self, state: _State) -> list[Step]:
        """Return the enabled steps whose guards may be open, as `pnm.run` asks them: in order, at each marked place."""
        ending = state.stop > 0 or any(state.tokens[place] for place in self.failures)
        cancel = state.stop == 2 or (ending and self.part.cancels)
        found: dict[int, None] = {}
        enabled: dict[int, bool] = {}
        for place, tokens in enumerate(state.tokens):
            if tokens:
                for number in self.consumers[place]:
                    step = self.part.steps[number]
                    if number not in enabled:
                        enabled[number] = all(state.tokens[self.index[one]] >= weight for one, weight in step.inputs.items())
                    if not enabled[number]:
                        continue
                    is_open = _is_open(step.guard, ending, cancel)
                    if is_open is not False:
                        found[number] = None
                    if is_open is True:
                        break
        return [self.part.steps[number] for number in found]

    def _fired(self, tokens: Tokens, step: Step) -> Tokens:
        after = list(tokens)
        for place, weight in step.inputs.items():
            after[self.index[place]] -= weight
        for place, weight in step.outputs.items():
            after[self.index[place]] += weight
        return tuple(after)

    def check(self, state: _State, stuck: bool) -> str:
        """Tell what is wrong with a state; empty when nothing is."""
        for number, tokens in enumerate(state.tokens):
            if tokens > self.most[number]:
                return f"{self.part.places[number]} holds {tokens} tokens"
        if not stuck:
            return ""
        missing = len(self.part.supplies) - state.supplied
        if missing == 1 and (late := [place for place in self.part.early if not state.tokens[self.index[place]]]):
            return f"{late[0]} is not marked although only later inputs are missing"
        if missing:
            return ""
        left = {
            place: state.tokens[number] for place, number in self.index.items() if state.tokens[number] and place not in self.part.records
        }
        return self.part.is_proper(left)


def _is_open(guard: Guard, ending: bool, cancel: bool) -> bool | None:
    """Tell whether the guard is open, closed, or either, depending on the world."""
    match guard:
        case Always():
            return True
        case Ending():
            return ending
        case CancelAsked():
            return cancel
        case _:
            return None


def explore_part(part: Part) -> int:
    """Walk through every state of the part and return their number.

    Raises:
        Unsound: some state is wrong, something can go round for ever, or there are too many states.
    """
    explorer = _Explorer(part)
    start = _State(tuple(part.initial.get(place, 0) for place in part.places))
    path: list[tuple[_State, Iterator[tuple[str, _State]]]] = []
    names: list[str] = []
    on_path: set[_State] = set()
    seen: set[_State] = set()

    def enter(state: _State) -> None:
        nexts = list(explorer.successors(state))
        stuck = all(name in ("stop", "cancel", "supply") for name, _ in nexts)
        if wrong := explorer.check(state, stuck):
            raise Unsound(wrong, names)
        if len(seen) > MAX_STATES:
            raise Unsound(f"more than {MAX_STATES} states")
        seen.add(state)
        on_path.add(state)
        path.append((state, iter(nexts)))

    enter(start)
    while path:
        state, nexts = path[-1]
        found = next(nexts, None)
        if found is None:
            path.pop()
            on_path.discard(state)
            if names:
                names.pop()
            continue
        name, following = found
        if following in on_path:
            raise Unsound("it can go round for ever", [*names, name])
        if following not in seen:
            names.append(name)
            enter(following)
    return len(seen)


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
        if all(isinstance(guard, _PARTIAL) for guard in guards):
            raise Unsound(f"{place} has no exit that is sure to open")


_PARTIAL: Final = (Ending, CancelAsked, AlreadyTrue, DataMissing)
"""Guards that may stay closed for ever."""


def _block(
    machine: PetriNetMachine,
    call: int | None,
    names: list[str],
    writers: Mapping[str, set[int | None]],
    readers: Mapping[str, set[int | None]],
) -> Part:
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
    early = frozenset(place for place in outputs if place in machine.orderings and machine.orderings[place].before.moment.value == "start")
    finals = {machine.goal_place, machine.failed_place}

    def is_proper(left: Mapping[str, int]) -> str:
        ends = [place for place in left if place in finals]
        expected = {**dict.fromkeys((place for place in outputs if place not in finals), 1), **dict.fromkeys(ends[:1], 1)}
        if call is None and (len(ends) != 1 or left != expected):
            return f"it ends in {dict(left)}"
        return "" if left == expected else f"it leaves {dict(left)} in place of {expected}"

    supplies = tuple(tuple(together) for together in (first, rest) if together)
    return Part(
        places,
        steps,
        {place: machine.initial[place] for place in places if machine.initial[place]},
        supplies,
        frozenset(place for place in places if place in machine.failure_places),
        records & frozenset(places),
        machine.on_failure is OnFailure.CANCEL,
        is_proper,
        early if rest else frozenset(),
    )


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


__all__ = ["Proof", "Unsound", "explore", "verify"]
