"""Outcomes as bindings judge them: a server that reports success may say in its result that it has failed."""

from __future__ import annotations

import pytest

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import Comparison, FieldValue, parse_field

STATUS = parse_field("execution_result.status")
WORDS = {"1": "the path is blocked", "2": "the battery is empty"}
BINDING = Binding(success=Comparison(STATUS, "eq", 0), reason=FieldValue(STATUS, WORDS))


def ended(kind: OutcomeKind, status: object, message: str = "") -> Outcome:
    return Outcome(kind, {} if status is None else {"execution_result": {"status": status}}, message)


@pytest.mark.parametrize(
    ("kind", "status", "judged", "message"),
    [
        (OutcomeKind.SUCCEEDED, 0, OutcomeKind.SUCCEEDED, ""),
        (OutcomeKind.SUCCEEDED, 1, OutcomeKind.ABORTED, "the path is blocked"),
        (OutcomeKind.ABORTED, 2, OutcomeKind.ABORTED, "the battery is empty"),
        (OutcomeKind.ABORTED, 0, OutcomeKind.ABORTED, "execution_result.status is 0, which is not in the table (1, 2)"),
        (OutcomeKind.CANCELED, 2, OutcomeKind.CANCELED, "the battery is empty"),
        (OutcomeKind.LOST, None, OutcomeKind.LOST, ""),
    ],
)
def test_the_result_decides(kind: OutcomeKind, status: object, judged: OutcomeKind, message: str) -> None:
    outcome = BINDING.judged(ended(kind, status))
    assert (outcome.kind, outcome.message) == (judged, message)


def test_a_result_that_does_not_tell_is_no_success() -> None:
    outcome = Binding(success=Comparison(STATUS, "eq", 0)).judged(ended(OutcomeKind.SUCCEEDED, None))
    assert outcome.kind is OutcomeKind.ABORTED
    assert outcome.message == "its result does not tell whether it succeeded: there is no execution_result.status"


@pytest.mark.parametrize("kind", [OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED])
def test_a_failure_without_words_is_explained_by_what_denies_the_success(kind: OutcomeKind) -> None:
    outcome = Binding(success=Comparison(STATUS, "eq", 0)).judged(ended(kind, 3))
    assert (outcome.kind, outcome.message) == (OutcomeKind.ABORTED, "its result has execution_result.status = 3")


@pytest.mark.parametrize(
    ("kind", "status", "judged"),
    [
        (OutcomeKind.SUCCEEDED, 0, OutcomeKind.SUCCEEDED),
        (OutcomeKind.SUCCEEDED, 1, OutcomeKind.ABORTED_FOR_GOOD),
        (OutcomeKind.SUCCEEDED, 2, OutcomeKind.ABORTED),
        (OutcomeKind.ABORTED, 1, OutcomeKind.ABORTED_FOR_GOOD),
        (OutcomeKind.ABORTED, None, OutcomeKind.ABORTED),
        (OutcomeKind.CANCELED, 1, OutcomeKind.CANCELED),
    ],
)
def test_a_failure_may_be_final(kind: OutcomeKind, status: object, judged: OutcomeKind) -> None:
    binding = Binding(success=Comparison(STATUS, "eq", 0), final=Comparison(STATUS, "eq", 1))
    assert binding.judged(ended(kind, status)).kind is judged


def test_what_the_server_says_itself_stands_where_the_result_has_no_reason() -> None:
    assert BINDING.judged(ended(OutcomeKind.ABORTED, 7, "the door is shut")).message == "the door is shut"


def test_without_words_about_its_result_an_outcome_is_as_reported() -> None:
    reported = ended(OutcomeKind.ABORTED, 3, "no")
    assert Binding().judged(reported) == reported
