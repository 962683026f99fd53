"""Random small machines: every kind of step, ordering, recovery and limit. The same number is the same machine."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from pnm.core.logic.conditions import TRUE, Condition, Holds, Not
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.blocks import MachineBlocks, built_from
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import (
    ActionCall,
    Cause,
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
from pnm.core.net.net import PetriNet

CONDITIONS: tuple[Condition, ...] = (TRUE, TRUE, Holds(("powered",)), Not(Holds(("free",))), Holds(("free",)))


def random_plan(random: Random) -> PlanGraph:
    """Draw a plan of a few steps."""
    numbers = iter(range(100))
    shape = random.choice(["flat", "flat", "loop", "choice", "recovery"])
    outer = [_call(random, next(numbers))]
    if shape == "recovery":  # what stands inside a call is numbered after it
        causes = frozenset({random.choice([Cause.ABORTED, Cause.REJECTED, Cause.TIMED_OUT, Cause.EFFECTS_MISSING])})
        then = random.choice([Then.RETRY, Then.RETRY, Then.SKIP, Then.FAIL])
        recovery = Recovery(causes, then, Flow((_call(random, next(numbers)),)), random.randint(1, 3))
        outer = [replace(outer[0], recoveries=(recovery,))]
    outer += [_call(random, next(numbers)) for _ in range(random.randint(0, 2))]
    steps: list[Step] = [*outer]
    if shape == "loop":
        body = Flow((_call(random, next(numbers)),))
        steps.append(Loop(next(numbers), random.choice(CONDITIONS[2:]), body, random.randint(1, 3)))
    elif shape == "choice":
        branch = Flow((_call(random, next(numbers)),))
        steps.append(Choice(next(numbers), random.choice(CONDITIONS[2:]), branch, Flow()))
    moments = [*Moment]
    orderings: dict[tuple[PlanEvent, PlanEvent], Ordering] = {}
    for first in range(len(outer)):
        for second in range(first + 1, len(steps)):
            if random.random() < 0.6:
                plain = shape == "recovery" and first == 0
                before = Moment.END if plain else random.choice(moments)
                after = Moment.START if plain or second >= len(outer) else random.choice(moments)
                events = PlanEvent(steps[first].index, before), PlanEvent(steps[second].index, after)
                delay = 1.0 if after is Moment.START and random.random() < 0.2 else 0.0
                orderings[events] = Ordering(*events, delay=delay)
    return PlanGraph(tuple(steps), tuple(orderings.values()), random.choice(CONDITIONS[:3]))


def random_machine(number: int) -> PetriNetMachine:
    """Make the machine of a random plan."""
    random = Random(number)
    plan = random_plan(random)
    bindings = Bindings({f"a{index}": Binding(retries=random.choice([0, 1, 3]), accept=2.0, cancel=1.0) for index in range(10)}, lag=0.0)
    return generate(plan, bindings, on_failure=random.choice([*OnFailure]))


def _call(random: Random, index: int) -> ActionCall:
    action = GroundAction(
        f"a{index}",
        precondition=random.choice(CONDITIONS),
        invariant=random.choice(CONDITIONS[:3]),
        duration=random.choice([None, 3.0]),
        resources=("arm",) if random.random() < 0.3 else (),
    )
    return ActionCall(index, action, release=random.choice([0.0, 0.0, 5.0]), deadline=random.choice([float("inf"), float("inf"), 60.0]))


def written_out(machine: PetriNetMachine) -> PetriNetMachine:
    """The same machine, with everything by name: made of no blocks."""
    net = machine.net
    arcs = ({name: dict(weights) for name, weights in found.items()} for found in (net.inputs, net.outputs))
    return replace(machine, net=PetriNet(tuple(net.places), *arcs), rules=dict(machine.rules))


def blocks_of(machine: PetriNetMachine) -> MachineBlocks:
    """The blocks of a machine as it was generated, to be changed behind its back."""
    found = built_from(machine)
    assert found is not None
    return found
