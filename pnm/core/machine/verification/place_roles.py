"""Roles of places: does the net agree with what the machine says of its places, and begin as the proof takes it to begin?"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pnm.core.machine.machine import Accepts, AlreadyTrue, CallOutcome, Due, EffectsMissing, EffectsSeen, Ending, Ends, PetriNetMachine
from pnm.core.machine.verification.part import Part, Step, Unsound


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
    moving = machine.alive_places.union(machine.settling_places)
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
        if isinstance(guard, Accepts | Ends) and (len(inputs) != 1 or set(inputs.values()) != {1} or not part.records.isdisjoint(inputs)):
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


def check_causes(part: Part) -> None:
    """Check that no step of the plan fails or is left without a cause that a rule has found, or an outcome; and that outcomes are true.

    Raises:
        Unsound: something of that is not so.
    """
    for step in part.steps:
        if not _is_true(step):
            raise Unsound(f"{step.name} makes its call {step.outcome}, whatever has become of it")
    # Of loops and choices the run keeps no cause: what marks their failure finds it.
    others = [step for step in part.steps if step.call is None]
    for step in (*others, *_until(part, lambda step: step.finds_cause)):
        if not step.finds_cause and not part.failures.isdisjoint(step.outputs):
            raise Unsound(f"{step.name} marks a failure, and no rule has found its cause")
    for step in _until(part, lambda step: step.finds_cause or not (step.outcome is None or step.outcome in _NO_END)):
        if step.outcome is CallOutcome.PASSED_OVER:
            raise Unsound(f"{step.name} leaves a call that has not come to an end")


def _until(part: Part, settles: Callable[[Step], bool]) -> list[Step]:
    """Return the steps of calls that may happen, since their call was entered, before one that settles something or as that one."""
    happening = list[Step]()
    for call in dict.fromkeys(step.call for step in part.steps if step.call is not None):
        left = [step for step in part.steps if step.call == call]
        reached = set(part.initial).union(*part.supplies, *(step.outputs for step in left if step.outcome is CallOutcome.WAITING))
        while new := [step for step in left if step.inputs.keys() - part.records <= reached]:
            happening += new
            reached.update(*(step.outputs for step in new if not settles(step)))
            left = [step for step in left if step not in new]
    return happening


_NO_END = (CallOutcome.WAITING, CallOutcome.RUNNING, CallOutcome.SUSPENDED, CallOutcome.PASSED_OVER)
"""Outcomes after which something is still to come, or which a call has only if it has no other."""


def _is_true(step: Step) -> bool:
    """Return whether the outcome that the call has after the step is what has happened."""
    guard = step.guard
    match step.outcome:
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
