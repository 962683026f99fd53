"""The codec of journals: what is written is read back, and nothing else is."""

from __future__ import annotations

from enum import Enum
from uuid import UUID

import pytest
from hypothesis import given, strategies as some

from pnm.core.execution.call_results import Failure
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.conditions import All, Holds, Not
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted
from pnm.journal.codec import RECORDS, Undecodable
from pnm.journal.records import Happened

PLAIN = some.none() | some.booleans() | some.integers() | some.floats(allow_nan=False) | some.text() | some.uuids() | some.binary()
VALUES = some.recursive(
    PLAIN,
    lambda inner: (
        some.lists(inner)
        | some.lists(inner).map(tuple)
        | some.dictionaries(some.text(), inner)
        | some.dictionaries(some.tuples(some.text(), some.text()), inner)
    ),
    max_leaves=20,
)


@given(VALUES)
def test_values_are_read_back_with_their_types(value: object) -> None:
    read = RECORDS.value(RECORDS.text(value))
    assert (read, type(read)) == (value, type(value))


def test_plans_are_read_back() -> None:
    action = GroundAction("move", ("r1", "a"), ("r", "to"), precondition=All((Holds(("at", "r1", "b")), Not(Holds(("at", "r1", "a"))))))
    ordering = Ordering(PlanEvent(0, Moment.END), PlanEvent(1, Moment.START), (("at", "r1", "a"),))
    graph = PlanGraph((ActionCall(0, action), ActionCall(1, action, timeout=3.0)), (ordering,), capacities={"lift": 2})
    assert RECORDS.value(RECORDS.text(graph)) == graph


def test_fields_of_identities_and_of_enums_have_their_texts_alone() -> None:
    failure = Failure(ActionCall(0, GroundAction("move")), Cause.LOST)
    sent = Happened(UUID(int=1), Accepted(UUID(int=2)), {}, intents=(UUID(int=3), UUID(int=4)))
    for value in (failure, sent):
        assert RECORDS.value(RECORDS.text(value)) == value
    assert RECORDS.value(RECORDS.text(failure)).cause is Cause.LOST
    assert '"cause":"LOST"' in RECORDS.text(failure)
    assert f'"run":"{UUID(int=1).hex}"' in RECORDS.text(sent)
    for text in ('{"@":"Accepted","request":"x"}', '{"@":"Failure","call":null,"cause":"NONE"}'):
        with pytest.raises(Undecodable):
            RECORDS.value(text)


def test_what_there_is_once_is_the_same_again() -> None:
    assert RECORDS.value(RECORDS.text(MISSING)) is MISSING
    assert RECORDS.value(RECORDS.text(UNKNOWN)) is UNKNOWN
    assert RECORDS.value(RECORDS.text(Cause.LOST)) is Cause.LOST
    assert RECORDS.value(RECORDS.text({"@": 1})) == {"@": 1}
    assert RECORDS.value(RECORDS.text(frozenset({UUID(int=1)}))) == frozenset({UUID(int=1)})


class Stranger(Enum):
    ONE = 1


def test_a_foreign_class_is_refused_in_both_directions() -> None:
    with pytest.raises(Undecodable, match="Stranger"):
        RECORDS.text((Stranger.ONE,))
    with pytest.raises(Undecodable, match="there is no Process"):
        RECORDS.value('{"@": "Process", "arguments": []}')
    with pytest.raises(Undecodable):
        RECORDS.value('{"@": "ActionCall", "index": 0, "colour": 1}')


@pytest.mark.parametrize("text", ["\ud800", "tea \udcff and \U0001f375", "\x00", "é"])
def test_every_text_of_python_is_one_of_a_database(text: str) -> None:
    written = RECORDS.text({"answer": text})
    written.encode()  # as databases do
    assert RECORDS.value(written) == {"answer": text}
