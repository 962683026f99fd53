"""Constraints of tasks, on simulated robots: what is violated ends a task, what is missing does not; and from PDDL text to the goal."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from planner_bridge.tasks.replanning import Limits, PlanAgain
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Settings
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds, Not
from pnm.core.logic.expressions import UNKNOWN, Variable
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from tests.support.logic.trajectories import LIKE_KAIROS, SAFE, P, Q, always, sometime
from tests.support.runs.simulated import LateBackend
from tests.support.tasks.constraints import TO_C, changes, monitored, within
from tests.support.tasks.replanning import pursued
from tests.support.tasks.rooms import done as calls_done, ring

A, B, C, D = (Holds(("clean", room)) for room in "abcd")
ROOM = Variable("?a", ("room",))


def constrained(*constraints: Constraint, problem: Problem = TO_C) -> Problem:
    return replace(problem, constraints=constraints)


# --- violated ---


def test_a_violated_constraint_stops_the_run_and_ends_the_task() -> None:
    done = monitored(constrained(always(Not(B))), changes((0.3, "b")))
    assert not done.result.goal_reached
    assert done.result.reason == "(always (not (clean b))) is violated after 0.30 s: (clean b) is true"
    assert done.outcomes() == ["canceled", "skipped"]
    assert not any(failure.unconfirmed for failure in done.result.failures)
    assert done.truth.value(("at", "r1", "a")) is True
    assert done.statuses() == ["violated"]
    assert [(round(now, 6), violation.time) for now, violation in done.log.told] == [(0.31, 0.3)]
    assert done.ended < 0.4


def test_a_violation_that_is_made_good_before_all_reports_are_in_does_not_count() -> None:
    done = monitored(constrained(always(Not(B))), changes((0.3, "b"), (0.305, "not b")))
    assert done.result.goal_reached
    assert done.statuses() == ["fulfilled"]


def test_a_violation_at_the_very_end_counts() -> None:
    done = monitored(constrained(always(Not(B))), changes((1.995, "b")))
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.reason == "(always (not (clean b))) is violated after 2.00 s: (clean b) is true"
    assert not done.result.goal_reached
    assert done.result.as_json()["decisions"] == []


def test_a_violation_that_is_reported_after_the_end_counts() -> None:
    problem = constrained(always(Not(B)))
    done = monitored(problem, backend=LateBackend(problem, Bindings(), changes((2.65, "b"))))
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.reason == "(always (not (clean b))) is violated after 2.95 s: (clean b) is true"
    assert done.result.as_json()["decisions"] == []


class SlowBackend(SimulatedBackend):
    """Servers are looked for so long."""

    async def prepare(self, actions: Iterable[GroundAction]) -> None:
        await asyncio.sleep(5.0)


def test_nothing_is_started_when_a_constraint_is_violated_before() -> None:
    problem = constrained(always(Not(B)))
    done = monitored(problem, backend=SlowBackend(robots_of(problem, Bindings(), changes((2.0, "b")))))
    assert [call.attempts for call in done.result.calls] == [0, 0]
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 2.00 s")


def test_a_constraint_that_the_initial_state_violates_leaves_nothing_to_plan() -> None:
    done = monitored(constrained(always(Not(Holds(("at", "r1", "a"))))))
    assert done.result.reason == "(always (not (at r1 a))) is violated after 0.00 s: (at r1 a) is true"
    assert (done.log.asked, done.result.calls) == (0, ())


def test_constraints_of_the_domain_count_for_every_object() -> None:
    nowhere = always(Not(Holds(("clean", "?a"))), ROOM)
    problem = replace(TO_C, domain=replace(TO_C.domain, constraints=(nowhere,)))
    done = monitored(problem, changes((0.5, "d"), (0.5, "c")))
    assert done.statuses() == ["violated"]
    assert [str(one.constraint) for one in done.result.constraints[0].violations] == [f"(always (not (clean {room})))" for room in "cd"]
    assert done.result.reason.startswith("(always (not (clean c))) is violated after 0.50 s")


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"at", "clean"})])
def test_a_deadline_that_passes_ends_the_task(assumed: frozenset[str]) -> None:
    slow = Faults((Fault("move", FaultKind.SLOW, after=1),))
    done = monitored(constrained(within(3.5, Holds(("at", "r1", "c")))), slow, bindings=Bindings(assumed=assumed))
    assert done.result.reason == "(within 3.5 (at r1 c)) is violated after 3.50 s: (at r1 c) is false"
    assert done.outcomes() == ["succeeded", "canceled"]
    assert [round(now, 6) for now, _ in done.log.told] == [3.51]


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"at"})])
def test_a_deadline_may_be_met_at_the_last_moment(assumed: frozenset[str]) -> None:
    done = monitored(constrained(within(1.0, Holds(("at", "r1", "b")))), bindings=Bindings(assumed=assumed))
    assert done.result.goal_reached, done.result.reason
    assert done.statuses() == ["fulfilled"]


def test_a_violation_while_waiting_to_try_again_ends_the_task_at_once() -> None:
    aborts = Faults((Fault("move", FaultKind.ABORT),), changes((20.0, "b")).changes)
    done = monitored(constrained(always(Not(B))), aborts, limits=Limits(backoff=1000.0, longest_backoff=1000.0, forbid_after=100))
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 20.00 s")
    assert done.ended < 21.0
    assert done.log.asked == done.result.plans == 1


def test_the_constraints_are_watched_in_every_episode() -> None:
    aborts = Faults((Fault("move(r1, b, c)", FaultKind.ABORT, times=2),), changes((0.5, "a"), (2.5, "b")).changes)
    done = monitored(constrained(Constraint("at-most-once", (A,)), always(Not(B))), aborts)
    assert done.result.replans == 1
    assert done.statuses() == ["fulfilled", "violated"]
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 2.50 s")


# --- fulfilled ---


def test_what_was_so_for_one_moment_was_so_sometime() -> None:
    visits = sometime(Holds(("at", "r1", "b")))
    done = monitored(constrained(visits, sometime(A)), changes((0.5, "a"), (0.5, "not a")))
    assert done.result.goal_reached
    assert done.statuses() == ["fulfilled", "fulfilled"]


def test_a_goal_that_holds_is_not_reached_while_something_is_missing() -> None:
    in_vain = Faults((Fault("sweep", FaultKind.NO_EFFECT),))
    done = monitored(constrained(sometime(B)), in_vain, limits=Limits(replans=0))
    assert not done.result.goal_reached
    assert done.result.reason.startswith("the limit of 0 replans is reached")
    assert done.result.reason.endswith("; not fulfilled: (sometime (clean b))")
    assert done.statuses() == ["violated"]


def test_a_cancelled_task_tells_what_was_not_fulfilled() -> None:
    done = monitored(constrained(sometime(B), always(Not(D))), limits=Limits(seconds=0.5))
    assert done.result.reason == "the limit of 0.5 s is reached"
    assert done.statuses() == ["violated", "fulfilled"]


def test_a_violation_is_told_once() -> None:
    world = KnowledgeBase()
    watching = ConstraintMonitor(constrained(always(Not(B))), Layered(world))
    watching.look(0.0)
    world.update({("clean", "b"): True})
    assert [[violation.time for violation in watching.look(now)] for now in (1.0, 1.005, 1.02, 2.0, 3.0)] == [[], [], [1.0], [], []]


def test_a_task_that_never_began_has_monitored_nothing() -> None:
    monitor = ConstraintMonitor(constrained(always(B)), Layered(KnowledgeBase()))
    assert [one.status for one in monitor.constraint_results(0.0)] == ["not monitored"]


# --- looks ---

TIMED = st.one_of(
    st.tuples(st.sampled_from([1.0, 3.0]), st.sampled_from([0.0, 2.0])).map(lambda t: Constraint("hold-during", (P,), (t[0], sum(t)))),
    st.builds(lambda time: Constraint("hold-after", (Q,), (time,)), st.sampled_from([0.0, 2.0])),
    st.builds(lambda time: Constraint("within", (Q,), (time,)), st.sampled_from([1.0, 3.0])),
    st.builds(lambda time: Constraint("always-within", (P, Q), (time,)), st.sampled_from([1.0, 2.0])),
)
CONSTRAINTS = st.lists(st.one_of(LIKE_KAIROS, SAFE, TIMED), min_size=1, max_size=4).map(tuple)
VALUES = st.sampled_from([True, False, UNKNOWN])
STEPS = st.lists(
    st.tuples(st.sampled_from([0.0, 0.3, 1.0]), st.sampled_from(["p", "q", "other", "sensed", "nothing"]), VALUES), max_size=15
)


@given(CONSTRAINTS, st.dictionaries(st.sampled_from("pq"), st.sampled_from([0.0, 1.0])), STEPS)
def test_what_nothing_has_happened_to_is_not_looked_at(constraints: tuple[Constraint, ...], sensed: dict, steps: list) -> None:
    problem, world = replace(TO_C, constraints=constraints), KnowledgeBase(sensed=sensed)
    fast, readable = (ConstraintMonitor(problem, Layered(world)) for _ in range(2))
    now, noted = 0.0, None
    for passed, name, value in steps:
        now = now + passed if name != "nothing" else max(now, min(fast.next_look(), now + 5.0))
        if name == "sensed":
            world.sense("pq", lag=float(value is True))
        elif name != "nothing":
            world.update({(name,): value})
        readable._changes = None
        assert fast.look(now) == readable.look(now)
        assert fast.next_look() == readable.next_look() == min(one.progress.next_look(now, readable._lag(one)) for one in readable._ground)
        assert fast.has_news is (readable.note != noted)
        noted = readable.note
        assert fast.note == noted


# --- from PDDL text to the goal ---


def statuses(result: TaskResult) -> list[str]:
    return [one.status for one in result.constraints]


# --- planned for, and kept ---


@pytest.mark.parametrize(
    ("constraint", "calls"),
    [
        ("(sometime (clean d))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
        ("(always (not (at r1 b)))", ["move(r1, a, d)", "move(r1, d, c)"]),
        ("(forall (?a - room) (sometime-after (at r1 ?a) (clean d)))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
        ("(and (sometime-before (at r1 c) (clean d)) (at end (not (clean a))))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
    ],
)
def test_a_plan_keeps_the_constraints_and_so_does_its_run(constraint: str, calls: list[str]) -> None:
    result, _ = pursued(ring(constraint))
    assert result.goal_reached, result.reason
    assert calls_done(result) == calls
    assert set(statuses(result)) == {"fulfilled"}


TAKEN_TO_C = Faults(
    (Fault("sweep(r1, d)", FaultKind.ABORT, times=2),), (HiddenChange({("at", "r1", "d"): False, ("at", "r1", "c"): True}, at=1.9),)
)
"""The robot is in d, cannot sweep it, and is carried to c."""


# --- planned for again ---


@pytest.mark.parametrize("constraint", ["(sometime (clean d))", "(and (sometime-after (at r1 d) (clean d)) (always (not (at r1 b))))"])
def test_a_goal_that_holds_is_planned_for_while_something_is_missing(constraint: str) -> None:
    result, truth = pursued(ring(constraint), TAKEN_TO_C)
    assert result.goal_reached, result.reason
    assert isinstance(result.episodes[0].decision, PlanAgain)
    assert truth.value(("clean", "d")) is True


def test_what_may_not_happen_again_is_avoided_after_a_failure() -> None:
    back = HiddenChange({("at", "r1", "b"): False, ("at", "r1", "a"): True, ("way", "a", "d"): True, ("way", "d", "c"): True}, at=1.9)
    faults = Faults((Fault("move(r1, b, c)", FaultKind.ABORT, times=2),), (back,))
    result, _ = pursued(ring("(at-most-once (at r1 b))", ways="(way a b) (way b c)"), faults)
    assert result.goal_reached, result.reason
    assert calls_done(result) == ["move(r1, a, b)", "move(r1, a, d)", "move(r1, d, c)"]
    assert statuses(result) == ["fulfilled"]


WALKS = """
(define (domain walks) (:requirements :adl :durative-actions :constraints)
  (:predicates (at ?a) (way ?a ?b))
  (:durative-action walk :parameters (?a ?b) :duration (= ?duration 4)
    :condition (and (at start (at ?a)) (over all (way ?a ?b)))
    :effect (and (at start (not (at ?a))) (at end (at ?b)))))
"""


def walk(constraints: str) -> Problem:
    text = "(define (problem p) (:domain walks) (:objects a b c) (:init (at a) (way a b) (way b c)) (:goal (at c))"
    return parse_problem(f"{text} (:constraints {constraints}))", parse_domain(WALKS))


TRIED_TWICE = Faults((Fault("walk(b, c)", FaultKind.ABORT, times=2),))
"""After four seconds in vain the robot is still in b; it is then eight seconds after the start."""


# --- times ---


def test_a_deadline_that_a_new_plan_can_meet_is_met() -> None:
    result, _ = pursued(walk("(within 13 (at c))"), TRIED_TWICE)
    assert result.goal_reached, result.reason
    assert (result.replans, statuses(result)) == (1, ["fulfilled"])


def test_a_deadline_that_no_plan_can_meet_any_more_ends_the_task() -> None:
    result, _ = pursued(walk("(within 11 (at c))"), TRIED_TWICE, Settings(planner_timeout=0.5))  # it finds none, but no proof either
    assert not result.goal_reached
    assert "; no plan" in result.reason
    assert statuses(result) == ["violated"]
