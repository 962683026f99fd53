"""What calls under way have changed at their start, until the sensors that report it say something."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pnm.core.execution.events import Begin, KnowledgeChanged
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, same_value
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended
from tests.support.runs.handover import CANCELED, SUCCEEDED, going, successor

SENSED = [("at", "hall"), ("at", "yard"), ("open",)]
VALUES = st.booleans() | st.just(UNKNOWN)
LEAVE = GroundAction("leave", start_effects=(Set(("at", "hall"), Constant(False)),), duration=4.0)


def world(**facts: bool) -> KnowledgeBase:
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


def test_a_robot_that_is_seen_to_leave_and_to_be_back_is_back() -> None:
    run = going(LEAVE, world=world(hall=True))
    assert run.unreported == {("at", "hall"): False}
    run.knowledge.world.update({("at", "hall"): False})
    run.knowledge.world.update({("at", "hall"): True})
    assert run.unreported == {}


def test_it_counts_for_the_run_that_takes_the_call_over_and_not_anew() -> None:
    old = going(LEAVE, world=world(hall=True))
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
        run = going(LEAVE, world=world(hall=True))
        run.handle(Ended(run.open_requests[0], outcome), 5.0)
        assert run.unreported == {}
