"""The proof is of what is executed: machines that would hang, or be over too soon, or mix up requests, are refused in both ways."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import Always, ConditionFalse, ConditionTrue, DataMissing, Rule
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Choice, Flow, GroundAction, Loop, PlanGraph, PlanGraphError, Recovery, Then
from pnm.core.machine.requests import CallOutcome, TransitionAction
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, forget_proofs, verify
from pnm.core.net.net import Marking, PetriNet
from pnm.core.resources import CapacityError, Resources
from pnm.errors import InputError
from tests.support.runs.mutation.changes import (
    with_input,
    with_inputs,
    with_output,
    with_outputs,
    with_rule,
    without_output,
    without_place,
    without_transition,
)
from tests.support.runs.plan_graphs import plan, plan_of, plan_of_steps

ARM = generate(plan_of(GroundAction("a0", resources=("arm",))))
CHAIN = generate(plan(2, "0e<1s"))
A0, HELP = ActionCall(0, GroundAction("a0")), Flow((ActionCall(1, GroundAction("help")),))
SPARED = generate(plan_of_steps(replace(A0, recoveries=(Recovery(frozenset({Cause.ABORTED}), Then.SKIP, HELP),))))
CHOICE = generate(plan_of_steps(Choice(1, Holds(("free",)), Flow((A0,)), Flow())))
LOOP = generate(plan_of_steps(Loop(1, Holds(("free",)), Flow((A0,)), 2)))
COUNTING = generate(plan_of_steps(replace(A0, retries=3, recoveries=(Recovery(frozenset({Cause.REJECTED}), Then.RETRY, HELP, times=5),))))


def marked(machine: PetriNetMachine, **tokens: int) -> PetriNetMachine:
    named = {name.replace("_", " ") if name.startswith("resource") else name: count for name, count in tokens.items()}
    return replace(machine, initial=Marking({**machine.initial, **named}))


def one_place_more(machine: PetriNetMachine) -> PetriNetMachine:
    return replace(machine, net=PetriNet((*machine.net.places, "elsewhere"), machine.net.inputs, machine.net.outputs))


UNSOUND: dict[str, tuple[PetriNetMachine, str]] = {
    "a resource without a token": (marked(ARM, resource_arm=0), "and there is 0"),
    "a token outside": (marked(one_place_more(CHAIN), elsewhere=1), "marked at first"),
    "a token in a final place": (marked(CHAIN, goal=1), "marked at first"),
    "a failure place that is marked at first": (marked(CHAIN, **{"a0()#0 failed": 1}), "marked at first"),
    "an end that nothing waits for": (
        without_place(generate(plan(2, "0e<1e")), next(iter(generate(plan(2, "0e<1e")).orderings))),
        "no place keeps|nothing waits for the end of step 0|goal is marked although|failed is marked although",
    ),
    "a report without input": (with_inputs(CHAIN, "a0()#0 withdrawn", {}), "does not take just the one token of its call"),
    "a report with two inputs": (with_input(CHAIN, "a0()#0 succeeded", "a0()#0 ready"), "does not take just the one token of its call"),
    "a place that is goal and budget": (replace(CHAIN, budget_places=CHAIN.budget_places | {"goal"}), "two roles"),
    "a place that is failure and resource": (replace(CHAIN, resource_places={"a0()#0 failed": "arm"}), "two roles"),
    "a goal after a failure": (without_transition(CHAIN, "ended_by_failure"), "goal is marked although the run is ending"),
    "a goal that is marked early": (
        with_rule(with_output(CHAIN, "a0()#0 start", "goal"), "a0()#0 start", guard=ConditionTrue(CHAIN.plan.goal)),
        "goal",
    ),
    "a request that is sent while ending": (without_transition(CHAIN, "a0()#0 skip"), "sends a request although the run is ending"),
    "a second request": (
        with_rule(CHAIN, "a0()#0 accepted", action=TransitionAction.SEND),
        "sends a request while one of the call is alive",
    ),
    "effects of what was not sent": (
        with_rule(CHAIN, "a0()#0 precondition_false", action=TransitionAction.FINISH),
        "effects of a request that was not sent",
    ),
    "a cancellation of nothing": (with_rule(CHAIN, "a0()#0 retry", action=TransitionAction.CANCEL), "about a request, and none is alive"),
    "an end that is lost": (
        without_transition(CHAIN, "a0()#0 aborted"),
        "nothing takes the report that a request has aborted|has no exit for",
    ),
    "a call under way that does not say so": (
        replace(CHAIN, alive_places=CHAIN.alive_places - {"a0()#0 running"}),
        "no place is marked that says so",
    ),
    "a failure that is taken back": (with_input(CHAIN, "a0()#0 fork", "a0()#0 failed"), "which stays as it is"),
    "a failure of a loop without a cause": (
        with_rule(LOOP, "while((free))#1 condition_unknown", guard=Always()),
        "marks a failure, and no rule has found its cause",
    ),
    "a call that is left without having begun": (
        with_outputs(CHAIN, "a1()#1 join", {"a1()#1 done": 1}),
        "leaves a call that has not come to an end",
    ),
    "a failure of a call that was skipped": (with_output(CHAIN, "a1()#1 skip", "a1()#1 failed"), "no rule has found its cause"),
    "a call that is passed over before its cause is known": (
        with_rule(CHAIN, "a1()#1 aborted", outcome=CallOutcome.PASSED_OVER),
        "leaves a call that has not come to an end",
    ),
    "a call that is passed over by nothing of the plan": (
        with_outputs(CHAIN, "a1()#1 precondition_false", {"a1()#1 done": 1}),
        "call 1 was not carried out, and the plan does not pass it over",
    ),
    "a call that is passed over for another cause than the plan has it": (
        without_output(SPARED, "a0()#0 precondition_false", "a0()#0 failed"),
        "call 0 was not carried out, and the plan does not pass it over",
    ),
    "a call that is left after a recovery which was to begin it anew": (
        with_outputs(COUNTING, "a0()#0 retry 0", {"a0()#0 done": 1}),
        "call 0 was not carried out, and the plan does not pass it over",
    ),
    "a call that never begins": (
        with_outputs(CHAIN, "a1()#1 join", {"a1()#1 < finish": 1}),
        "call 1 was not carried out, and the plan does not pass it over",
    ),
    "a call that is cancelled although nothing ends": (
        with_rule(CHAIN, "a1()#1 stop", guard=Always()),
        "call 1 was not carried out, and the plan does not pass it over",
    ),
    "a success that leaves no outcome": (
        with_rule(CHAIN, "a1()#1 effects_hold", outcome=None),
        "leaves a call that has not come to an end",
    ),
    "a recovery that takes the call for one that was not reached": (
        with_rule(COUNTING, "a0()#0 recover 0", outcome=CallOutcome.WAITING),
        "whatever has become of it",
    ),
    "a request that does not count as an attempt": (with_rule(CHAIN, "a0()#0 start", outcome=None), "does not count as an attempt"),
    "an outcome that is not so": (with_rule(CHAIN, "a1()#1 join", outcome=CallOutcome.SKIPPED), "whatever has become of it"),
    "a loop that asks for the data of a call": (with_rule(LOOP, "while((free))#1 skip", guard=DataMissing(1)), "belongs to no call"),
    "a call that begins anew for ever without a pause": (with_rule(CHAIN, "a0()#0 suspend", guard=Always()), "round for ever"),
    "a round beside that of a pause": (with_outputs(CHAIN, "a0()#0 aborted", {"a0()#0 ready": 1}), "round for ever"),
    "an end before the request is over": (
        with_rule(CHAIN, "a0()#0 unconfirmed", gives_up=False),
        "a request is alive, and no place is marked that says so",
    ),
}


@pytest.mark.parametrize("prove", [verify, explore])
@pytest.mark.parametrize("name", UNSOUND)
def test_what_would_go_wrong_when_it_is_executed_is_refused(name: str, prove: Callable[[PetriNetMachine], object]) -> None:
    broken, why = UNSOUND[name]
    with pytest.raises(Unsound, match=why):
        prove(broken)


@pytest.mark.parametrize(
    "broken",
    [
        with_rule(LOOP, "while((free))#1 no_more", guard=Always()),
        with_outputs(LOOP, "while((free))#1 join", {"while((free))#1 done": 1}),
        with_rule(
            with_rule(CHOICE, "if((free))#1 then", guard=ConditionFalse(Holds(("free",)))),
            "if((free))#1 else",
            guard=ConditionTrue(Holds(("free",))),
        ),
    ],
    ids=["a loop that is over whatever its condition", "a loop that is never entered", "a choice that takes the other branch"],
)
def test_loops_and_choices_are_left_as_their_conditions_say(broken: PetriNetMachine) -> None:
    with pytest.raises(Unsound, match="was not carried out"):
        verify(broken)


@pytest.mark.parametrize("machine", [SPARED, LOOP, CHOICE, COUNTING], ids=["spared", "loop", "choice", "counting"])
def test_what_the_plan_passes_over_is_no_fault(machine: PetriNetMachine) -> None:
    verify(machine)
    explore(machine)


def test_counters_are_pairs_before_they_are_counted_as_some() -> None:
    verify(COUNTING)
    for transition, place, weight in (
        ("a0()#0 give_up", "a0()#0 spent", 5),
        ("a0()#0 give_up 0", "a0()#0 uses spent 0", 3),
        ("a0()#0 give_up 0", "a0()#0 uses spent 0", 2),
    ):
        inputs = COUNTING.net.inputs[transition]
        with pytest.raises(Unsound, match="neither one nor all"):
            verify(with_inputs(COUNTING, transition, {**inputs, place: weight}))
    mixed = with_output(with_input(COUNTING, "a0()#0 join", "a0()#0 spent"), "a0()#0 join", "a0()#0 uses left 0")
    with pytest.raises(Unsound, match="mixes counters"):
        verify(mixed)


def test_an_extra_step_without_inputs_is_not_waited_for() -> None:
    net = CHAIN.net
    never = PetriNet(net.places, {**net.inputs, "spark": {}}, {**net.outputs, "spark": {"a0()#0 ready": 1}})
    verify(replace(CHAIN, net=never, rules={**CHAIN.rules, "spark": Rule("spark", Always(), 0)}))


@pytest.mark.parametrize("capacity", [0, -1])
def test_nothing_has_a_capacity_below_one(capacity: int) -> None:
    with pytest.raises(CapacityError, match="arm"):
        generate(ARM.plan, capacities={"arm": capacity})
    with pytest.raises(CapacityError, match="arm"):
        PlanGraph(ARM.plan.steps, capacities={"arm": capacity})
    with pytest.raises(CapacityError, match="arm"):
        Resources({"arm": capacity})


@pytest.mark.parametrize("seconds", [float("inf"), float("nan"), -1.0])
def test_no_limit_is_infinite(seconds: float) -> None:
    call = ActionCall(0, GroundAction("act"))
    for limits in ({"timeout": seconds}, {"release": seconds}):
        with pytest.raises(PlanGraphError, match="seconds"):
            PlanGraph((replace(call, **limits),))  # type: ignore[arg-type]
    for binding in ({"accept": seconds}, {"cancel": seconds}, {"timeout": seconds}):
        with pytest.raises(InputError, match="seconds"):
            Bindings({"act": Binding(**binding)})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="seconds"):
        Bindings(lag=seconds)
    with pytest.raises(InputError, match="seconds"):
        KnowledgeBase().sense(("at",), lag=seconds)


def test_transitions_that_can_never_fire_are_listed_with_the_reason() -> None:
    never = {fired.transition: fired.reason for fired in verify(CHAIN).never}
    implied = "such an end implies that the request was accepted, and a{0}()#{0} accepted goes first"
    assert never == {f"a{number}()#{number} ended_early": implied.format(number) for number in (0, 1)}


def test_a_step_that_can_never_begin_is_refused() -> None:
    with pytest.raises(Unsound, match="step 1 of the plan can never begin"):
        verify(with_outputs(COUNTING, "a0()#0 rejected", {"a0()#0 recover": 1}))


# --- counters: the work grows with the recoveries of a call, not with their combinations, and nothing that hangs gets through ---


CAUSES = (
    *(Cause.ABORTED, Cause.CANCELED, Cause.REJECTED, Cause.UNAVAILABLE, Cause.TIMED_OUT, Cause.LOST),
    *(Cause.DATA_MISSING, Cause.PRECONDITION_FALSE, Cause.EFFECTS_MISSING, Cause.BEFORE, Cause.AFTER),
)


def recovering(count: int, times: int = 3) -> PetriNetMachine:
    chains = [Flow((ActionCall(index + 1, GroundAction("wait")),)) for index in range(count)]
    recoveries = tuple(Recovery(frozenset({cause}), Then.RETRY, chain, times) for cause, chain in zip(CAUSES, chains, strict=False))
    return generate(PlanGraph((ActionCall(0, GroundAction("a"), recoveries=recoveries),)))


def states(machine: PetriNetMachine) -> int:
    forget_proofs()
    return verify(machine).states


def test_every_recovery_costs_the_proof_about_the_same() -> None:
    found = [states(recovering(count)) for count in range(1, len(CAUSES) + 1)]
    steps = [after - before for before, after in pairwise(found)]
    assert max(steps) <= 5 * min(steps)
    assert found[-1] < 1_000


def test_how_often_makes_no_difference() -> None:
    assert states(recovering(2, 2)) == states(recovering(2, 50))


@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("gone", ["a()#0 give_up 0", "a()#0 recover 0"])
def test_a_counter_that_runs_out_needs_another_way(times: int, gone: str) -> None:
    broken = without_transition(recovering(1, times), gone)
    with pytest.raises(Unsound):
        explore(broken)
    with pytest.raises(Unsound):
        verify(broken)


@pytest.mark.parametrize("prove", [verify, explore])
def test_what_is_counted_back_while_it_is_counted_is_refused(prove: Callable[[PetriNetMachine], object]) -> None:
    machine = recovering(1)
    net, name, more = machine.net, "a()#0 retry 0", "a()#0 retry for ever"
    inputs = {more: {**net.inputs[name], "a()#0 uses spent 0": 1}, **net.inputs}
    outputs = {more: {**net.outputs[name], "a()#0 uses left 0": 1}, **net.outputs}
    endless = replace(machine, net=PetriNet(net.places, inputs, outputs), rules={more: machine.rules[name], **machine.rules})
    with pytest.raises(Unsound, match="for ever"):
        prove(endless)
