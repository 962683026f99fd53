"""The record of a run: what became of every call, and why those that failed did."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from pnm.actions.base import Outcome
from pnm.machine import Deed, Rule
from pnm.plan_graph import ActionCall
from pnm.results import CallResult, Failure

UNCONFIRMED: Final = "canceled, unconfirmed"
"""The outcome of a call that was stopped, but whose server has not confirmed that."""

_DONE: Final = {
    "skip": "skipped",
    "already_true": "already true",
    "effects_hold": "succeeded",
    "completed": "succeeded",
    "stopped": "canceled",
    "unconfirmed_stop": UNCONFIRMED,
}
"""The transitions that end a call without failure, and how that is called."""

_CAUSES: Final = {
    "rejected": "rejected",
    "unavailable": "unavailable",
    "unanswered": "unavailable",
    "unheard": "unavailable",
    "ended_early": "unavailable",
    "aborted": "aborted",
    "canceled": "canceled",
    "lost": "lost",
    "lost_early": "lost",
    "ended_oddly": "aborted",
    "expired": "timed_out",
    "unconfirmed": "timed_out",
    "effects_missing": "effects_missing",
}
"""The transitions after which a call recovers or fails, and how the cause is called."""


class Ledger:
    """What a run writes down about its calls.

    The mutable state is `results`, `failures` and, per call, the last message and the last cause.
    """

    def __init__(self, calls: tuple[ActionCall, ...]) -> None:
        self.results = [CallResult(call) for call in calls]
        self.failures: list[Failure] = []
        self._messages: dict[int, str] = {}
        self._causes: dict[int, tuple[str, str, str]] = {}

    def answered(self, call: int, outcome: Outcome) -> None:
        """Note how a request of the call ended."""
        self._messages[call] = outcome.message or outcome.kind.value

    def fired(self, rule: Rule, call: int, now: float, *, missing: tuple[str, ...], assumed: bool) -> None:
        """Note that a transition of the call fires; `missing` are the effects not seen."""
        result = self.results[call]
        if rule.deed is Deed.SEND:
            started = now if result.started is None else result.started
            self.results[call] = replace(result, outcome="running", attempts=result.attempts + 1, started=started)
        elif rule.name in _DONE:
            self.results[call] = replace(result, outcome=_DONE[rule.name], ended=now, assumed=rule.deed is Deed.FINISH and assumed)
        if rule.name in _CAUSES:
            self._causes[call] = (_CAUSES[rule.name], *self._expectation(rule.name, call, missing))

    def _expectation(self, transition: str, call: int, missing: tuple[str, ...]) -> tuple[str, str]:
        """Return what was expected, and what was seen in its place."""
        match transition:
            case "effects_missing":
                return " ".join(missing), "the action succeeded, but that is not so"
            case "unanswered" | "unheard":
                return "an answer to the goal in time", "none"
            case "expired":
                return "an end in time", f"none; then {self._messages[call]}"
            case "unconfirmed":
                return "an end, or a confirmed cancellation, in time", "neither"
            case _:
                return "success", self._messages[call]

    def failed(self, call: int, now: float, why: tuple[str, str, str] | None, *, unconfirmed: bool) -> Failure:
        """Note that the call has failed; the cause is the last one noted unless `why` names another."""
        if why and call in self._causes:
            cause, expected, observed = self._causes[call]
            why = (why[0], why[1], f"{why[2]}; so it was not tried again after {cause}: expected {expected}, observed {observed}")
        failure = Failure(self.results[call].call, *(why or self._causes[call]), unconfirmed=unconfirmed)
        self.failures.append(failure)
        self.results[call] = replace(self.results[call], outcome=failure.cause, ended=now)
        return failure
