"""Constraints and courses of states, and the progression of the one over the other."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Any, Condition, Holds, Not
from pnm.core.logic.expressions import Unknown, Variable
from pnm.core.logic.trajectory import Constraint, moments, progressed

P, Q = Holds(("p",)), Holds(("q",))
Trace = list[tuple[float, KnowledgeBase]]
Rest = tuple[Constraint, ...]


def state_of(p: bool | Unknown = False, q: bool | Unknown = False) -> KnowledgeBase:
    return KnowledgeBase({("p",): p, ("q",): q})


def always(condition: Condition, *variables: Variable) -> Constraint:
    return Constraint("always", (condition,), (), variables)


def sometime(condition: Condition) -> Constraint:
    return Constraint("sometime", (condition,))


def progress(rest: Rest, trace: Trace) -> Rest:
    """Progress through a course, as a monitor does: with every state, and when a moment comes that matters."""
    rest = progressed(rest, trace[0][1], trace[0][0])
    for (before, old), (after, new) in pairwise(trace):
        now = before
        while due := [moment for one in rest for moment in moments(one) if now < moment < after]:
            now = min(due)
            rest = progressed(rest, old, now)
        rest = progressed(rest, new, after)
    return rest


BOOLEANS = st.tuples(st.booleans(), st.booleans())


@st.composite
def traces(draw: st.DrawFn, values: st.SearchStrategy[tuple[bool | Unknown, bool | Unknown]] = BOOLEANS) -> Trace:
    pauses = draw(st.lists(st.sampled_from((0.5, 1.0, 2.5)), max_size=6))
    return [(sum(pauses[:number]), state_of(*draw(values))) for number in range(len(pauses) + 1)]


TIMES = st.sampled_from((0.0, 0.5, 1.0, 2.0, 3.5, 6.0))
CONDITIONS = st.sampled_from((P, Q, Not(P), All((P, Q)), Any((P, Q))))
ONE = st.tuples(CONDITIONS)
TWO = st.tuples(CONDITIONS, CONDITIONS)
SAFE = st.one_of(
    st.builds(Constraint, st.sampled_from(("always", "at-most-once")), ONE),
    st.builds(Constraint, st.just("hold-during"), ONE, st.tuples(TIMES, TIMES)),
    st.builds(Constraint, st.just("hold-after"), ONE, st.tuples(TIMES)),
)
"""Constraints that only what is known to be so can violate."""
LIKE_KAIROS = st.one_of(
    st.builds(Constraint, st.sampled_from(("at end", "always", "sometime", "at-most-once")), ONE),
    st.builds(Constraint, st.sampled_from(("sometime-after", "sometime-before")), TWO),
    st.builds(Constraint, st.just("within"), ONE, st.tuples(TIMES)),
    st.builds(Constraint, st.just("always-within"), TWO, st.tuples(TIMES)),
)
"""Constraints whose definitions everybody reads in the same way."""
ONCE, AFTER, BEFORE = (
    Constraint(name, (P, Q)[:count]) for name, count in (("at-most-once", 1), ("sometime-after", 2), ("sometime-before", 2))
)
