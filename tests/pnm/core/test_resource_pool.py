"""The pool of resources: claims, priorities, fairness, and what is withheld because nobody knows whether its request has ended."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from random import Random
from uuid import UUID

from hypothesis import given, strategies as st

from pnm.clock import run_async
from pnm.core.execution.events import Begin, Pause, ResourcesChanged, Resume, Send, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Claim, Resources
from pnm.executor import Executor
from tests.support.runs.commands import begun, claim, sent
from tests.support.runs.handover import ManualClient
from tests.support.runs.plan_graphs import plan_of, plan_of_steps


def test_a_claim_stands_in_line_once_and_where_it_came_first() -> None:
    pool = Resources()
    pool.take(claim(1, "arm"))
    for number in (2, 3, 2):
        assert not pool.take(claim(number, "arm"))
    assert [one.request.int for one in pool.line] == [2, 3]
    assert not pool.take(claim(2, "arm", "leg")), "another claim comes anew"
    assert [one.request.int for one in pool.line] == [3, 2]


def test_whoever_waits_for_what_is_withheld_is_told() -> None:
    pool, told = Resources(), list[str]()
    for number, names in enumerate((("arm",), ("leg",), ("arm", "eye"), ("leg",)), 1):
        pool.listen(lambda number=number: told.append(f"{number}"), UUID(int=number))  # type: ignore[misc]
        pool.take(claim(number, *names, task=number))
    pool.withhold(UUID(int=1), "lift()")
    assert told == ["3"]


def test_a_call_that_goes_on_after_a_recovery_waits_with_a_limit_for_what_it_was_sent_with() -> None:
    pool = Resources()
    bindings = Bindings({"move": Binding(accept=4.0, retries=0, resources=("{robot}",))})
    mending = Recovery(frozenset({Cause.ABORTED}), Then.CONTINUE, Flow((ActionCall(1, GroundAction("mend")),)))
    graph = PlanGraph((ActionCall(0, GroundAction("move", ("?robot",), ("robot",)), recoveries=(mending,)),))
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=1), bindings=bindings, resources=pool)
    (sent,) = (one for one in run.handle(Begin(), 0.0) if isinstance(one, Send))
    run.handle(Ended(sent.request.id, Outcome(OutcomeKind.ABORTED)), 1.0)
    pool.take(claim(9, "r1"))
    pool.withhold(UUID(int=9), "lift()")
    (mend,) = run.open_requests
    run.handle(Ended(mend, Outcome(OutcomeKind.SUCCEEDED, {"robot": "r2"})), 2.0)
    assert [one.names for one in pool.line] == [("r1",)]
    run.handle(Tick(), 6.0)
    (failure,) = run.result().failures
    assert (failure.cause, failure.lacking) == ("withheld", ("r1",))


@dataclass
class Worker:
    """Wants something so many times, one after the other. The mutable state is what has a default."""

    number: int
    priority: int
    names: tuple[str, ...]
    times: int
    has: bool = False
    waits: bool = False

    @property
    def claim(self) -> Claim:
        return claim(self.number * 100 + self.times, *self.names, priority=self.priority, task=self.number)


@dataclass
class Fair:
    """What the pool does, said in other words: everybody in line, in the order in which they came."""

    capacities: dict[str, int]
    having: dict[int, tuple[str, ...]] = field(default_factory=dict)
    came: list[Worker] = field(default_factory=list)

    def may(self, worker: Worker) -> bool:
        everybody = self.came if worker in self.came else [*self.came, worker]
        served = sorted(everybody, key=lambda one: -one.priority)
        before = served[: served.index(worker)]
        used = Counter(name for names in (*self.having.values(), *(one.names for one in before)) for name in names)
        return all(used[name] + 1 <= self.capacities.get(name, 1) for name in worker.names)


def outranked(pool: Resources, capacities: dict[str, int]) -> set[UUID]:
    """The tasks that have what a claim of higher priority waits for, pair by pair."""
    used = Counter(name for one in pool.held for name in one.names)
    short = {name for name, count in used.items() if count >= capacities.get(name, 1)}
    pairs = ((held, waits) for held in pool.held for waits in pool.line if held.task != waits.task and held.priority < waits.priority)
    return {held.task for held, waits in pairs if not short.isdisjoint({*held.names} & {*waits.names})}


NAMES = st.lists(st.sampled_from(["arm", "leg", "eye"]), min_size=1, unique=True).map(tuple)
WORKERS = st.lists(st.tuples(st.integers(0, 2), NAMES, st.integers(1, 3)), min_size=1, max_size=6)


@given(WORKERS, st.dictionaries(st.sampled_from(["arm", "leg"]), st.integers(1, 2)), st.integers(0, 2**32))
def test_nobody_has_too_much_everybody_is_served_and_equals_in_order(
    wanted: list[tuple[int, tuple[str, ...], int]], capacities: dict[str, int], seed: int
) -> None:
    pool, fair, random = Resources(capacities), Fair(capacities), Random(seed)
    workers = [Worker(number, *one) for number, one in enumerate(wanted)]
    told, turn = set[int](), set[int]()
    for worker in workers:
        pool.listen(partial(told.add, worker.number), UUID(int=worker.number))
    for _ in range(1000):
        going_on = [one for one in workers if one.times]
        if not going_on:
            break
        worker = random.choice(going_on)
        if worker.has:
            pool.give(worker.claim.request)
            fair.having.pop(worker.number)
            worker.has, worker.times = False, worker.times - 1
        elif worker.waits and random.random() < 0.1:
            pool.withdraw(worker.claim.request)
            fair.came.remove(worker)
            worker.waits = False
        else:
            may = fair.may(worker)
            assert pool.is_free(worker.claim) is may
            assert pool.take(worker.claim) is may
            if worker in fair.came:
                fair.came.remove(worker) if may else None
            elif not may:
                fair.came.append(worker)
            worker.has, worker.waits = may, not may
            if may:
                fair.having[worker.number] = worker.names
        had_its_turn, turn = turn, {one.number for one in workers if one.waits and fair.may(one)}
        assert turn - had_its_turn <= told <= turn, "whoever has its turn is told, and nobody else"
        told.clear()
        served = sorted((one for one in fair.came if one.number in turn), key=lambda one: -one.priority)
        assert pool.concerned(dict.fromkeys(one.request for one in pool.line).keys()) == [one.claim.request for one in served]
        assert {lower.task for _, lower in pool.outranking()} == outranked(pool, capacities)
        used = Counter(name for one in pool.held for name in one.names)
        assert all(count <= capacities.get(name, 1) for name, count in used.items())
        assert [one.request for one in pool.line] == [one.claim.request for one in sorted(fair.came, key=lambda one: -one.priority)]
        assert pool.held or not pool.line or any(map(pool.is_free, pool.line))
    else:
        raise AssertionError(f"somebody is never served: {pool}")


# --- requests that were given up ---


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
