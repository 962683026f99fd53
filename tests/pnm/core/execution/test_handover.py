"""Runs that are succeeded by others: what is under way is taken over, with what it has begun, and nothing is lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.execution.events import Begin, KnowledgeChanged, Pause, Tick, Wake
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, same_value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraphError
from pnm.core.machine.requests import Accepted, Ended
from pnm.core.machine.verification.verify import explore
from pnm.core.resources import Resources
from pnm.errors import RunError
from tests.support.runs.commands import cancelled, in_its_moment, sent
from tests.support.runs.handover import ABORTED, CANCELED, SUCCEEDED, going, successor
from tests.support.runs.plan_graphs import ordering, plan_of_steps
from tests.support.runs.simulated import move

ACT = GroundAction("act", resources=("arm",), duration=5.0)
LAST = GroundAction("last", resources=("arm",))


def test_a_request_is_taken_over_and_what_waits_for_it_goes_on_after_its_end() -> None:
    old = going(ACT)
    (request,) = old.open_requests
    new = successor(old, LAST)
    assert new.open_requests == (request,)
    assert sent(new.handle(Begin(), 2.0)) == [], "the arm is still in use"
    assert [claim.request for claim in new.resources.held] == [request]
    assert sent(new.handle(Ended(request, SUCCEEDED), 3.0)) == ["last"]
    new.handle(Ended(new.open_requests[0], SUCCEEDED), 4.0)
    result = new.result()
    assert result.goal
    assert [(call.outcome, call.attempts, call.started) for call in result.calls] == [("succeeded", 1, 0.0), ("succeeded", 1, 3.0)]
    assert (new.resources.held, new.resources.line) == ((), ())


def test_what_is_not_accepted_or_being_cancelled_is_not_under_way() -> None:
    old = going(GroundAction("one"), GroundAction("two"))
    assert [str(one.call) for one in old.under_way()] == ["one()#0", "two()#1"]
    old.handle(Pause(at_once=True), 2.0)
    assert old.under_way() == ()
    fresh = Run(old.machine, old.knowledge, id=UUID(int=3))
    fresh.handle(Begin(), 0.0)
    assert fresh.under_way() == ()
    old.handle(Ended(old.open_requests[0], CANCELED), 3.0)
    assert old.under_way() == ()


def test_how_far_a_run_has_come_is_told() -> None:
    old = going(GroundAction("one"), GroundAction("two"))
    old.handle(Ended(old.open_requests[0], SUCCEEDED), 2.0)
    told = old.interim_result()
    assert [call.outcome for call in told.calls] == ["succeeded", "handed over"]
    assert (told.goal, told.failures, told.stopped) == (False, (), False)


def test_time_outs_count_from_the_first_acceptance() -> None:
    limits = Bindings({"act": Binding(timeout=10.0)})
    old = going(ACT, bindings=limits)
    new = successor(old, bindings=limits)
    assert new.handle(Begin(), 4.0) == [Wake(11.0)]
    assert cancelled(new.handle(Tick(), 11.0)) == [*old.open_requests]
    late = successor(old, bindings=limits)
    assert cancelled(late.handle(Begin(), 12.0)) == [*old.open_requests]


def test_a_call_taken_over_that_fails_is_tried_again_as_any_other() -> None:
    world = KnowledgeBase({("at", "r1", "hall"): True})
    old = going(move("r1", "hall", "lab"), world=world)
    new = successor(old)
    new.handle(Begin(), 2.0)
    assert world.value(("at", "r1", "hall")) is False
    commands = new.handle(Ended(old.open_requests[0], ABORTED), 3.0)
    assert sent(commands) == ["move"]
    assert world.value(("at", "r1", "hall")) is True, "what was assumed at its start is taken back"
    assert new.open_requests != old.open_requests
    new.handle(Accepted(new.open_requests[0]), 3.0)
    new.handle(Ended(new.open_requests[0], SUCCEEDED), 4.0)
    assert new.result().calls[0].attempts == 2
    assert world.value(("at", "r1", "lab")) is True


def test_an_end_that_comes_before_the_beginning_is_not_lost() -> None:
    old = going(ACT)
    new = successor(old, LAST)
    assert new.handle(Ended(old.open_requests[0], SUCCEEDED), 2.0) == []
    assert sent(new.handle(Begin(), 2.0)) == ["last"]


def test_an_over_all_condition_counts_from_the_beginning() -> None:
    world = KnowledgeBase({("ok",): True})
    old = going(replace(ACT, invariant=Holds(("ok",))), world=world)
    world.update({("ok",): False})
    new = successor(old)
    assert cancelled(in_its_moment(new, Begin(), 2.0)) == [*old.open_requests]
    new.handle(Ended(old.open_requests[0], CANCELED), 3.0)
    assert [failure.cause for failure in new.result().failures] == ["invariant_false"]


def test_what_waits_for_the_start_of_a_call_taken_over_goes_on() -> None:
    old = going(GroundAction("act", duration=5.0))
    new = successor(old, GroundAction("next"), orders=("0s<1s",))
    explore(new.machine)
    assert sent(new.handle(Begin(), 2.0)) == ["next"]
    delayed = replace(new.machine.plan, orderings=(replace(ordering("0s<1s"), delay=4.0),))
    later = Run(generate(delayed), old.knowledge, id=UUID(int=3), adopted=dict(enumerate(old.under_way())))
    assert later.handle(Begin(), 2.0)[-1] == Wake(5.0), "4 s after its acceptance"


def test_a_run_without_others_keeps_what_its_predecessor_had() -> None:
    old = going(ACT, resources=Resources())
    new = successor(old, LAST, resources=None)
    assert sent(new.handle(Begin(), 2.0)) == []
    assert [claim.names for claim in new.resources.held] == [("arm",)]


def test_what_contradicts_the_plan_is_refused() -> None:
    old = going(ACT)
    (there,) = old.under_way()
    machine = generate(plan_of_steps(ActionCall(0, ACT, under_way=True)))

    def refused(adopted: Mapping[int, UnderWay], match: str) -> None:
        with pytest.raises(RunError, match=match):
            Run(machine, old.knowledge, id=UUID(int=2), adopted=adopted)

    refused({}, r"the calls \[0\] of the plan are under way; requests are taken over for \[\]")
    refused({0: there, 1: there}, r"taken over for \[0, 1\]")
    refused({0: replace(there, resources=("leg",))}, "has leg for itself; the plan says otherwise")
    twice = generate(plan_of_steps(ActionCall(0, ACT, under_way=True), ActionCall(1, ACT, under_way=True)))
    with pytest.raises(RunError, match="2 requests that are taken over have arm"):
        Run(twice, old.knowledge, id=UUID(int=2), adopted={0: there, 1: there})
    with pytest.raises(PlanGraphError, match="is under way: it cannot wait for others"):
        plan_of_steps(ActionCall(0, LAST), ActionCall(1, ACT, under_way=True), orders=("0e<1s",))


# --- what has begun and is not reported yet -------------------------------------------------------

SENSED = [("at", "hall"), ("at", "yard"), ("open",)]
VALUES = st.booleans() | st.just(UNKNOWN)
LEAVE = GroundAction("leave", start_effects=(Set(("at", "hall"), Constant(False)),), duration=4.0)


def seeing(**facts: bool) -> KnowledgeBase:
    return KnowledgeBase({("at", name): value for name, value in facts.items()}, sensed={"at": 1.0, "open": 1.0})


@given(
    st.dictionaries(st.sampled_from([*SENSED, ("assumed",)]), st.booleans(), min_size=1),
    st.dictionaries(st.sampled_from(SENSED), VALUES),
    st.lists(st.tuples(st.sampled_from(SENSED), VALUES), max_size=5),
)
def test_a_start_counts_until_something_is_reported_of_it(
    starts: dict[Fluent, bool], known: dict[Fluent, object], reports: list[tuple[Fluent, object]]
) -> None:
    effects = tuple(Set(fluent, Constant(value)) for fluent, value in starts.items())
    seen = KnowledgeBase(known, sensed={"at": 1.0, "open": 1.0})  # type: ignore[arg-type]
    run = going(GroundAction("act", start_effects=effects, duration=4.0), world=seen)
    said: set[Fluent] = set()
    for fluent, value in [*reports, (("other",), True)]:
        awaited = {one: starts[one] for one in SENSED if one in starts and one not in said}
        expected = {one: value for one, value in awaited.items() if not same_value(seen.value(one), value)}
        assert run.unreported == expected
        said.update(seen.update({fluent: value}))  # type: ignore[dict-item]


def test_it_counts_for_the_run_that_takes_the_call_over_and_not_anew() -> None:
    old = going(LEAVE, world=seeing(hall=True))
    new = successor(old)
    new.handle(Begin(), 2.0)
    new.take_the_place_of(old, 2.0)
    assert new.unreported == {("at", "hall"): False}
    new.knowledge.world.update({("at", "hall"): False})
    new.knowledge.world.update({("at", "hall"): True})
    new.handle(KnowledgeChanged(), 2.5)
    last = successor(new)
    last.take_the_place_of(new, 3.0)
    assert last.unreported == {}, "that it is back was reported before"


def test_what_is_over_has_begun_nothing() -> None:
    for outcome in (SUCCEEDED, CANCELED):
        run = going(LEAVE, world=seeing(hall=True))
        run.handle(Ended(run.open_requests[0], outcome), 5.0)
        assert run.unreported == {}
