"""Resources that are withheld: their requests were given up, and nobody knows whether they have ended."""

from __future__ import annotations

from dataclasses import replace
from uuid import UUID

from pnm.clock import run_async
from pnm.core.execution.events import Pause, ResourcesChanged, Resume, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, Recovery, Then
from pnm.core.machine.requests import Accepted
from pnm.core.resources import Resources
from pnm.executor import Executor
from tests.support.runs.commands import begun, claim, sent
from tests.support.runs.handover import ManualClient
from tests.support.runs.plan_graphs import plan_of, plan_of_steps


def test_what_is_withheld_is_free_when_its_end_is_confirmed() -> None:
    pool, told = Resources({"leg": 2}), list[str]()
    pool.listen(lambda: told.append("called"))
    pool.take(claim(1, "arm", "leg"))
    pool.take(claim(2, "arm"))
    pool.withhold(UUID(int=1), "wave()")
    assert told == ["called"], "who waits is told that it may do so in vain"
    assert pool.withheld_from(["leg", "arm"]) == {"arm": "wave()"}, "there is another leg"
    assert [one.request.int for one in pool.held] == [1]
    pool.withhold(UUID(int=2), "nothing")
    pool.confirm(UUID(int=2))
    assert (len(pool.held), len(pool.line)) == (1, 1)
    pool.confirm(UUID(int=1))
    assert pool.held == ()
    assert told == ["called"] * 2
    assert pool.withheld_from(["arm"]) == {}


def test_nobody_is_outranked_for_what_it_cannot_give_back() -> None:
    pool = Resources()
    pool.take(claim(1, "arm", task=7))
    pool.withhold(UUID(int=1), "wave()")
    pool.take(claim(2, "arm", priority=1))
    assert not any(pool.outranking())


ACT = GroundAction("act", resources=("arm",))
LIMITS = Bindings({"act": Binding(timeout=10.0, cancel=5.0, retries=0), "next": Binding(accept=4.0)})


def given_up(pool: Resources) -> UUID:
    """A request that has been given up at 15 s, and keeps the arm."""
    run = resourceful("act", pool, 1)
    (request,) = run.open_requests
    run.handle(Accepted(request), 0.0)
    run.handle(Tick(), 10.0)
    run.handle(Tick(), 15.0)
    assert run.result().failures[0].unconfirmed
    return request


def resourceful(name: str, pool: Resources, number: int, *recoveries: Recovery) -> Run:
    call = ActionCall(0, replace(ACT, name=name), recoveries=recoveries)
    return begun(plan_of_steps(call), LIMITS, id=UUID(int=number), resources=pool)[0]


def test_a_request_that_was_given_up_keeps_what_it_has_and_who_waits_for_it_says_who_that_is() -> None:
    pool = Resources()
    given_up(pool)
    waiting = resourceful("next", pool, 2)
    assert not waiting.open_requests
    waiting.handle(Tick(), 3.9)
    assert not waiting.over
    waiting.handle(Tick(), 4.0)
    (failure,) = waiting.result().failures
    assert (failure.cause, failure.expected, failure.lacking) == ("withheld", "arm within 4 s", ("arm",))
    assert failure.observed == "arm is kept by act() of task 00000000, which has not confirmed that it is over"
    assert (len(pool.held), pool.line) == (1, ())


def test_a_request_that_was_given_up_gives_back_what_it_has_when_its_server_reports_late() -> None:
    pool = Resources()
    request = given_up(pool)
    waiting = resourceful("next", pool, 2)
    pool.confirm(request)
    assert sent(waiting.handle(ResourcesChanged(), 3.0)) == ["next"]


def test_the_time_for_what_is_withheld_does_not_pass_during_a_pause() -> None:
    pool = Resources()
    given_up(pool)
    waiting = resourceful("next", pool, 2)
    waiting.handle(Pause(), 1.0)
    waiting.handle(Tick(), 100.0)
    assert not waiting.over
    waiting.handle(Resume(), 101.0)
    waiting.handle(Tick(), 104.0)
    assert not waiting.over
    waiting.handle(Tick(), 105.0)
    assert waiting.over


def test_what_is_given_up_while_others_wait_is_noticed() -> None:
    pool = Resources()
    run = resourceful("act", pool, 1)
    waiting = resourceful("next", pool, 2)
    pool.withhold(run.open_requests[0], "act()")
    waiting.handle(ResourcesChanged(), 20.0)
    waiting.handle(Tick(), 23.0)
    assert not waiting.over
    waiting.handle(Tick(), 24.0)
    assert [one.cause for one in waiting.result().failures] == ["withheld"]


def test_a_plan_says_what_to_do_about_what_is_withheld_as_about_a_server_that_is_not_there() -> None:
    pool = Resources()
    given_up(pool)
    instead = Recovery(frozenset({Cause.UNAVAILABLE}), Then.SKIP, Flow((ActionCall(1, GroundAction("other")),)))
    waiting = resourceful("next", pool, 2, instead)
    assert sent(waiting.handle(Tick(), 4.0)) == ["other"]


def test_a_report_that_comes_after_the_end_of_a_run_frees_what_was_kept() -> None:
    pool, server = Resources(), ManualClient()
    run = Run(generate(plan_of(ACT), LIMITS), Layered(KnowledgeBase()), id=UUID(int=1), bindings=LIMITS, resources=pool)

    async def main() -> None:
        result = await Executor(run, server).execute()
        assert result.failures[0].unconfirmed
        assert [one.names for one in pool.held] == [("arm",)]
        server.end("act")
        assert pool.held == ()

    run_async(main(), virtual=True)
