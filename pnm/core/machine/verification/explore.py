"""A walk through every state that a part of a machine can reach: what goes wrong in one of them, and which transitions never fire."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Set
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine.guards import Accepts, Ends, PauseAsked
from pnm.core.machine.requests import BEFORE_ACCEPTANCE
from pnm.core.machine.verification.block_shape import without_twins
from pnm.core.machine.verification.moves import AGAIN, FROM_OUTSIDE, Moves, PartState
from pnm.core.machine.verification.part import Inside, Part, PartStep, Unsound
from pnm.core.machine.verification.place_roles import check_outcomes, check_steps
from pnm.core.machine.verification.state_faults import StateFaults

MAX_STATES: Final = 2_000_000

_Trace: TypeAlias = "tuple[_Trace, str] | None"
"""Trace to a state: the last step, and the trace before it."""
_Reached: TypeAlias = tuple[PartState, _Trace]


@dataclass(frozen=True, slots=True)
class Exploration:
    """The findings in all states of a part."""

    states: int
    """The number of states."""
    unfired: tuple[int, ...]
    """The numbers of the steps that never happen."""


def explore_part(part: Part) -> Exploration:
    """Walk through every state of the part.

    Raises:
        Unsound: some state is wrong, something can go round for ever, or there are too many states.
    """
    if confusing := [step.name for step in part.steps if step.name in FROM_OUTSIDE]:
        raise Unsound(f"a step is called {confusing[0]!r}, as is what happens from outside")
    check_steps(part)
    check_outcomes(part)
    moves = Moves(without_twins(part))
    faults = StateFaults(moves)
    # Pauses and entries come from outside, as often as they like: what follows from there is walked through apart. A cycle through
    # them is no error: pauses are assumed to be finitely many, and entries are counted by whatever holds the block. So is what is
    # counted: `successors` makes sure that it comes to an end.
    apart = {step.name for step in part.steps if isinstance(step.guard, PauseAsked) or step.counted} | {AGAIN}
    roots: list[_Reached] = [(moves.start(), None)]
    seen: set[PartState] = set()
    while roots:
        root = roots.pop()
        if root[0] not in seen:
            roots += _walk(moves, faults, root, seen, apart)
    return Exploration(len(seen), tuple(number for number in range(len(part.steps)) if number not in moves.fired))


def _walk(moves: Moves, faults: StateFaults, root: _Reached, seen: set[PartState], apart: Set[str]) -> list[_Reached]:
    """Walk through every state that is reached from the root but by some steps; return what those lead to."""
    # An explicit stack: plans may be deeper than Python's recursion limit.
    path: list[tuple[_Reached, Iterator[tuple[str, PartState]]]] = []
    on_path: set[PartState] = set()
    left: dict[PartState, _Reached] = {}

    def enter(reached: _Reached) -> None:
        state, trace = reached
        possible = moves.possible(state)
        stuck = moves.is_stuck(state, possible)
        try:
            nexts = list(moves.successors(state, possible, stuck))
        except Unsound as error:
            raise Unsound(str(error), _names(trace)) from error
        if wrong := faults.of(state, possible, stuck=stuck):
            raise Unsound(wrong, _names(trace))
        if len(seen) > MAX_STATES:
            raise Unsound(f"more than {MAX_STATES} states")
        seen.add(state)
        on_path.add(state)
        path.append((reached, iter(nexts)))

    enter(root)
    while path:
        (state, trace), nexts = path[-1]
        successor = next(nexts, None)
        if successor is None:
            path.pop()
            on_path.remove(state)
            continue
        name, following = successor
        if name in apart:
            if following not in seen:
                left.setdefault(following, (following, (trace, name)))
        # A state on the current path is a cycle that the machine goes through without help from outside: it would not terminate.
        elif following in on_path:
            raise Unsound("it can go round for ever", _names((trace, name)))
        elif following not in seen:
            enter((following, (trace, name)))
    return list(left.values())


def _names(trace: _Trace) -> list[str]:
    names: list[str] = []
    while trace is not None:
        trace, name = trace
        names.append(name)
    return names[::-1]


class NeverFires(NamedTuple):
    """A transition that can never fire, and the reason."""

    transition: str
    reason: str

    def __str__(self) -> str:
        return f"{self.transition}: {self.reason}"


def never_fire(part: Part, explored: Exploration) -> list[NeverFires]:
    """Return the transitions of the part that never fire."""
    if not explored.unfired:
        return []
    unfired = {part.steps[number].name for number in explored.unfired}
    marked = {place for together in part.supplies for place in together}.union(part.initial)
    marked.update(place for step in part.steps if step.name not in unfired for place in step.outputs)
    steps = (part.steps[number] for number in explored.unfired)
    return [NeverFires(step.name, _reason(part, step, marked)) for step in steps if not isinstance(step.guard, Inside)]


def _reason(part: Part, step: PartStep, marked: Collection[str]) -> str:
    if unmarked := [place for place in step.inputs if place not in marked]:
        return f"nothing marks {unmarked[0]}"
    if isinstance(step.guard, Ends) and step.guard.kinds.isdisjoint(BEFORE_ACCEPTANCE):
        for other in part.steps:
            if isinstance(other.guard, Accepts) and other.inputs.keys() == step.inputs.keys():
                return f"such an end implies that the request was accepted, and {other.name} goes first"
    before = part.steps[: part.steps.index(step)]
    earlier = [other.name for other in before if not other.inputs.keys().isdisjoint(step.inputs)]
    return f"where it could, one before it goes first ({', '.join(earlier)})" if earlier else "its places are never marked together"
