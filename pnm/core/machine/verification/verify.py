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
waits neither for other blocks nor for what it holds as long as it has them. So a call that has resources
comes to an end without the help of others, and a call that waits for some gets them in the end; unless a request that was given up
keeps them, and for that case every wait for resources has another way out.
"""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from math import isfinite
from typing import Final

from pnm.core.machine.machine import (
    Accepts,
    Adopted,
    ConditionTrue,
    Due,
    OnFailure,
    PetriNetMachine,
    TransitionAction,
    Withheld,
)
from pnm.core.machine.verification.block_shape import shape_of
from pnm.core.machine.verification.decompose import Anatomy, Event, step_of
from pnm.core.machine.verification.explore import Part, Unsound, explore_part
from pnm.core.machine.verification.plan_in_net import check_events, check_flows


@dataclass(frozen=True, eq=False, slots=True)
class _Proved:
    """A shape of blocks that was found good."""

    states: int
    """How many it has."""


_REMEMBERED: Final = 1000
_FOUND_GOOD: Final[dict[object, _Proved]] = {}
"""The shapes of blocks that were explored; the oldest is forgotten first."""


@dataclass(frozen=True, slots=True)
class Proof:
    """Proof of a machine: what was proved, and how much work it was."""

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
        Unsound: it is not, or not of the form that `pnm.core.machine` makes.
    """
    check_flows(machine)
    anatomy = Anatomy(machine)
    proved: set[_Proved] = set()
    waits: dict[Event, set[Event]] = {}
    for place, call in anatomy.machine.failure_places.items():
        if anatomy.writers[place] - {call}:
            raise Unsound(f"{place} marks the failure of another call than its own")
    for owner, names in anatomy.transitions.items():
        _check_rules(anatomy, owner, names)
        block = anatomy.block(owner)
        check_events(machine, block, names)
        anatomy.note_waits(block, waits)
        proved.add(_proved(block.part))
    try:
        TopologicalSorter(waits).prepare()
    except CycleError as error:
        raise Unsound(f"blocks wait for each other: {error.args[1]}") from error
    return Proof(len(machine.plan.calls), len(proved), sum(shape.states for shape in proved))


def _proved(part: Part) -> _Proved:
    """Prove a block, unless one of its shape was found good before: a task proves many machines of the same few shapes."""
    shape = shape_of(part)
    found = _FOUND_GOOD.get(shape)
    if found is None:
        for number, step in enumerate(part.steps):
            rest = {place: weight for place, weight in step.inputs.items() if place not in part.resources}
            if rest != step.inputs and not isinstance(step.guard, Adopted):
                before = part.steps[:number]
                if not any(isinstance(one.guard, Withheld) and isfinite(one.guard.seconds) and one.inputs == rest for one in before):
                    raise Unsound(f"{step.name} has no way out for when resources that it needs are withheld")
        found = _Proved(explore_part(part))
        if len(_FOUND_GOOD) == _REMEMBERED:
            _FOUND_GOOD.pop(next(iter(_FOUND_GOOD)))
        _FOUND_GOOD[shape] = found
    return found


def explore(machine: PetriNetMachine) -> int:
    """Walk through every state of a small machine and return their number.

    Raises:
        Unsound: some state is wrong, or there are more than `MAX_STATES`.
    """
    return explore_part(
        Part(
            places=machine.net.places,
            steps=tuple(step_of(machine, name) for name in machine.rules),
            initial=machine.initial,
            failures=frozenset(machine.failure_places),
            records=machine.record_places,
            counters=machine.counter_places,
            cancels=machine.on_failure is OnFailure.CANCEL,
            finals=frozenset((machine.goal_place, machine.failed_place)),
            restarts=frozenset(machine.restart_places),
            resources=frozenset(machine.resource_places),
        )
    )


# --- checks --------------------------------------------------------------------------------


def _check_rules(anatomy: Anatomy, call: int | None, names: list[str]) -> None:
    """Check that the rules of a block speak of its own call, and that requests and the goal are what they seem."""
    machine = anatomy.machine
    rules, net, goal = machine.rules, machine.net, machine.goal_place
    waiting = {place for name in names if isinstance(rules[name].guard, Accepts) for place in net.inputs[name]}
    for name in names:
        rule, outputs = rules[name], net.outputs[name]
        if getattr(rule.guard, "call", call) != call:
            raise Unsound(f"{name} listens to another call")
        if (rule.action is TransitionAction.SEND) is waiting.isdisjoint(outputs):
            raise Unsound(f"{name} does not send the request that is waited for, or sends one that is not")
        if isinstance(rule.guard, Due):
            for place in dict(rule.guard.since).keys() - net.inputs[name].keys():
                raise Unsound(f"{name} counts from the marking of {place}, which it does not take from")
        if goal in outputs and rule.guard != ConditionTrue(machine.plan.goal):
            raise Unsound(f"{name} marks the goal place without asking for the goal")
