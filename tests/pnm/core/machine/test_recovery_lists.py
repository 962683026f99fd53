"""Recoveries for one cause are used one after the other, each as often as it may be; then the call has failed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.logic.conditions import TRUE, Condition, Holds, Not
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, PlanGraph, PlanGraphError, Recovery, Then
from pnm.core.machine.verification.verify import explore, verify
from pnm.errors import InputError
from tests.support.runs.direct import answering_with, drive
from tests.support.runs.plan_graphs import plan_of_steps
from tests.support.yaml.programs import only_plan

ABORTED = frozenset({Cause.ABORTED})
FIX, HELP = (Flow((ActionCall(number, GroundAction(name), retries=0),)) for number, name in ((1, "fix"), (2, "help")))


def bad(*recoveries: Recovery, action: GroundAction = GroundAction("bad"), goal: Condition = TRUE) -> PlanGraph:
    return plan_of_steps(ActionCall(0, action, recoveries=recoveries, retries=0), goal=goal)


def test_the_second_recovery_is_used_when_the_first_is_used_up() -> None:
    graph = bad(Recovery(ABORTED, Then.RETRY, FIX, times=2), Recovery(ABORTED, Then.RETRY, HELP))
    explore(generate(graph))
    saved = drive(graph, answering_with(bad=["aborted"] * 3))
    assert saved.actions == ["bad", "fix", "bad", "fix", "bad", "help", "bad"]
    assert saved.result.goal
    assert drive(graph, answering_with(bad=["aborted"] * 4)).result.failures[0].cause is Cause.ABORTED


def test_a_list_that_ends_with_a_command_alone_never_gives_up() -> None:
    graph = bad(Recovery(ABORTED, Then.RETRY, FIX), Recovery(ABORTED, Then.SKIP, Flow()))
    explore(generate(graph))
    trace = drive(graph, answering_with(bad=["aborted"] * 2))
    assert trace.actions == ["bad", "fix", "bad"]
    assert trace.result.goal


def test_lists_of_two_causes_share_the_uses_of_a_recovery() -> None:
    both = frozenset({Cause.ABORTED, Cause.REJECTED})
    graph = bad(Recovery(both, Then.RETRY, FIX), Recovery(ABORTED, Then.SKIP, HELP))
    explore(generate(graph))
    assert drive(graph, answering_with(bad=["rejected", "aborted"])).actions == ["bad", "fix", "bad", "help"]
    assert not drive(graph, answering_with(bad=["aborted", "rejected"])).result.goal


def test_start_effects_stay_only_for_the_recovery_that_goes_on() -> None:
    lit = Holds(("lit",))
    light = GroundAction("light", start_effects=(Set(("lit",), Constant(True)),), duration=1.0)
    in_the_dark = Flow((ActionCall(1, GroundAction("fix", precondition=Not(lit)), retries=0),))
    graph = bad(Recovery(ABORTED, Then.RETRY, in_the_dark), Recovery(ABORTED, Then.CONTINUE, Flow()), action=light, goal=lit)
    trace = drive(graph, answering_with(light=["aborted"] * 2))
    assert (trace.actions, trace.result.goal) == (["light", "fix", "light"], True), trace.result.reason


def test_a_call_whose_resources_are_withheld_has_no_request_that_a_recovery_could_go_on_with() -> None:
    unavailable = frozenset({Cause.UNAVAILABLE})
    lists = Recovery(unavailable, Then.RETRY, FIX), Recovery(unavailable, Then.CONTINUE, Flow())
    machine = generate(bad(*lists, action=GroundAction("grasp", resources=("arm",))))
    verify(machine)
    explore(machine)


def test_checks_of_ones_own_are_tried_in_order_where_their_conditions_hold() -> None:
    crowded = Holds(("crowded",))
    before = frozenset({Cause.BEFORE})
    never = bad(Recovery(before, Then.RETRY, FIX, when=crowded), Recovery(before, Then.SKIP, HELP, when=Holds(("dark",))))
    verify(generate(never))
    explore(generate(never))
    plan = only_plan(
        "actions: {bad: {}, fix: {}, help: {}}\ninitial_knowledge: {crowded: 1, dark: 1}\nplan:\n  - bad:\n    recoveries:\n      before:\n"
        "        - {when: {LocalQuery: crowded}, do: [fix:, retry]}\n        - {when: {LocalQuery: dark}, do: [help:, skip_action]}\n"
    )
    for dark, actions, goal in ((1, ["fix", "help"], True), (0, ["fix"], False)):
        trace = drive(plan.graph, bindings=plan.bindings, variables={**plan.variables, "dark": dark})
        assert (trace.actions, trace.result.goal) == (actions, goal)


@pytest.mark.parametrize(
    "first",
    [
        Recovery(ABORTED, Then.SKIP, FIX),
        Recovery(ABORTED, Then.FAIL, Flow()),
        Recovery(ABORTED, Then.CONTINUE, Flow()),
        Recovery(ABORTED, Then.SKIP, Flow(), when=Holds(("dark",))),
    ],
)
def test_a_recovery_that_can_never_happen_is_refused(first: Recovery) -> None:
    with pytest.raises(PlanGraphError, match=r"recovery 1 of bad.* for aborted can never happen"):
        generate(bad(first, Recovery(ABORTED, Then.RETRY, HELP if first.chain.steps else FIX)))


def test_a_recovery_that_can_never_happen_is_refused_where_it_stands() -> None:
    text = "actions: {bad: {}, fix: {}}\nplan:\n  - bad:\n    recoveries:\n      during:\n        aborted:\n          - {do: skip_action}\n"
    with pytest.raises(InputError, match="can never happen: the recovery before it ends with skip_action") as error:
        only_plan(f"{text}          - {{do: [fix:, retry]}}\n")
    assert error.value.position is not None
    assert (error.value.position.line, error.value.position.column) == (8, 13)


PLAIN = ActionCall(0, GroundAction("act"))
KINDS = (
    PLAIN,
    replace(PLAIN, latest_start=5.0, deadline=9.0),
    replace(PLAIN, action=replace(PLAIN.action, resources=("arm",), invariant=Holds(("lit",)))),
)


@pytest.mark.parametrize("cause", Cause)
def test_a_recovery_can_happen_or_is_refused_with_the_reason(cause: Cause) -> None:
    """Also where something restarts: that the plan may do so no more is no failure of a call."""
    for call in KINDS:
        restarts = ActionCall(2, GroundAction("other"), recoveries=(Recovery(ABORTED, Then.RESTART_PLAN, Flow()),))
        for then in (Then.RETRY, Then.SKIP, Then.FAIL):
            plan = PlanGraph((replace(call, recoveries=(Recovery(frozenset({cause}), then, FIX),)), restarts))
            try:
                machine = generate(plan)
            except PlanGraphError as refused:
                never, _, why = str(refused).partition(": ")
                assert never == f"recovery 0 of act()#0 for {cause} can never happen"
                assert why == cause.phase.value
            else:
                verify(machine)  # which refuses steps that can never begin
