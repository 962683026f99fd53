"""Roles of places: does the net agree with what the machine says of its places, and begin as the proof takes it to begin?"""

from __future__ import annotations

from collections.abc import Iterable

from pnm.core.machine.guards import AlreadyTrue, Due, EffectsMissing, EffectsSeen, Ending, Ends, Opener
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.requests import CallOutcome, TransitionAction
from pnm.core.machine.verification.part import Part, PartStep, Unsound


def check_roles(machine: PetriNetMachine) -> str:
    """Check that every place has one role, and that at first the beginning is marked, budgets and resources, and nothing else.

    Returns:
        The place where the machine begins.

    Raises:
        Unsound: something of that is not so.
    """
    roles: tuple[Iterable[str], ...] = (
        *((machine.goal_place,), (machine.failed_place,), machine.failure_places, machine.restart_places),
        *(machine.budget_places, machine.resource_places, machine.orderings, machine.border_places),
    )
    places = set[str]()
    for role in roles:
        if not places.isdisjoint(role):
            raise Unsound(f"{next(place for place in role if place in places)} has two roles")
        places.update(role)
    moving = frozenset(machine.alive_places).union(machine.settling_places)
    if not places.isdisjoint(moving):
        raise Unsound(f"{min(places & moving)} is no place of a call that is under way")
    if missing := (places | moving).difference(machine.net.places):
        raise Unsound(f"{min(missing)} is no place of the net")
    marked = [place for place in machine.initial if place not in machine.budget_places and place not in machine.resource_places]
    if len(marked) != 1 or machine.initial[marked[0]] != 1 or marked[0] in places or marked[0] in moving:
        raise Unsound(f"{', '.join(marked) or 'nothing'} is marked at first; expected one place without a role, and one token")
    return marked[0]


def check_steps(part: Part) -> None:
    """Check what the exploration of a part takes for granted about its steps.

    A report moves the one token of its call; what is marked as failed or as the end stays so; there is as much of every resource as
    any step takes; delays count from what is taken.

    Raises:
        Unsound: something of that is not so.
    """
    for step in part.steps:
        inputs, guard = step.inputs, step.guard
        if guard.opened_by is Opener.REPORT and (len(inputs) != 1 or set(inputs.values()) != {1} or not part.records.isdisjoint(inputs)):
            raise Unsound(f"{step.name} is opened by a report, and does not take just the one token of its call")
        if isinstance(guard, EffectsSeen) and not part.settling.issuperset(inputs):
            raise Unsound(f"{step.name} looks for effects at a place that is not said to be one for that")
        if isinstance(guard, Due) and not inputs.keys() >= dict(guard.since).keys():
            raise Unsound(f"{step.name} counts from the marking of {', '.join(dict(guard.since))}, which it does not take from")
        for place, weight in inputs.items():
            if place in part.failures or place in part.finals:
                raise Unsound(f"{step.name} takes from {place}, which stays as it is")
            if place in part.resources and weight > part.initial.get(place, 0):
                raise Unsound(f"{step.name} takes {weight} of {place}, and there is {part.initial.get(place, 0)}")


def check_outcomes(part: Part) -> None:
    """Check that the outcomes which calls get from steps are so whenever these happen.

    Raises:
        Unsound: one is not.
    """
    for step in part.steps:
        if not _outcome_is_so(step, part):
            raise Unsound(f"{step.name} makes its call {step.outcome}, whatever has become of it")


def _outcome_is_so(step: PartStep, part: Part) -> bool:
    """Return whether the outcome that the call has after the step is what has happened."""
    guard = step.guard
    match step.outcome:
        case CallOutcome.WAITING if step.call is not None:  # it is reached from outside, by nothing of its own
            return not any(step.call == other.call and not step.inputs.keys().isdisjoint(other.outputs) for other in part.steps)
        case CallOutcome.RUNNING:
            return step.action is TransitionAction.SEND
        case CallOutcome.SKIPPED:
            return isinstance(guard, Ending)
        case CallOutcome.ALREADY_TRUE:
            return isinstance(guard, AlreadyTrue)
        case CallOutcome.SUCCEEDED:
            return isinstance(guard, EffectsSeen)
        case CallOutcome.CANCELED:
            return isinstance(guard, Ends | EffectsMissing)
        case CallOutcome.UNCONFIRMED:
            return step.gives_up
        case CallOutcome.FAILED | CallOutcome.HANDED_OVER:
            return False
        case _:
            return True
