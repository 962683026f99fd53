"""The proof looks at what each call asks, watches, holds and counts, and at what orderings say, whatever the blocks were made by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest

from pnm.core.logic.conditions import TRUE, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause, Phase
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import After, Always, ConditionFalse, ConditionTrue, Guard, InvariantFalse
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import EMPTY, ActionCall, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.verification.call_content import WATCHES, AskedOf, traits
from pnm.core.machine.verification.part import CallRule, Unsound
from pnm.core.machine.verification.verify import net_of, verify
from pnm.core.net.net import Marking, PetriNet, Weights
from tests.support.runs.mutation.changes import with_output, with_outputs, with_rule, without_output, without_place, without_transition
from tests.support.runs.mutation.forgotten import TRAITS, run_forgotten
from tests.support.runs.mutation.machines import written_out
from tests.support.runs.plan_graphs import ordering, plan

OK, WET = Holds(("ok",)), Holds(("wet",))


def call(index: int, **limits: float) -> ActionCall:
    effects = (Set((f"done{index}",), Constant(True)),)
    action = GroundAction(f"a{index}", precondition=OK, invariant=OK, duration=3.0, resources=("arm",), end_effects=effects)
    return ActionCall(index, action, **limits)  # type: ignore[arg-type]


MACHINE = generate(PlanGraph((call(0, deadline=20.0), call(1))), Bindings({"a0": Binding(retries=1)}))


def guarded(**guards: Guard) -> PetriNetMachine:
    machine = MACHINE
    for name, guard in guards.items():
        machine = with_rule(machine, f"a0()#0 {name}", guard=guard)
    return machine


def without(*names: str) -> PetriNetMachine:
    machine = MACHINE
    for name in names:
        machine = without_transition(machine, f"a0()#0 {name}")
    return machine


def without_the_arm() -> PetriNetMachine:
    machine = without("withheld before start")
    arm = machine.resource_places

    def cut(every: Mapping[str, Weights]) -> dict[str, Weights]:
        return {name: {place: weight for place, weight in of.items() if name[:2] != "a0" or place not in arm} for name, of in every.items()}

    return replace(machine, net=PetriNet(machine.net.places, cut(machine.net.inputs), cut(machine.net.outputs)))


def tried_seven_times() -> PetriNetMachine:
    net, give_up = MACHINE.net, "a0()#0 give_up"
    inputs = {**net.inputs, give_up: {place: 7 if "spent" in place else weight for place, weight in net.inputs[give_up].items()}}
    initial = Marking({place: 7 if place == "a0()#0 budget" else tokens for place, tokens in MACHINE.initial.items()})
    return replace(MACHINE, net=PetriNet(net.places, inputs, net.outputs), initial=initial)


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (lambda: guarded(start=ConditionTrue(TRUE), precondition_false=ConditionFalse(TRUE)), CallRule.PRECONDITION),
        (lambda: guarded(start=ConditionTrue(WET), precondition_false=ConditionFalse(WET)), CallRule.PRECONDITION),
        (lambda: guarded(invariant_false=InvariantFalse(WET)), CallRule.OVER_ALL),
        (lambda: without("invariant_false"), CallRule.OVER_ALL),
        (lambda: without("deadline_missed"), CallRule.DEADLINE),
        (lambda: without("too_late"), CallRule.LATEST_START),
        (lambda: without("data_missing"), CallRule.DATA),
        (lambda: without("already_true"), CallRule.ALREADY_TRUE),
        (lambda: guarded(timed_out=After(1e9)), CallRule.TIME_LIMIT),
        (lambda: guarded(unanswered=After(1e9)), CallRule.ANSWER),
        (lambda: guarded(unconfirmed=After(1e9)), CallRule.CANCELLING),
        (without_the_arm, CallRule.RESOURCES),
        (tried_seven_times, CallRule.RETRIES),
        (lambda: replace(MACHINE, bindings=Bindings({"a0": Binding(retries=1, accept=3.0)})), CallRule.ANSWER),
        (lambda: replace(MACHINE, plan=replace(MACHINE.plan, steps=(call(0, deadline=21.0), call(1)))), CallRule.LATEST_START),
    ],
)
def test_a_call_that_is_not_what_is_asked_is_refused_by_name(broken: Callable[[], PetriNetMachine], rule: CallRule) -> None:
    verify(MACHINE)
    with pytest.raises(Unsound, match=rf"^a0\(\)#0 does not keep the rule of its {rule.value}: ") as refused:
        verify(broken())
    assert refused.value.rule is rule


def test_every_rule_is_looked_at() -> None:
    net = net_of(MACHINE, 0, [name for name, rule in MACHINE.rules.items() if rule.call == 0])
    compared = traits(net, AskedOf(MACHINE)(MACHINE.plan.calls[0]))
    assert {*CallRule} == {*(watch.rule for watch in WATCHES), *(rule for rule, *_ in compared)}


@pytest.mark.parametrize("trait", TRAITS)
def test_a_trait_that_templates_forget_is_missed_by_the_proof(trait: str) -> None:
    report = run_forgotten(trait, range(1000), enough=1)
    assert report.complaints == []
    assert report.wrong == 1


@pytest.mark.parametrize("cause", [cause for cause in Cause if isinstance(cause.phase, Phase)])
def test_a_call_may_have_recoveries_for_any_cause_of_its_own(cause: Cause) -> None:
    recovery = Recovery(frozenset({cause}), Then.RETRY, EMPTY, when=OK)
    machine = generate(PlanGraph((replace(call(0), recoveries=(recovery,)), call(1))))
    verify(machine)
    verify(written_out(machine))


def test_a_call_that_is_not_tried_again_where_it_might_be_is_refused() -> None:
    outputs = {**MACHINE.net.outputs, "a0()#0 aborted": MACHINE.net.outputs["a0()#0 aborted_for_good"]}
    with pytest.raises(Unsound, match=r"^a0\(\)#0 does not keep the rule of its recoveries: "):
        verify(replace(MACHINE, net=PetriNet(MACHINE.net.places, MACHINE.net.inputs, outputs)))


def test_a_recovery_that_leads_to_itself_is_refused() -> None:
    recovery = Recovery(frozenset({Cause.ABORTED}), Then.RETRY, Flow((call(1),)), times=2)
    machine = generate(PlanGraph((replace(call(0), recoveries=(recovery,)),)))
    verify(machine)
    with pytest.raises(Unsound, match="not of the form that a machine has"):
        verify(with_outputs(machine, "a0()#0 retry 0", {"a0()#0 recovering 0": 1}))


# --- orderings: what they say is looked for in the net ---


KINDS = ["0e<1s", "0s<1s", "0e<1e", "0s<1e"]


@pytest.mark.parametrize("kind", KINDS)
def test_an_ordering_whose_place_is_cut_out_is_missed(kind: str) -> None:
    machine = generate(plan(3, kind, "0e<2s", "1e<2s"))
    verify(machine)
    place = next(place for place, one in machine.orderings.items() if one == ordering(kind))
    with pytest.raises(Unsound, match="no place keeps"):
        verify(without_place(machine, place))


def test_the_machine_of_another_plan_is_refused() -> None:
    machine = generate(plan(2))
    with pytest.raises(Unsound, match="no place keeps end of #0 < start of #1"):
        verify(replace(machine, plan=plan(2, "0e<1s")))
    with pytest.raises(Unsound, match="does not ask for"):
        verify(replace(generate(plan(2, "0e<1s")), plan=plan(2)))
    with pytest.raises(Unsound, match="not those of a region"):
        verify(replace(machine, plan=plan(1)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("claimed", KINDS)
def test_a_place_that_is_taken_for_another_ordering_is_refused(kind: str, claimed: str) -> None:
    machine = generate(plan(2, kind))
    (place,) = machine.orderings
    other = replace(machine, plan=plan(2, claimed), orderings={place: ordering(claimed)})
    is_weaker = (kind[1], claimed[1]) == ("e", "s") and kind[-1] == claimed[-1]  # what waits for an end has waited for the start
    if kind == claimed:
        verify(other)
    elif not is_weaker:
        with pytest.raises(Unsound):
            verify(other)


def test_a_start_that_is_announced_before_the_request_is_refused() -> None:
    machine = generate(plan(2, "0s<1s"))
    (place,) = machine.orderings
    with pytest.raises(Unsound):
        verify(with_output(without_output(machine, "a0()#0 accepted", place), "a0()#0 start", place))


@pytest.mark.parametrize("delay", [0.0, 2.0])
def test_a_time_that_is_not_waited_for_is_missed(delay: float) -> None:
    first, second = plan(2).calls
    released = replace(second, release=0.0 if delay else 5.0)
    graph = replace(plan(2), steps=(first, released), orderings=(replace(ordering("0s<1s"), delay=delay),))
    machine = generate(graph)
    verify(machine)
    with pytest.raises(Unsound, match="does not wait for the times"):
        verify(with_rule(machine, "a1()#1 join", guard=Always()))
