"""Calls that succeed although they are being cancelled: a success like any other, with the same checks."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.execution.events import Ask, Pause, Stop, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import Computed, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended
from tests.support.runs.commands import begun, report, sent
from tests.support.runs.handover import SUCCEEDED, going
from tests.support.runs.plan_graphs import plan_of

LIT, DOOR, HELD, MENDED = ("lit",), ("door",), ("held",), ("mended",)
MEND = GroundAction("mend", invariant=Holds(LIT), end_effects=(Set(MENDED, Constant(True)),), duration=5.0)
OPEN = GroundAction("open", start_effects=(Set(("moving",), Constant(True)),), end_effects=(Set(DOOR, Constant(True)),), duration=5.0)
LET_GO = (Set(HELD, Constant(False)), Set(("down",), Constant(True)))
DROP = GroundAction("drop", end_condition=Holds(HELD), end_effects=LET_GO, duration=5.0)
RUNG = Computed(Operation("eq", (Query(Literal.of("bell"), Layer.GLOBAL, Literal.of(None)), Literal.of("rung"))))
ONCE = Bindings({name: Binding(retries=0) for name in ("mend", "open", "drop")})


def outcomes(run: Run) -> list[str]:
    return [call.outcome for call in run.result().calls]


def test_what_a_call_whose_over_all_condition_broke_would_have_changed_is_not_believed() -> None:
    run = going(MEND, world=KnowledgeBase({LIT: True}))
    (request,) = run.open_requests
    report(run, LIT, False, 2.0)
    run.handle(Ended(request, SUCCEEDED), 2.5)
    assert outcomes(run) == ["invariant_false"], "how its request ended does not make it a success"
    assert not run.knowledge.value(MENDED)


@pytest.mark.parametrize("event", [Stop(cancel=True), Pause(at_once=True), Tick()])
def test_a_condition_that_breaks_while_the_call_is_being_cancelled_breaks_it(event: Stop | Pause | Tick) -> None:
    run = going(MEND, world=KnowledgeBase({LIT: True}), bindings=Bindings({"mend": Binding(retries=0, timeout=1.0)}))
    (request,) = run.open_requests
    run.handle(event, 2.0)
    report(run, LIT, False, 2.5)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert not run.knowledge.value(MENDED)
    assert not run.interim_result().calls[0].is_done


def test_effects_of_a_stopped_call_are_looked_for_as_long_as_their_reports_may_be_late() -> None:
    run = going(OPEN, world=KnowledgeBase(sensed={"door": 1.0}), bindings=ONCE)
    (request,) = run.open_requests
    run.handle(Stop(cancel=True), 2.0)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert [call.action.name for call in run.settling] == ["open"]
    report(run, DOOR, True, 3.9)
    assert outcomes(run) == ["succeeded"]


def test_a_stopped_call_whose_effects_are_missing_is_none_that_succeeded() -> None:
    run = going(OPEN, world=KnowledgeBase(sensed={"door": 1.0}), bindings=ONCE)
    (request,) = run.open_requests
    run.handle(Stop(cancel=True), 2.0)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    run.handle(Tick(), 4.0)
    assert outcomes(run) == ["canceled"]
    assert not run.knowledge.value(("moving",)), "what was believed of its start is taken back"


def test_what_the_end_of_a_stopped_call_relies_on_is_not_asked_for_any_more() -> None:
    run = going(replace(OPEN, end_condition=RUNG), asks=True)
    (request,) = run.open_requests
    run.handle(Stop(cancel=True), 2.0)
    assert run.handle(Ended(request, SUCCEEDED), 3.0) == []
    assert outcomes(run) == ["canceled"]


def test_what_an_end_relies_on_counts_even_if_the_end_itself_changes_it() -> None:
    run = going(DROP, world=KnowledgeBase({HELD: True}), bindings=ONCE)
    (request,) = run.open_requests
    report(run, HELD, False, 2.0)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert outcomes(run) == ["effects_missing"]
    assert run.result().failures[0].expected == "(held)"
    assert not run.knowledge.value(("down",))


def test_what_an_end_relies_on_may_have_to_be_asked_for_once_others_have_ended() -> None:
    run, _ = begun(plan_of(replace(OPEN, end_condition=RUNG), MEND, orders=("1e<0e",)), world=KnowledgeBase({LIT: True}), asks=True)
    opening, mending = run.open_requests
    assert run.handle(Ended(opening, SUCCEEDED), 1.0) == []
    assert any(isinstance(command, Ask) for command in run.handle(Ended(mending, SUCCEEDED), 2.0))


def test_a_goal_that_was_carried_out_before_anything_answered_is_not_sent_again() -> None:
    run, _ = begun(plan_of(OPEN), Bindings({"open": Binding(accept=5.0, retries=3)}))
    run.handle(Tick(), 5.0)
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 6.0)) == []
    assert outcomes(run) == ["succeeded"]
    assert [run.knowledge.value(fluent) for fluent in (("moving",), DOOR)] == [True, True]


def test_others_that_wait_for_its_start_go_on() -> None:
    run, _ = begun(plan_of(OPEN, GroundAction("look"), orders=("0s<1s",)), Bindings({"open": Binding(accept=5.0, retries=3)}))
    run.handle(Tick(), 5.0)
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 6.0)) == ["look"]
