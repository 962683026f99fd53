"""The pool of resources: claims, priorities, fairness, and what is withheld."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from random import Random
from uuid import UUID

from hypothesis import given, strategies as st

from pnm.core.execution.events import Begin, Send, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind
from pnm.core.resources import Claim, Resources
from tests.support.runs.commands import claim


def test_a_claim_stands_in_line_once_and_where_it_came_first() -> None:
    pool = Resources()
    pool.take(claim(1, "arm"))
    for number in (2, 3, 2):
        assert not pool.take(claim(number, "arm"))
    assert [one.request.int for one in pool.line] == [2, 3]
    assert not pool.take(claim(2, "arm", "leg")), "another claim comes anew"
    assert [one.request.int for one in pool.line] == [3, 2]


def test_only_the_one_whose_turn_it_is_is_told() -> None:
    pool, told = Resources({"leg": 2}), list[str]()
    for number, names in enumerate((("arm",), ("leg",), ("arm", "leg"), ("arm",), ("leg",)), 1):
        pool.listen(lambda number=number: told.append(f"{number}"), UUID(int=number))  # type: ignore[misc]
        pool.take(claim(number, *names, task=number))
    pool.take(claim(6, "eye", task=6))
    assert told == [], "the second leg is for the third in line, which waits for the arm as well"
    pool.give(UUID(int=6))
    pool.give(UUID(int=2))
    assert told == ["5"]
    assert pool.take(claim(5, "leg", task=5))
    pool.give(UUID(int=1))
    assert told == ["5", "3"]
    pool.take(claim(3, "eye", task=3))
    assert told == ["5", "3", "4"], "it wants something else now"


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
