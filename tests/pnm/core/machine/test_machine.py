"""Machines are sound: explored when small, and proved block by block at any size; that blocks share templates makes no difference."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from random import Random
from typing import get_args

import pytest
from hypothesis import given, settings, strategies as st

from pnm.core.execution.guards import OPENS
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.call_block import CallTerms
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import (
    Accepts,
    After,
    Always,
    ConditionFalse,
    Due,
    EffectsMissing,
    Ends,
    Guard,
    GuardKind,
    OfCall,
    PauseAsked,
    Withheld,
)
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import EMPTY, ActionCall, Flow, GroundAction, PlanGraph, PlanGraphError, Recovery, Then
from pnm.core.machine.requests import OutcomeKind, TransitionAction
from pnm.core.machine.verification.explore import explore_part
from pnm.core.machine.verification.part import Part, PartStep, Unsound, shape_of
from pnm.core.machine.verification.verify import explore, verify
from pnm.core.net.net import PetriNet
from tests.support.runs.mutation.block_edits import BLOCK_EDITS, Edit
from tests.support.runs.mutation.changes import with_input, with_rule, without_transition
from tests.support.runs.mutation.forgotten import alone, forgetting
from tests.support.runs.mutation.gate import check_proof_of_mutants
from tests.support.runs.mutation.machines import as_text, blocks_of, random_machine, written_out
from tests.support.runs.plan_graphs import plan, plan_of, plans

SHAPES = {
    "empty": plan(0),
    "one call": plan(1),
    "one call with an over-all condition": plan(1, invariants=True),
    "side by side": plan(2),
    "chain": plan(2, "0e<1s"),
    "fork": plan(3, "0e<1s", "0e<2s"),
    "join": plan(3, "0e<2s", "1e<2s"),
    "start before start": plan(2, "0s<1s"),
    "start before end": plan(2, "0s<1e"),
    "end before end": plan(2, "0e<1e"),
    "inside": plan(2, "0s<1s", "1e<0e", invariants=True),
    "crossing": plan(2, "0s<1s", "0e<1e"),
    "chain inside": plan(3, "0s<1s", "1e<2s", "2e<0e"),
    "like an N": plan(4, "0e<2s", "0e<3s", "1e<3s"),
}


def bindings(retries: int) -> Bindings:
    return Bindings({f"a{index}": Binding(retries=retries) for index in range(10)})


@pytest.mark.parametrize(("retries", "on_failure"), [(2, OnFailure.DRAIN), (1, OnFailure.CANCEL)])
@pytest.mark.parametrize("name", SHAPES)
def test_every_answer_of_the_world_leads_to_goal_or_failed(name: str, retries: int, on_failure: OnFailure) -> None:
    possible = retries if len(SHAPES[name].calls) < 3 else 0  # with more, there would be too many states
    machine = generate(SHAPES[name], bindings(possible), on_failure=on_failure)
    explore(machine)
    verify(machine)


@pytest.mark.timeout(900)
@settings(max_examples=15)
@given(plans(most=2), st.integers(0, 1), st.sampled_from(OnFailure))
def test_any_partial_order_of_events_is_sound(graph: PlanGraph, retries: int, on_failure: OnFailure) -> None:
    machine = generate(graph, bindings(retries), on_failure=on_failure)
    explore(machine)
    verify(machine)


@pytest.mark.parametrize(("name", "retries"), [("one call with an over-all condition", 1), ("chain", 0)])
def test_the_block_proof_accepts_no_machine_that_the_state_space_refutes(name: str, retries: int) -> None:
    check_proof_of_mutants(generate(SHAPES[name], bindings(retries)))


@pytest.mark.parametrize("name", ["timed_out", "unconfirmed", "unconfirmed_stop", "unanswered", "unheard"])
def test_a_wait_without_a_limit_is_refuted(name: str) -> None:
    machine = generate(SHAPES["chain"])
    with pytest.raises(Unsound, match="no exit that is sure to open in finite time"):
        verify(without_transition(machine, f"a1()#1 {name}"))
    with pytest.raises(Unsound, match="no exit that is sure to open in finite time"):
        verify(with_rule(machine, f"a1()#1 {name}", guard=After(float("inf"))))
    net = PetriNet((*machine.net.places, "never"), machine.net.inputs, machine.net.outputs)
    never = with_input(replace(machine, net=net), f"a1()#1 {name}", "never")
    for proof in (verify, explore):
        with pytest.raises(Unsound, match="no exit that is sure to open in finite time"):
            proof(never)


def test_rules_that_are_not_what_they_seem_are_refuted() -> None:
    machine = generate(SHAPES["chain"])
    for broken, why in (
        (with_rule(machine, "a0()#0 start", action=None, outcome=None), "is about a request, and none is alive"),
        (with_rule(machine, "a0()#0 retry", action=TransitionAction.SEND), "sends a request|none is alive|nothing takes|no place"),
        (with_rule(machine, "a0()#0 accepted", guard=Accepts(1)), "listens to another call"),
        (with_rule(machine, "goal_holds", guard=Always()), "without asking for the goal"),
        (with_rule(machine, "a0()#0 timed_out", guard=Due(1.0, (("start", 1.0),))), "counts from the marking of start"),
        (replace(machine, failure_places=dict.fromkeys(machine.failure_places, 0)), "marks the failure of another call"),
    ):
        with pytest.raises(Unsound, match=why):
            verify(broken)


def test_a_channel_that_closes_a_cycle_is_refuted() -> None:
    machine = generate(SHAPES["chain"])
    net = PetriNet(
        (*machine.net.places, "hidden"),
        {**machine.net.inputs, "a0()#0 join": {**machine.net.inputs["a0()#0 join"], "hidden": 1}},
        {**machine.net.outputs, "a1()#1 fork": {**machine.net.outputs["a1()#1 fork"], "hidden": 1}},
    )
    with pytest.raises(Unsound, match="wait for each other"):
        verify(replace(machine, net=net))


def test_who_waits_for_what_is_withheld_has_a_limit() -> None:
    machine = generate(plan_of(GroundAction("act", resources=("arm",))))
    verify(machine)
    name = "act()#0 withheld before start"
    for broken in (without_transition(machine, name), with_rule(machine, name, guard=Withheld(0, float("inf"), TransitionAction.SEND))):
        with pytest.raises(Unsound, match=r"act\(\)#0 start has no way out"):
            verify(broken)


def test_two_final_places_are_not_one() -> None:
    one = ending_in("goal")
    other = ending_in("goal", "failed")
    explore_part(one)
    with pytest.raises(Unsound, match="it ends in"):
        explore_part(other)
    assert shape_of(one) != shape_of(other)


@pytest.mark.parametrize("guard", [PauseAsked(), Accepts(0), ConditionFalse(TRUE), EffectsMissing(0), Withheld(0, 1.0, None)])
def test_what_nobody_may_ever_do_is_no_exit(guard: Guard) -> None:
    with pytest.raises(Unsound, match="start has no exit"):
        explore_part(ending_in("goal", guard=guard))


def ending_in(*finals: str, guard: Guard = Always()) -> Part:
    """A part that ends in these places, all at once."""
    step = PartStep("end", guard, {"start": 1}, dict.fromkeys(finals, 1))
    return Part(places=("start", *finals), steps=(step,), initial={"start": 1}, finals=frozenset(finals))


def test_orderings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(PlanGraphError, match="cycle"):
        plan(2, "0e<1s", "1e<0s")


# --- blocks: the proof looks at every one, although they share templates ---


def test_a_machine_is_the_same_if_no_block_shares_its_template() -> None:
    with forgetting(""):  # the more machines were made before, the more templates are shared
        for number in range(30):
            assert as_text(random_machine(number, under_way=True)) == alone(number)


@given(st.integers(0, 10_000))
def test_arcs_by_number_are_those_by_name(number: int) -> None:
    machine = random_machine(number)
    by_blocks, by_name = machine.placed, written_out(machine).placed
    assert (len(by_name.placed), by_name.regions) == (1, [])
    for transition in range(len(machine.net.transitions)):
        assert by_blocks.inputs[transition] == by_name.inputs[transition]
        assert by_blocks.outputs[transition] == by_name.outputs[transition]
    for place in range(len(machine.net.places)):
        assert by_blocks.consumers[place] == by_name.consumers[place]
    assert by_blocks.unmarked == by_name.unmarked
    assert by_blocks.counted == by_name.counted


@pytest.mark.parametrize("number", range(12))
def test_the_proof_of_a_sample_is_that_of_the_whole(number: int) -> None:
    machine = random_machine(number)
    assert written_out(machine).generated is None
    assert verify(machine) == verify(written_out(machine)) == verify(machine)  # and again, with what is known of its calls by then


@pytest.mark.parametrize(
    ("limit", "wrong", "why"),
    [
        ("timeout", inf, r"a2\(\)#2 running has no exit that is sure to open in finite time"),
        ("release", 1.0, r"a2\(\)#2 join does not wait for the times"),
    ],
)
def test_what_a_call_itself_says_is_looked_at_for_each(limit: str, wrong: float, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = plan(4)
    machine = generate(replace(graph, steps=tuple(replace(call, release=5.0 + call.index) for call in graph.calls)))
    verify(machine)
    right = getattr(CallTerms, limit).fget
    monkeypatch.setattr(CallTerms, limit, property(lambda call: wrong if call.step.index == 2 else right(call)))
    with pytest.raises(Unsound, match=why):
        verify(machine)


@pytest.mark.parametrize("edit", BLOCK_EDITS, ids=lambda edit: edit.__name__)
def test_blocks_that_were_changed_are_unsound_or_prove_as_the_machine_that_they_make(edit: Edit) -> None:
    refused = 0
    for number in range(25):
        machine, random = random_machine(number), Random(number)
        try:
            edit(blocks_of(machine), random)
        except IndexError:  # there is nothing of that to be changed
            continue
        try:
            verify(machine)
        except Unsound:
            refused += 1
        else:
            verify(written_out(machine))
    assert refused > 3


def test_steps_that_a_call_holds_are_those_of_its_own_recoveries() -> None:
    def call(number: int, *chains: Flow) -> ActionCall:
        causes = Cause.ABORTED, Cause.REJECTED, Cause.LOST
        recoveries = (Recovery(frozenset({cause}), Then.RETRY, chain) for cause, chain in zip(causes, chains, strict=False))
        return ActionCall(number, GroundAction("act"), recoveries=tuple(recoveries))

    calls = [call(first, EMPTY, Flow((call(first + 1),)), Flow((call(first + 2),))) for first in (0, 3, 6)]
    for wrong in range(4):
        machine = generate(PlanGraph(tuple(calls)))
        blocks = blocks_of(machine)
        own = {id(block.template) for block in blocks.placed if block.step in calls}
        assert len(own) == 1, "alike calls share their template, whatever their recoveries hold"
        number = next(number for number, block in enumerate(blocks.placed) if block.step is calls[2])
        (*ports, a, b, c, d, e, f), regions = blocks.placed[number].ports, blocks.regions
        mixed = [(a, b, c, d, e, f), (a, b, e, f, c, d), (a, b, e, f, c, d), (c, d, a, b, e, f)][wrong]
        blocks.placed[number] = replace(blocks.placed[number], ports=(*ports, *mixed))
        if wrong == 2:
            regions[-1], regions[-2] = regions[-2], regions[-1]
        if wrong == 3:  # also the order of the regions is changed, and that of those with steps is not
            regions[-2], regions[-3] = regions[-3], regions[-2]
        if wrong:
            with pytest.raises(Unsound, match=["", "is not around", "not those of the regions", "the rule of its recoveries"][wrong]):
                verify(machine)
        else:
            assert verify(machine) == verify(written_out(machine))


# --- guards: every kind has all of its traits, and every part of the program knows it ---


KINDS: tuple[type[GuardKind], ...] = get_args(Guard)
TRAITS = list(GuardKind.__annotations__)
SAMPLES: list[Guard] = [
    *(kind(7) for kind in KINDS if issubclass(kind, OfCall) and kind not in (Ends, Withheld)),  # type: ignore[call-arg, misc]
    Ends(7, frozenset({OutcomeKind.LOST})),
    Withheld(7, 2.0, None),
]


def test_each_kind_says_what_opens_it_and_what_it_reads() -> None:
    assert set(OPENS) == set(KINDS), "pnm.core.execution.guards.OPENS says when each kind opens"
    assert not [(kind.__name__, name) for kind in KINDS for name in TRAITS if not hasattr(kind, name)]


@pytest.mark.parametrize("guard", SAMPLES)
def test_about_another_call_a_guard_is_otherwise_the_same(guard: Guard) -> None:
    other = guard.about(3)
    assert isinstance(other, OfCall)
    assert other.call == 3
    assert other.about(7) == guard
    assert other.proved == guard.proved
