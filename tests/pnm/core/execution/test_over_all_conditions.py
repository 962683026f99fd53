"""Over-all conditions: a report that one is false stops the call, unless it ends at that moment; what may not be reported yet has time."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import permutations
from math import nextafter
from uuid import UUID

import pytest

from pnm.clock import FollowingLoop
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Cancel, KnowledgeChanged, Tick, Wake
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import All, Any, Condition, Holds, Not
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from tests.support.runs.commands import begun, cancelled, in_its_moment, report
from tests.support.runs.handover import SUCCEEDED, ManualClient, going
from tests.support.runs.plan_graphs import plan_of

OPEN, LIT, HELD = ("open",), ("lit",), ("held",)
LAG = 1.0


def adds(*fluents: Fluent) -> tuple[Set, ...]:
    return tuple(Set(fluent, Constant(True)) for fluent in fluents)


def deletes(*fluents: Fluent) -> tuple[Set, ...]:
    return tuple(Set(fluent, Constant(False)) for fluent in fluents)


PASS = GroundAction("pass", invariant=Holds(OPEN), end_effects=adds(("inside",)), duration=5.0)
LIGHT = GroundAction("light", invariant=Holds(LIT), start_effects=adds(LIT), end_effects=deletes(("match",)), duration=5.0)
CARRY = GroundAction("carry", invariant=Holds(HELD), end_effects=(*deletes(HELD), *adds(("there",))), duration=5.0)


def passing(
    action: GroundAction, *facts: Fluent, sensed: tuple[str, ...] = ("open", "lit", "held"), rules: tuple[DerivationRule, ...] = ()
) -> Run:
    """A run whose one call was accepted at 1 s, and what is reported comes 1 s late at most."""
    return going(action, world=KnowledgeBase(dict.fromkeys(facts, True), sensed=dict.fromkeys(sensed, LAG), rules=Rules(rules)))


def failure_causes(run: Run) -> list[str]:
    return [failure.cause for failure in run.result().failures]


def test_what_was_reported_false_between_the_request_and_its_acceptance_acts_at_once() -> None:
    shut = replace(PASS, start_effects=adds(("moving",)))
    run = passing(shut, OPEN)
    assert cancelled(report(run, OPEN, False, 1.0))


def test_a_fact_that_the_start_of_the_call_makes_true_may_be_reported_late() -> None:
    run = passing(LIGHT)
    assert not cancelled(report(run, ("other",), True, 1.5))
    assert not cancelled(report(run, LIT, True, 1.9))
    assert not cancelled(run.handle(Tick(), 2.0)), "it has been seen in time"
    assert cancelled(report(run, LIT, False, 2.1)), "and goes out again: that is news"


def test_a_fact_that_the_start_should_make_true_and_is_never_reported_counts_as_false_after_the_lag() -> None:
    run = passing(LIGHT)
    assert cancelled(run.handle(Tick(), 1.0 + LAG))


def test_what_the_end_of_the_call_changes_may_be_seen_before_the_end_is_reported() -> None:
    run = passing(CARRY, HELD)
    assert report(run, HELD, False, 3.0) == [Wake(3.0 + LAG)]
    run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.5)
    assert run.result().goal


def test_what_the_end_of_the_call_changes_counts_when_the_end_does_not_come() -> None:
    run = passing(CARRY, HELD)
    report(run, HELD, False, 3.0)
    assert cancelled(run.handle(Tick(), 3.0 + LAG))


def test_one_part_that_may_be_late_does_not_excuse_another() -> None:
    both = replace(LIGHT, invariant=All((Holds(LIT), Holds(OPEN))))
    assert cancelled(report(passing(both, OPEN), OPEN, False, 1.2))


def test_what_is_no_longer_reported_has_the_lag_to_be_reported_again() -> None:
    run = passing(PASS, OPEN)
    assert report(run, OPEN, UNKNOWN, 2.0) == [Wake(2.0 + LAG)]
    report(run, OPEN, True, 2.5)
    assert not cancelled(run.handle(Tick(), 2.0 + LAG))


@pytest.mark.parametrize("condition", [Any((Holds(OPEN), Holds(LIT))), Not(All((Not(Holds(OPEN)), Not(Holds(LIT)))))])
def test_of_alternatives_one_is_enough(condition: Condition) -> None:
    run = passing(replace(PASS, invariant=condition), OPEN, LIT)
    assert not cancelled(report(run, OPEN, False, 2.0))
    assert cancelled(report(run, LIT, False, 2.5))


def test_a_derived_fact_is_false_as_soon_as_a_report_makes_it_so() -> None:
    free = DerivationRule("free", (), Holds(OPEN))
    assert cancelled(report(passing(replace(PASS, invariant=Holds(("free",))), OPEN, rules=(free,)), OPEN, False, 2.0))
    lit = DerivationRule("bright", (), Holds(LIT))
    run = passing(replace(LIGHT, invariant=Holds(("bright",))), rules=(lit,))
    assert not cancelled(report(run, ("other",), True, 1.5)), "below it is what the start makes true"


MATCH = GroundAction("match", start_effects=adds(LIT), end_effects=deletes(LIT), duration=8.0)
MEND = GroundAction("mend", precondition=Holds(LIT), invariant=Holds(LIT), end_effects=adds(("mended",)), duration=5.0)
CELLAR = plan_of(MATCH, MEND, orders=("0s<1s", "1e<0e"), goal=Holds(("mended",)))


def in_the_cellar(*sensed: str) -> tuple[Run, UUID, UUID]:
    """The match burns and the fuse is being mended; and the requests for that."""
    run, _ = begun(CELLAR, world=KnowledgeBase(sensed=dict.fromkeys(sensed, LAG)))
    verify(run.machine)
    (match,) = run.open_requests
    run.handle(Accepted(match), 0.0)
    report(run, LIT, True, 0.1)
    (mend,) = set(run.open_requests) - {match}
    run.handle(Accepted(mend), 0.2)
    return run, match, mend


def test_an_end_that_nothing_reports_is_believed_when_it_comes_even_if_it_should_come_later() -> None:
    run, match, mend = in_the_cellar()
    assert in_its_moment(run, Ended(match, SUCCEEDED), 3.0)[1:] == [Cancel(mend), Wake(8.0)], "the match is out"
    run.handle(Ended(mend, SUCCEEDED), 5.2)
    assert failure_causes(run) == ["invariant_false"]
    assert run.result().failures[0].observed == "(lit) is false"


def test_an_end_that_sensors_do_not_confirm_yet_has_time_until_it_should_come() -> None:
    run, match, mend = in_the_cellar("lit")
    assert not cancelled(run.handle(Ended(match, SUCCEEDED), 3.0))
    run.handle(Ended(mend, SUCCEEDED), 5.2)
    assert not run.over
    report(run, LIT, False, 5.3)
    assert run.result().goal


def test_what_an_end_relies_on_must_have_been_so_when_it_came() -> None:
    relying = GroundAction("close", end_condition=Holds(("mended",)), end_effects=adds(("closed",)), duration=8.0)
    mended = GroundAction("mend", end_effects=adds(("mended",)), duration=5.0)
    run, _ = begun(plan_of(relying, mended, orders=("1e<0e",)), Bindings({"close": Binding(retries=0)}))
    close, mend = run.open_requests
    run.handle(Ended(close, SUCCEEDED), 3.0)
    run.handle(Ended(mend, SUCCEEDED), 5.0)
    assert failure_causes(run) == ["effects_missing"]
    assert run.knowledge.value(("closed",)) is False, "what was believed is taken back"


@pytest.mark.parametrize("order", list(permutations(range(4))))
@pytest.mark.parametrize("breaks_at", [5.0, 4.0])
@pytest.mark.parametrize("sensed", [("lit",), ()])
def test_the_order_in_which_what_belongs_to_one_moment_is_heard_says_nothing(
    sensed: tuple[str, ...], breaks_at: float, order: tuple[int, ...]
) -> None:
    """A call ends at 5 s, and what it relies on breaks then as well, or a second before."""
    run, match, mend = in_the_cellar(*sensed)
    light = (Ended(match, SUCCEEDED), KnowledgeChanged(), Tick())
    events = (*light, Ended(mend, SUCCEEDED)) if breaks_at == 5.0 else light
    for event in [events[number] for number in order if number < len(events)]:
        if sensed:  # which come before the run is told
            run.knowledge.world.update({LIT: False})
        run.handle(event, breaks_at)
    run.handle(Tick(), nextafter(breaks_at, 6.0))
    run.handle(Ended(mend, SUCCEEDED), 5.0)
    assert run.over
    assert failure_causes(run) == ([] if breaks_at == 5.0 else ["invariant_false"])


class TickingClock:
    """A real clock: it goes on whenever it is read."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.001
        return self.now


def test_reports_that_come_together_are_of_one_moment_although_handling_them_takes_time() -> None:
    machine, client, world = generate(CELLAR), ManualClient(), KnowledgeBase(sensed={"lit": LAG})
    run = Run(machine, Layered(world), id=UUID(int=1))

    async def main() -> RunResult:
        executing = asyncio.ensure_future(Executor(run, client).execute())
        await asyncio.sleep(0.1)
        world.update({LIT: True})
        await asyncio.sleep(0.1)
        world.update({LIT: False})
        client.end("match")
        client.end("mend")
        return await executing

    with asyncio.Runner(loop_factory=lambda: FollowingLoop(TickingClock())) as runner:
        result = runner.run(main())
    assert (result.failures, result.goal) == ((), True)
