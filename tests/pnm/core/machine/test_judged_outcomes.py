"""Outcomes as bindings judge them: a server that reports success may say in its result that it has failed."""

from __future__ import annotations

import pytest

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import Comparison, FieldValue, parse_field

STATUS = parse_field("execution_result.status")
SUCCESS = Comparison(STATUS, "eq", 0)
WORDS = Binding(success=SUCCESS, reason=FieldValue(STATUS, {"1": "the path is blocked", "2": "the battery is empty"}))
BARE = Binding(success=SUCCESS)
FINAL = Binding(success=SUCCESS, final=Comparison(STATUS, "eq", 1))
SUCCEEDED, ABORTED, FOR_GOOD, CANCELED, LOST = (
    *(OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED, OutcomeKind.ABORTED_FOR_GOOD),
    *(OutcomeKind.CANCELED, OutcomeKind.LOST),
)
NOT_TOLD = "its result does not tell whether it succeeded: there is no execution_result.status"


@pytest.mark.parametrize(
    ("binding", "kind", "status", "said", "judged", "message"),
    [
        (WORDS, SUCCEEDED, 0, "", SUCCEEDED, ""),
        (WORDS, SUCCEEDED, 1, "", ABORTED, "the path is blocked"),
        (WORDS, ABORTED, 2, "", ABORTED, "the battery is empty"),
        (WORDS, ABORTED, 0, "", ABORTED, "execution_result.status is 0, which is not in the table (1, 2)"),
        (WORDS, ABORTED, 7, "the door is shut", ABORTED, "the door is shut"),
        (WORDS, CANCELED, 2, "", CANCELED, "the battery is empty"),
        (WORDS, LOST, None, "", LOST, ""),
        (BARE, SUCCEEDED, None, "", ABORTED, NOT_TOLD),
        (BARE, SUCCEEDED, 3, "", ABORTED, "its result has execution_result.status = 3"),
        (BARE, ABORTED, 3, "", ABORTED, "its result has execution_result.status = 3"),
        (FINAL, SUCCEEDED, 0, "", SUCCEEDED, ""),
        (FINAL, SUCCEEDED, 1, "", FOR_GOOD, "its result has execution_result.status = 1"),
        (FINAL, SUCCEEDED, 2, "", ABORTED, "its result has execution_result.status = 2"),
        (FINAL, ABORTED, 1, "", FOR_GOOD, "its result has execution_result.status = 1"),
        (FINAL, ABORTED, None, "", ABORTED, ""),
        (FINAL, CANCELED, 1, "", CANCELED, ""),
        (Binding(), ABORTED, 3, "no", ABORTED, "no"),
    ],
)
def test_the_result_decides(binding: Binding, kind: OutcomeKind, status: object, said: str, judged: OutcomeKind, message: str) -> None:
    outcome = binding.judged(Outcome(kind, {} if status is None else {"execution_result": {"status": status}}, said))
    assert (outcome.kind, outcome.message) == (judged, message)
