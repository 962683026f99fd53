"""Constraints that are watched while reports come late."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.conditions import Any, Not
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint, ConstraintProgress
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

CONSTRAINTS = st.one_of(LIKE_KAIROS, SAFE)
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
