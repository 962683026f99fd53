"""Constraints over courses of states: progression against the definitions, also while reports come late."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import inf

import kairos
import pytest
from hypothesis import example, given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Any, Holds, Not, evaluate
from pnm.core.logic.expressions import UNKNOWN, Variable
from pnm.core.logic.trajectory import (
    IMPOSSIBLE,
    Constraint,
    ConstraintProgress,
    instances,
    is_fulfilled,
    names_in,
    observed_of,
    progressed,
    shifted,
)
from tests.support.logic.trajectories import (
    AFTER,
    BEFORE,
    LIKE_KAIROS,
    ONCE,
    SAFE,
    P,
    Q,
    Rest,
    Trace,
    always,
    progress,
    sometime,
    state_of,
    traces,
)


def course(text: str, step: float = 1.0) -> Trace:
    """Read ``"- p pq q"``: which of p and q are true in each state, a second apart."""
    return [(number * step, state_of("p" in word, "q" in word)) for number, word in enumerate(text.split())]


def keeps(trace: Trace, constraint: Constraint) -> bool:
    """Tell whether the course keeps the ground constraint: Gerevini and Long (2005), word for word.

    A state is in force until the next; the last one at its own moment only.
    """
    n = len(trace) - 1
    time = [time for time, _ in trace]
    phi, psi = ([evaluate(condition, one) is True for _, one in trace] for condition in (constraint.conditions * 2)[:2])
    every = range(n + 1)
    match constraint.operator, constraint.times:
        case "at end", ():
            return phi[n]
        case "always", ():
            return all(phi[i] for i in every)
        case "sometime", ():
            return any(phi[i] for i in every)
        case "within", (t,):
            return any(phi[i] and time[i] <= t for i in every)
        case "at-most-once", ():
            return all(
                not phi[i]
                or any(all(phi[k] for k in range(i, j + 1)) and not any(phi[k] for k in range(j + 1, n + 1)) for j in range(i, n + 1))
                for i in every
            )
        case "sometime-after", ():
            return all(not phi[i] or any(psi[j] for j in range(i, n + 1)) for i in every)
        case "sometime-before", ():
            return all(not phi[i] or any(psi[j] for j in range(i)) for i in every)
        case "always-within", (t,):
            return all(not phi[i] or any(psi[j] and time[j] - time[i] <= t for j in range(i, n + 1)) for i in every)
        case "hold-during", (t, u):
            return all(phi[i] for i in every if max(time[i], t) < u and (time[i + 1] > t if i < n else time[i] >= t))
        case "hold-after", (t,):
            return all(phi[i] for i in every if (time[i + 1] > t if i < n else time[i] >= t))
        case _:
            raise AssertionError(constraint)


CONSTRAINTS = st.one_of(LIKE_KAIROS, SAFE)


# --- progression ---


@given(CONSTRAINTS, traces())
@example(Constraint("always-within", (P, Q), (1.0,)), course("p - q p pq"))
@example(Constraint("hold-during", (P,), (0.5, 2.0)), course("- - p"))
def test_progression_gives_the_verdict_of_the_definitions(constraint: Constraint, trace: Trace) -> None:
    assert is_fulfilled(progress((constraint,), trace), trace[-1][1], trace[-1][0]) == keeps(trace, constraint)


@given(CONSTRAINTS, traces(), st.data())
def test_what_is_left_says_of_the_rest_what_the_whole_says_of_the_whole(constraint: Constraint, trace: Trace, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(trace) - 1))
    elapsed = trace[cut][0]
    rest = [shifted(one, elapsed) for one in progress((constraint,), trace[: cut + 1])]
    later = [(time - elapsed, one) for time, one in trace[cut:]]
    assert all(keeps(later, one) for one in rest) == keeps(trace, constraint)


@given(SAFE, traces(st.tuples(*[st.sampled_from((True, False, UNKNOWN))] * 2)))
def test_what_is_unknown_violates_nothing(constraint: Constraint, trace: Trace) -> None:
    unknown = [(time, fluent) for time, one in trace for fluent in (("p",), ("q",)) if one.value(fluent) is UNKNOWN][:6]
    if IMPOSSIBLE not in progress((constraint,), trace):
        return
    for chosen in product((True, False), repeat=len(unknown)):
        values = dict(zip(unknown, chosen, strict=True))
        known = [
            (time, KnowledgeBase(one.facts() | {fluent: v for (when, fluent), v in values.items() if when == time})) for time, one in trace
        ]
        assert not keeps(known, constraint)


def test_what_is_unknown_fulfils_nothing() -> None:
    nobody_knows = [(0.0, state_of(UNKNOWN, UNKNOWN))]
    for constraint in (sometime(P), Constraint("within", (P,), (9.0,)), Constraint("at end", (P,))):
        assert not is_fulfilled(progress((constraint,), nobody_knows), nobody_knows[0][1])
    assert progress((Constraint("within", (P,), (0.0,)),), nobody_knows) == (IMPOSSIBLE,)
    assert progress((Constraint("sometime-before", (P, Q)),), [*nobody_knows, (1.0, state_of(p=True))]) == (IMPOSSIBLE,)


def test_of_several_deadlines_the_earliest_is_left() -> None:
    soon, late = (Constraint("within", (P,), (time,)) for time in (3.0, 5.0))
    assert progressed((soon, late), state_of()) == progressed((late, soon), state_of()) == (soon,)
    assert progressed((soon, Constraint("within", (Q,), (5.0,))), state_of()) == (soon, Constraint("within", (Q,), (5.0,)))


def test_a_constraint_stands_for_every_choice_of_objects() -> None:
    robots, rooms = Variable("?r", ("robot",)), Variable("?a", ("room",))
    lifted = Constraint("sometime-before", (Holds(("at", "?r", "?a")), Holds(("open", "?a"))), (), (robots, rooms))
    knowledge = KnowledgeBase(objects={"robot": ("r1", "r2"), "room": ("a", "b")})
    assert [str(one) for one in instances(lifted, knowledge)] == [
        f"(sometime-before (at {robot} {room}) (open {room}))" for robot in ("r1", "r2") for room in ("a", "b")
    ]
    assert str(lifted) == "(forall (?r - robot ?a - room) (sometime-before (at ?r ?a) (open ?a)))"
    assert names_in(lifted) == {"at", "open"}


def test_what_is_seen_in_place_of_a_constraint() -> None:
    assert observed_of(always(All((Not(P), Q))), state_of(p=True, q=True)) == "(p) is true"
    assert observed_of(always(Not(P)), state_of(p=True)) == "(p) is true"
    assert observed_of(BEFORE, state_of(p=True)) == "(p) is true; (q) is false"


def test_something_else_than_a_constraint_is_refused() -> None:
    for wrong in (Constraint("always", (P, Q)), Constraint("within", (P,)), Constraint("seldom", (P,))):
        with pytest.raises(ValueError, match="not a ground constraint"):
            progressed((wrong,), state_of())


_ACTIONS = "".join(
    f"(:action {name} :parameters () :effect (and {' '.join(f'({one})' if one in name else f'(not ({one}))' for one in 'pq')}))"
    for name in ("pq", "px", "xq", "xx")
)
DOMAIN = kairos.parse_domain(
    f"(define (domain d) (:requirements :adl :durative-actions :constraints) (:predicates (p) (q) (r)) {_ACTIONS}"
    "(:durative-action wait :parameters () :duration (= ?duration 1) :effect (at end (r))))"
)


# --- the same definitions, read by others ---


@given(LIKE_KAIROS, traces())
def test_the_planner_reads_the_definitions_as_we_do(constraint: Constraint, trace: Trace) -> None:
    def word(one: KnowledgeBase) -> str:
        return "".join(name if one.value((name,)) else "x" for name in "pq")

    first = " ".join(f"({name})" for name in "pq" if trace[0][1].value((name,)))
    text = f"(define (problem x) (:domain d) (:init {first}) (:goal (and)) (:constraints {constraint}))"
    plan = "".join(f"{time:.3f}: ({word(one)})\n" for time, one in trace[1:])
    assert kairos.validate(kairos.parse_problem(text, DOMAIN), kairos.parse_plan(plan)).valid == keeps(trace, constraint)


# --- watched while reports come late ---


NEVER_P = always(Not(P))
SOON = Constraint("always-within", (P, Q), (2.0,))


def watched(constraint: Constraint, seen: Trace, until: float = 100.0, lag: float = 1.0) -> ConstraintProgress:
    """Look at each state when it is reported, and whenever the watch asks for a look."""
    watch = ConstraintProgress((constraint,))
    ends = [*(time for time, _ in seen[1:]), until]
    for (now, one), end in zip(seen, ends, strict=True):
        watch = watch.seen(one, now, lag)
        while (again := watch.next_look(now, lag)) < end:
            now, watch = again, watch.seen(one, again, lag)
    return watch


def reports(text: str) -> Trace:
    """Read ``"0:p 3:- 3.5:pq"``: what is reported to be true, and when."""
    return [(float(word.split(":")[0]), state_of("p" in word, "q" in word)) for word in text.split()]


EITHER = always(Any((P, Q)))
BY_3, FROM_3 = (Constraint(name, (P,), (3.0,)) for name in ("within", "hold-after"))


@pytest.mark.parametrize(
    ("constraint", "seen", "left"),
    [
        (always(P), "0:p 3:- 3.5:p", (always(P),)),
        (always(P), "0:p 3:-", (IMPOSSIBLE,)),
        (EITHER, "0:p 3:- 3:q", (EITHER,)),
        (EITHER, "0:p 3:- 3.9:q 4.5:- 5.4:p", (EITHER,)),
        (sometime(P), "0:- 3:p 3:-", ()),
        (AFTER, "0:- 3:p 3:-", (AFTER, sometime(Q))),
        (AFTER, "0:- 3:p 3:q", (AFTER,)),
        (BEFORE, "0:- 3:q 3:p", ()),
        (BEFORE, "0:- 3:p 3.5:- 5:q", ()),
        (BEFORE, "0:- 3:p 3:pq", (IMPOSSIBLE,)),
        (ONCE, "0:p 3:- 3.5:p", (replace(ONCE, begun=True),)),
        (ONCE, "0:p 3:p 3:-", (NEVER_P,)),
        (ONCE, "0:p 3:- 5:p 5.5:-", (NEVER_P,)),
        (ONCE, "0:p 3:- 5:p", (IMPOSSIBLE,)),
        (BY_3, "0:- 3.5:p", ()),
        (BY_3, "0:- 4.5:p", (IMPOSSIBLE,)),
        (SOON, "0:- 3:p 4:- 5.5:q", (SOON,)),
        (SOON, "0:- 3:p 4:- 6.5:q", (IMPOSSIBLE,)),
        (Constraint("hold-during", (P,), (3.0, 9.0)), "0:- 3.5:p 8.5:- 8.9:p 9:-", ()),
        (Constraint("hold-during", (P,), (3.0, 9.0)), "0:- 5:p", (IMPOSSIBLE,)),
        (FROM_3, "0:- 3.5:p 8:- 8.5:p", (FROM_3,)),
        (FROM_3, "0:p 3.9:- 4.1:p", (FROM_3,)),
        (FROM_3, "0:- 4.5:p", (IMPOSSIBLE,)),
    ],
    ids=str,
)
def test_what_helps_counts_at_once_and_what_harms_if_it_lasts_for_the_lag(constraint: Constraint, seen: str, left: Rest) -> None:
    assert watched(constraint, reports(seen)).rest == left


def test_a_watch_says_when_it_wants_to_look_again() -> None:
    watch = ConstraintProgress((BY_3,)).seen(state_of(), 0.0, 1.0)
    assert watch.next_look(0.0, 1.0) == 3.0
    watch = watch.seen(state_of(), 3.0, 1.0)
    assert (watch.doubtful_since, watch.violated, watch.next_look(3.0, 1.0)) == (3.0, False, 4.0)
    watch = watch.seen(state_of(), 4.0, 1.0)
    assert (watch.violated, watch.next_look(4.0, 1.0)) == (True, inf)


@given(CONSTRAINTS, traces())
def test_reports_without_a_lag_are_believed_at_once(constraint: Constraint, trace: Trace) -> None:
    assert watched(constraint, trace, until=trace[-1][0], lag=0.0) == ConstraintProgress(progress((constraint,), trace))
