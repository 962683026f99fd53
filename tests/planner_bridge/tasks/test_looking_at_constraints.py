"""A monitor looks at those constraints of which something else may be known: it knows what it would know if it looked at all."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.logic.trajectory import Constraint
from tests.support.logic.trajectories import LIKE_KAIROS, SAFE, P, Q
from tests.support.tasks.constraints import TO_C

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


@settings(deadline=None)
@given(CONSTRAINTS, st.dictionaries(st.sampled_from("pq"), st.sampled_from([0.0, 1.0])), STEPS)
def test_what_nothing_has_happened_to_is_not_looked_at(constraints: tuple[Constraint, ...], sensed: dict, steps: list) -> None:
    problem, world = replace(TO_C, constraints=constraints), KnowledgeBase(sensed=sensed)
    fast, readable = (ConstraintMonitor(problem, Layered(world)) for _ in range(2))
    now, noted = 0.0, None
    for passed, name, value in steps:
        now = now + passed if name != "nothing" else max(now, min(fast.next_look(now), now + 5.0))
        if name == "sensed":
            world.sense("pq", lag=float(value is True))
        elif name != "nothing":
            world.update({(name,): value})
        readable._changes = None
        assert fast.look(now) == readable.look(now)
        assert (
            fast.next_look(now)
            == readable.next_look(now)
            == min(one.progress.next_look(now, readable._lag(one)) for one in readable._ground)
        )
        assert fast.has_news is (readable.note != noted)
        noted = readable.note
        assert fast.note == noted
