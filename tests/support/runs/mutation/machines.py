"""Random small machines: every kind of step, ordering, recovery and limit. The same number is the same machine."""

from __future__ import annotations

from copy import copy
from dataclasses import fields, replace
from math import inf
from random import Random

from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import TRUE, Computed, Condition, Holds, Not
from pnm.core.logic.effects import Alternative, Effect
from pnm.core.machine.bindings import Binding, Bindings, WhenLost
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import MachineBlocks, OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import (
    EMPTY,
    ActionCall,
    Choice,
    Flow,
    GroundAction,
    Loop,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Step,
    Then,
)
from pnm.core.message_fields import Combined
from pnm.core.net.net import PetriNet

ASKED = Computed(Operation("eq", (Query(Literal('"code"'), Layer.PERSON), Literal("1"))))
"""A condition for which a person may have to be asked."""
CONDITIONS: tuple[Condition, ...] = (TRUE, TRUE, Holds(("powered",)), Not(Holds(("free",))), Holds(("free",)))


def random_plan(random: Random, effects: tuple[Effect, ...] = ()) -> PlanGraph:
    """Draw a plan of a few steps; if there are effects, its calls have some of them, and short limits now and then."""
    numbers = iter(range(100))
    shape = random.choice(["flat", "flat", "loop", "choice", "recovery", "restart"])

    def chain() -> Flow:
        return Flow((_call(random, next(numbers), effects),)) if random.random() < 0.7 else EMPTY

    outer = [_call(random, next(numbers), effects)]
    if shape in ("recovery", "restart"):  # what stands inside a call is numbered after it
        cause = random.choice([Cause.ABORTED, Cause.REJECTED, Cause.TIMED_OUT, Cause.EFFECTS_MISSING])
        then = Then.RESTART_PLAN if shape == "restart" else random.choice([Then.RETRY, Then.RETRY, Then.SKIP, Then.FAIL])
        recoveries, is_asked = list[Recovery](), random.random() < 0.5
        if not is_asked or random.random() < 0.5:
            recoveries.append(Recovery(frozenset({cause}), then, chain(), random.randint(1, 3)))
        if is_asked:
            cause, then = random.choice([Cause.BEFORE, Cause.AFTER]), random.choice([Then.RETRY, Then.SKIP, Then.SKIP, Then.REPLAN])
            recoveries.append(Recovery(frozenset({cause}), then, chain(), when=random.choice(CONDITIONS)))
        plain = ActionCall(0, GroundAction("a0"))  # now and then, so that there are calls which differ in nothing but recoveries
        outer = [replace(random.choice([outer[0], plain]), recoveries=tuple(recoveries))]
    outer += [_call(random, next(numbers), effects) for _ in range(random.randint(0, 2))]
    steps: list[Step] = [*outer]
    if shape == "loop":
        body = Flow((_call(random, next(numbers), effects),))
        steps.append(Loop(next(numbers), random.choice(CONDITIONS[2:]), body, random.randint(1, 3)))
    elif shape == "choice":
        branch = Flow((_call(random, next(numbers), effects),))
        steps.append(Choice(next(numbers), random.choice(CONDITIONS[2:]), branch, Flow()))
    moments = [*Moment]
    orderings: dict[tuple[PlanEvent, PlanEvent], Ordering] = {}
    for first in range(len(outer)):
        for second in range(first + 1, len(steps)):
            if random.random() < 0.6:
                plain = shape in ("recovery", "restart") and first == 0
                before = Moment.END if plain else random.choice(moments)
                after = Moment.START if plain or second >= len(outer) else random.choice(moments)
                events = PlanEvent(steps[first].index, before), PlanEvent(steps[second].index, after)
                delay = 1.0 if after is Moment.START and random.random() < 0.2 else 0.0
                orderings[events] = Ordering(*events, delay=delay)
    return PlanGraph(tuple(steps), tuple(orderings.values()), random.choice(CONDITIONS[:3]))


def with_calls_under_way(plan: PlanGraph, random: Random) -> PlanGraph:
    """The plan with some of the calls that wait for nothing under way."""
    waiting = {ordering.after for ordering in plan.orderings}

    def begun(step: Step) -> Step:
        is_free = isinstance(step, ActionCall) and not step.recoveries and PlanEvent(step.index, Moment.START) not in waiting
        return replace(step, under_way=random.random() < 0.2) if is_free else step  # type: ignore[arg-type]

    return replace(plan, steps=tuple(map(begun, plan.steps)))


def random_bindings(random: Random) -> Bindings:
    """Draw limits for the calls of a plan."""

    def binding() -> Binding:
        limits = {"accept": random.choice([2.0, 2.0, 2.0, 3.0]), "cancel": random.choice([1.0, 1.0, 1.0, 2.0])}
        lost = random.choice([WhenLost.REPLAN, WhenLost.REPLAN, WhenLost.REPLAN, WhenLost.ABORT])
        retries = random.choice([0, 1, 1, 3])
        return Binding(retries=retries, when_lost=lost, outcomes={"1": Combined("any")} if retries == 3 else {}, **limits)

    return Bindings({f"a{index}": binding() for index in range(10)}, lag=0.0)


def random_machine(number: int, *, under_way: bool = False) -> PetriNetMachine:
    """Make the machine of a random plan, some of whose calls may have been sent by another run."""
    random = Random(number)
    plan = random_plan(random)
    if under_way:
        plan = with_calls_under_way(plan, random)
    return generate(plan, random_bindings(random), on_failure=random.choice([*OnFailure]))


def _call(random: Random, index: int, effects: tuple[Effect, ...]) -> ActionCall:
    start, end = (tuple(effect for effect in effects if random.random() < 0.2) for _ in range(2))
    action = GroundAction(
        f"a{index}",
        precondition=random.choice(CONDITIONS),
        invariant=random.choice(CONDITIONS[:3]),
        expected=random.choice([TRUE, TRUE, TRUE, CONDITIONS[2], ASKED]),
        duration=random.choice([None, 3.0]),
        resources=("arm",) if random.random() < 0.3 else (),
        end_condition=random.choice(CONDITIONS) if effects else TRUE,
        start_effects=start,
        end_effects=end,
    )
    is_short = bool(effects) and random.random() < 0.5
    beside = copy(random)  # so that machines without several outcomes are drawn as if there were none
    if beside.random() < 0.2:
        ways = [tuple(effect for effect in effects if beside.random() < 0.3) for _ in range(beside.choice([1, 2]))]
        action = replace(action, outcomes=tuple([Alternative(way, name=str(number)) for number, way in enumerate((end, *ways), 1)]))
    return ActionCall(
        index,
        action,
        release=random.choice([0.0, 0.0, 0.0, 5.0]),
        latest_start=random.choice([inf, inf, inf, 3.0 if is_short else 50.0]),
        deadline=random.choice([inf, inf, inf, 4.0 if is_short else 60.0]),
        timeout=2.0 if is_short else None,
        retries=random.choice([None, None, None, 1]),
    )


def written_out(machine: PetriNetMachine) -> PetriNetMachine:
    """The same machine, with everything by name: made of no blocks."""
    return replace(machine)


def blocks_of(machine: PetriNetMachine) -> MachineBlocks:
    """The blocks of a machine as it was generated, to be changed behind its back."""
    assert machine.generated is not None
    return machine.generated


def as_text(machine: PetriNetMachine) -> list[str]:
    """All that there is of a machine but its plan and its bindings."""

    def text(found: object) -> str:
        match found:
            case PetriNet():
                arcs = ((name, dict(found.inputs[name]), dict(found.outputs[name])) for name in found.transitions)
                return str((list(found.places), list(arcs)))
            case _ if hasattr(found, "items"):
                return str([(name, repr(value)) for name, value in found.items()])
            case set() | frozenset() | _ if hasattr(found, "isdisjoint"):
                return str(sorted(found))  # type: ignore[call-overload]
            case tuple():
                return str([(one.owner, sorted(one.steps), [*one.first], [*one.last]) for one in found])
        return repr(found)

    return [text(getattr(machine, field.name)) for field in fields(machine) if field.name not in ("plan", "bindings", "generated")]
