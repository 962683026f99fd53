"""Runs that are paused and resumed: nothing starts meanwhile but with a step, nothing is lost, and all of it ends."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.execution.events import Answered, Ask, Begin, InHands, KnowledgeChanged, Pause, Resume, Send, SingleStep, Stop, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.verify import verify
from tests.support.runs.commands import RUN, accepted, begun, cancelled, sent
from tests.support.runs.plan_graphs import plan, plan_of, plan_of_steps
from tests.support.runs.simulated import move

ABORTED, CANCELED, SUCCEEDED = (Outcome(kind) for kind in (OutcomeKind.ABORTED, OutcomeKind.CANCELED, OutcomeKind.SUCCEEDED))


DOES = GroundAction("act", end_effects=(Set(("done",), Constant(True)),))


def mended(action: GroundAction, cause: Cause, then: Then) -> PlanGraph:
    """A plan of an action that something is mended after."""
    recovery = Recovery(frozenset({cause}), then, Flow((ActionCall(1, GroundAction("mend")),)))
    return plan_of_steps(ActionCall(0, action, recoveries=(recovery,)))


def begun_paused(graph: PlanGraph, *, at_once: bool = False) -> Run:
    """A run that was paused before it began."""
    run = Run(generate(graph), Layered(KnowledgeBase()), id=RUN)
    run.handle(Pause(at_once), 0.0)
    assert run.handle(Begin(), 0.0) == []
    assert run.paused
    return run


def test_what_has_not_begun_begins_paused_and_resuming_what_is_not_paused_changes_nothing() -> None:
    run = begun_paused(plan(1))
    assert sent(run.handle(Resume(), 1.0)) == ["a0"]
    before = run.marking
    for event in (Resume(), SingleStep()):
        assert run.handle(event, 2.0) == []
        assert (run.marking, run.pausing) == (before, None)


def test_a_call_is_cancelled_at_once_and_begins_anew_without_spending_its_budget() -> None:
    run = accepted(bindings=Bindings({"a0": Binding(retries=1)}))
    (first,) = run.open_requests
    assert cancelled(run.handle(Pause(at_once=True), 1.0)) == [first]
    assert not run.paused
    assert run.handle(Ended(first, CANCELED), 2.0) == []
    assert run.paused
    assert run.interim_result().calls[0].outcome == "suspended"
    assert run.marking["a0()#0 budget"] == 1
    assert sent(run.handle(Resume(), 3.0)) == ["a0"]
    run.handle(Ended(run.open_requests[0], SUCCEEDED), 4.0)
    assert [(call.outcome, call.attempts) for call in run.result().calls] == [("succeeded", 2)]


def test_a_call_that_fails_during_a_pause_is_between_two_attempts_and_holds_up_nobody() -> None:
    run = accepted(bindings=Bindings({"a0": Binding(retries=1)}))
    run.handle(Pause(), 1.0)
    run.handle(Ended(run.open_requests[0], ABORTED), 2.0)
    assert run.paused
    assert (run.open_requests, run.under_way(), run.settling) == ((), (), ())
    assert [(call.outcome, call.attempts, call.is_under_way) for call in run.interim_result().calls] == [("suspended", 1, False)]
    assert sent(run.handle(Resume(), 3.0)) == ["a0"]
    assert run.interim_result().calls[0].outcome == "running"


def test_being_told_twice_cancels_once_and_at_once_is_the_stronger_word() -> None:
    run = accepted()
    assert cancelled(run.handle(Pause(), 1.0)) == []
    assert len(cancelled(run.handle(Pause(at_once=True), 1.0))) == 1
    assert cancelled(run.handle(Pause(at_once=True), 1.0)) == []
    assert cancelled(run.handle(Pause(), 1.0)) == []
    assert run.pausing == Pause(at_once=True)


def test_a_request_that_is_not_accepted_yet_is_cancelled_when_it_is() -> None:
    run, _ = begun(plan(1))
    assert cancelled(run.handle(Pause(at_once=True), 1.0)) == []
    assert cancelled(run.handle(Accepted(run.open_requests[0]), 2.0)) == [*run.open_requests]
    run.handle(Ended(run.open_requests[0], CANCELED), 3.0)
    assert run.paused


@pytest.mark.parametrize("kind", [*map(OutcomeKind, ("succeeded", "aborted", "lost", "rejected", "unavailable"))])
def test_success_in_spite_of_the_cancellation_is_success_and_any_other_end_begins_the_call_anew(kind: OutcomeKind) -> None:
    run = accepted(plan(2, "0e<1s"), Bindings({"a0": Binding(retries=0)}))
    run.handle(Pause(at_once=True), 1.0)
    assert sent(run.handle(Ended(run.open_requests[0], Outcome(kind)), 2.0)) == []
    assert run.paused
    assert sent(run.handle(Resume(), 3.0)) == (["a1"] if kind is OutcomeKind.SUCCEEDED else ["a0"])


def test_a_cancellation_that_is_not_confirmed_is_a_failure_with_an_open_end() -> None:
    run = accepted(bindings=Bindings({"a0": Binding(cancel=3.0)}))
    run.handle(Pause(at_once=True), 1.0)
    run.handle(Tick(), 4.0)
    (failure,) = run.result().failures
    assert (failure.cause, failure.unconfirmed, failure.observed) == ("timed_out", True, "none")


def test_resuming_before_the_cancellation_is_confirmed_waits_for_it() -> None:
    run = accepted()
    (first,) = run.open_requests
    run.handle(Pause(at_once=True), 1.0)
    assert sent(run.handle(Resume(), 1.5)) == []
    assert sent(run.handle(Ended(first, CANCELED), 2.0)) == ["a0"]


@pytest.mark.parametrize(("ending", "outcome"), [(CANCELED, "canceled"), (SUCCEEDED, "succeeded"), (None, "canceled, unconfirmed")])
def test_a_run_that_is_stopped_while_it_pauses_ends(ending: Outcome | None, outcome: str) -> None:
    run = accepted(bindings=Bindings({"a0": Binding(cancel=3.0)}))
    run.handle(Pause(at_once=True), 1.0)
    assert cancelled(run.handle(Stop(reason="enough"), 2.0)) == []
    run.handle(Tick() if ending is None else Ended(run.open_requests[0], ending), 5.0)
    result = run.result()
    assert (result.goal, result.reason, result.failures) == (False, "enough", ())
    assert [call.outcome for call in result.calls] == [outcome]


def test_assumed_start_effects_are_taken_back_and_all_checks_are_made_anew() -> None:
    world = KnowledgeBase({("at", "r1", "hall"): True})
    run = accepted(plan_of(move("r1", "hall", "lab")), world=world)
    assert world.value(("at", "r1", "hall")) is False
    run.handle(Pause(at_once=True), 1.0)
    run.handle(Ended(run.open_requests[0], CANCELED), 2.0)
    assert world.value(("at", "r1", "hall")) is True
    world.update({("at", "r1", "hall"): False})
    run.handle(KnowledgeChanged(), 3.0)
    assert not run.over
    run.handle(Resume(), 4.0)
    assert [failure.cause for failure in run.result().failures] == ["precondition_false"]


def test_what_became_true_during_the_pause_is_not_done() -> None:
    world = KnowledgeBase()
    run, _ = begun(plan_of(GroundAction("first"), DOES, orders=("0e<1s",)), world=world)
    run.handle(Pause(), 0.5)
    run.handle(Ended(run.open_requests[0], SUCCEEDED), 1.0)
    world.update({("done",): True})
    run.handle(KnowledgeChanged(), 2.0)
    assert run.over, "nothing has to be started for that"


def test_a_start_that_others_wait_for_is_announced_once() -> None:
    run = accepted(plan(2, "0s<1s"))
    verify(run.machine)
    assert [str(call) for call in run.open_calls.values()] == ["a0()#0", "a1()#1"]
    run.handle(Pause(at_once=True), 1.0)
    for request in run.open_requests:
        run.handle(Accepted(request), 1.0)
        run.handle(Ended(request, CANCELED), 1.0)
    assert run.paused
    assert sorted(sent(run.handle(Resume(), 2.0))) == ["a0", "a1"]


@pytest.mark.parametrize("is_seen", [True, False])
def test_effects_are_looked_for_during_a_pause_and_the_call_begins_anew_after_it_where_they_stay_away(is_seen: bool) -> None:
    run = accepted(plan_of(DOES), world=KnowledgeBase(sensed={"done": 2.0}))
    run.handle(Ended(run.open_requests[0], SUCCEEDED), 1.0)
    run.handle(Pause(), 1.5)
    assert not run.paused
    run.knowledge.world.update({("done",): is_seen})
    assert sent(run.handle(Tick(), 3.0)) == []
    assert (run.over, run.paused) == (is_seen, True)
    assert is_seen or sent(run.handle(Resume(), 4.0)) == ["act"]


def test_questions_stay_open_and_their_answers_are_kept() -> None:
    run, commands = begun(plan_of(GroundAction("asks")), Bindings({"asks": Binding(goal={"word": "$word"})}), asks=True)
    (question,) = [command for command in commands if isinstance(command, Ask)]
    assert run.handle(Pause(at_once=True), 1.0) == []
    assert run.paused
    assert run.handle(Answered(question.id, "hello"), 2.0) == []
    (request,) = [command.request for command in run.handle(Resume(), 3.0) if isinstance(command, Send)]
    assert request.goal["word"] == "hello"


def test_a_paused_run_waits_for_no_resources() -> None:
    run, _ = begun(plan_of(*(GroundAction(name, resources=("arm",)) for name in ("first", "second"))))
    assert len(run.resources.line) == 1
    run.handle(Pause(at_once=True), 0.5)
    assert run.resources.line == ()
    run.handle(Accepted(run.open_requests[0]), 1.0)
    run.handle(Ended(run.open_requests[0], CANCELED), 2.0)
    assert run.resources.held == ()
    assert sent(run.handle(Resume(), 3.0)) == ["second"], "it has waited longer"
    assert len(run.resources.line) == 1


def test_a_call_that_goes_on_after_a_recovery_waits_for_the_end_of_the_pause() -> None:
    world = KnowledgeBase(sensed={"done": 2.0})
    run = accepted(mended(replace(DOES, resources=("arm",)), Cause.ABORTED, Then.CONTINUE), world=world)
    run.handle(Ended(run.open_requests[0], Outcome(OutcomeKind.ABORTED)), 1.0)
    run.handle(Pause(), 1.0)
    run.handle(Ended(run.open_requests[0], SUCCEEDED), 2.0)
    assert run.paused
    assert run.resources.held == ()
    run.handle(Resume(), 3.0)
    assert [claim.names for claim in run.resources.held] == [("arm",)]
    world.update({("done",): True})
    run.handle(KnowledgeChanged(), 4.0)
    assert run.result().goal


def test_a_call_s_own_limit_counts_only_while_it_is_under_way() -> None:
    run = accepted(bindings=Bindings({"a0": Binding(timeout=10.0)}))
    run.handle(Pause(at_once=True), 1.0)
    assert sent(run.handle(Ended(run.open_requests[0], CANCELED), 2.0)) == []
    assert run.handle(Tick(), 50.0) == []
    run.handle(Resume(), 60.0)
    assert cancelled(run.handle(Accepted(run.open_requests[0]), 60.0)) == []
    assert cancelled(run.handle(Tick(), 69.0)) == []
    assert len(cancelled(run.handle(Tick(), 70.0))) == 1


def test_what_the_plan_says_about_cancelled_calls_is_about_others_wishes() -> None:
    run = accepted(mended(GroundAction("act"), Cause.CANCELED, Then.SKIP))
    run.handle(Pause(at_once=True), 1.0)
    assert sent(run.handle(Ended(run.open_requests[0], CANCELED), 2.0)) == []
    assert sent(run.handle(Resume(), 3.0)) == ["act"]
    run.handle(Accepted(run.open_requests[0]), 4.0)
    assert sent(run.handle(Ended(run.open_requests[0], CANCELED), 4.0)) == ["mend"]


# --- steps ---


def test_a_step_lets_one_request_leave_and_the_pause_goes_on() -> None:
    run = begun_paused(plan_of(*map(GroundAction, ("a0", "a1", "a2"))), at_once=True)
    for number in range(3):
        assert sent(run.handle(SingleStep(), 1.0)) == [f"a{number}"]
        assert not run.paused
        assert run.handle(KnowledgeChanged(), 2.0) == []
        (request,) = run.open_requests
        assert cancelled(run.handle(Accepted(request), 2.0)) == []
        assert sent(run.handle(Ended(request, SUCCEEDED), 3.0)) == []
        assert run.paused
    assert run.result().goal


def test_a_step_takes_resources_for_its_call_alone_and_leaves_no_claim_in_line() -> None:
    run = begun_paused(plan_of(*(GroundAction(name, resources=("arm",)) for name in ("a0", "a1", "a2"))))
    assert sent(run.handle(SingleStep(), 1.0)) == ["a0"]
    assert [*run.resources.line] == []
    assert run.handle(SingleStep(), 2.0) == []
    assert [*run.resources.line] == []
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.0)) == []
    assert [*run.resources.held] == []
    assert sent(run.handle(SingleStep(), 4.0)) == ["a1"]


def test_calls_that_need_what_a_person_has_begin_anew_when_it_is_given_back_and_others_go_on() -> None:
    bindings = Bindings({"a0": Binding(resources=("r1/base",), retries=0), "a1": Binding(retries=0)})
    run = Run(generate(plan(2), bindings), Layered(KnowledgeBase()), id=RUN, bindings=bindings)
    assert sent(run.handle(Begin(), 0.0)) == ["a0", "a1"]
    taken, other = run.open_requests
    for request in run.open_requests:
        run.handle(Accepted(request), 0.0)
    assert cancelled(run.handle(InHands(("r1",)), 1.0)) == [taken]
    assert run.handle(Ended(taken, CANCELED), 2.0) == []
    assert run.needs_from_people == ("r1",)
    assert run.awaits
    run.handle(Pause(), 3.0)
    assert run.handle(SingleStep(), 4.0) == [], "a step is no reason to use it"
    run.handle(Resume(), 5.0)
    run.handle(Ended(other, SUCCEEDED), 6.0)
    assert not run.over
    assert sent(run.handle(InHands(), 7.0)) == ["a0"]
    (again,) = run.open_requests
    run.handle(Ended(again, SUCCEEDED), 8.0)
    assert run.over
