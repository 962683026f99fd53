"""Calls that may turn out in several ways: which of them it was is told by the result, or by reports; what is not told is unknown."""

from __future__ import annotations

import pytest

from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Alternative, Effects, Set
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind
from pnm.core.message_fields import Flag, parse_field
from tests.support.runs.commands import accepted, report
from tests.support.runs.handover import going
from tests.support.runs.plan_graphs import plan_of

HELD, FLOOR, BROKEN = ("held", "cup"), ("floor", "cup"), ("broken", "cup")
LAG = 1.0


def facts(*true: Fluent) -> Effects:
    return tuple([Set(fluent, Constant(True)) for fluent in true])


WAYS = (
    Alternative(facts(HELD), name="held"),
    Alternative(facts(FLOOR), name="slipped"),
    Alternative(facts(FLOOR, BROKEN), name="burst"),
    Alternative(name="missed"),
)
PICK = GroundAction("pick", ("cup",), ("cup",), end_effects=facts(HELD), outcomes=WAYS, outcome="held")


def picking(*sensed: str, bindings: Bindings | None = None) -> Run:
    """A run whose one call was accepted at 1 s, and what is reported comes 1 s late at most."""
    return going(PICK, world=KnowledgeBase({("here",): True}, sensed=dict.fromkeys(sensed, LAG)), bindings=bindings)


def end(run: Run, now: float = 2.0, declared: str = "") -> CallResult:
    (request,) = run.open_requests
    run.handle(Ended(request, Outcome(OutcomeKind.SUCCEEDED, declared=declared)), now)
    return run.result_of(0)


def known(run: Run) -> tuple[object, ...]:
    return tuple(run.knowledge.world.value(fluent) for fluent in (HELD, FLOOR, BROKEN))


TRUTHS = [("held", (True, None, None)), ("burst", (None, True, True)), ("missed", (None, None, None))]


@pytest.mark.parametrize(("name", "expected"), TRUTHS)
def test_the_result_tells_which_it_was_and_only_that_is_assumed(name: str, expected: tuple[object, ...]) -> None:
    run = picking()
    assert end(run, declared=name).outcome == name
    assert (run.over, known(run)) == (True, expected)


def test_an_outcome_that_was_told_is_looked_for_as_other_effects_are() -> None:
    run = picking("floor")
    assert not end(run, declared="slipped").is_done
    report(run, FLOOR, True, 2.5)
    assert (run.over, run.result_of(0).outcome) == (True, "slipped")


def test_reports_that_only_one_outcome_brings_about_tell_it_at_once() -> None:
    run = picking("held", "floor", "broken")
    report(run, HELD, True, 1.9)
    assert end(run).outcome == "held"
    assert run.over


def test_another_outcome_may_still_be_reported_as_long_as_reports_may_be_late() -> None:
    run = picking("held", "floor", "broken")
    end(run)
    report(run, FLOOR, True, 2.2)
    assert not run.over, "it may have burst as well"
    report(run, BROKEN, True, 2.6)
    assert (run.over, run.result_of(0).outcome) == (True, "burst")


def test_without_a_report_in_time_it_was_the_outcome_that_brings_none() -> None:
    run = picking("held", "floor", "broken")
    end(run)
    run.handle(Tick(), 2.0 + LAG)
    assert (run.over, run.result_of(0).outcome, run.result().failures) == (True, "missed", ())


def test_what_nothing_tells_apart_is_unknown_until_it_is_reported() -> None:
    run = picking("held")
    end(run)
    run.handle(Tick(), 2.0 + LAG)
    assert run.result_of(0).outcome == "slipped or burst or missed"
    assert known(run) == (None, UNKNOWN, UNKNOWN)


def test_an_end_that_waits_for_others_believes_no_outcome_before_it_is_looked_for() -> None:
    world = KnowledgeBase(sensed={"held": LAG})
    run = accepted(plan_of(PICK, GroundAction("watch", duration=9.0), orders=("1e<0e",)), at=1.0, world=world)
    pick, watch = run.open_requests
    run.handle(Ended(pick, Outcome(OutcomeKind.SUCCEEDED)), 2.0)
    assert known(run) == (None, None, None)
    report(run, HELD, True, 2.5)
    run.handle(Ended(watch, Outcome(OutcomeKind.SUCCEEDED)), 3.0)
    assert (run.over, run.result_of(0).outcome, known(run)) == (True, "held", (True, None, None))


def test_what_no_outcome_brings_about_is_no_success() -> None:
    run = picking("held", "floor", "broken", bindings=Bindings({"pick": Binding(retries=0)}))
    end(run)
    report(run, BROKEN, True, 2.5)
    report(run, HELD, True, 2.5)
    run.handle(Tick(), 2.5 + LAG)
    (failure,) = run.result().failures
    assert failure.cause == "effects_missing"
    assert "(or" in failure.expected


TOLD = Binding(outcomes={name: Flag(parse_field(name)) for name in ("slipped", "burst", "missed")}, success=Flag(parse_field("fine")))


def test_outcomes_that_a_result_would_tell_are_out_of_the_question_if_it_does_not() -> None:
    run = picking(bindings=Bindings({"pick": TOLD}))
    assert end(run).outcome == "held"
    assert known(run) == (True, None, None)


@pytest.mark.parametrize("kind", [OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED])
def test_a_result_that_tells_a_declared_outcome_is_a_success_whatever_else_it_says(kind: OutcomeKind) -> None:
    told = {"slipped": False, "burst": True, "missed": True, "fine": False}
    assert TOLD.judged(Outcome(kind, told)) == Outcome(OutcomeKind.SUCCEEDED, told, declared="burst")
    assert TOLD.judged(Outcome(kind, {"fine": False})).kind is OutcomeKind.ABORTED
    assert TOLD.judged(Outcome(OutcomeKind.CANCELED, told)).kind is OutcomeKind.CANCELED
