"""The record of a run: what became of every call, and why those that failed did.

How runs, their calls and their failures are told.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

from pnm.core.machine.machine import Deed, Rule
from pnm.core.machine.plan_graph import ActionCall, PlanGraph, Step, Then
from pnm.core.machine.requests import Outcome


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a call, or another step, failed: which check or outcome, what was expected and what was seen."""

    call: Step
    cause: str
    expected: str = ""
    observed: str = ""
    unconfirmed: bool = False
    """The server has not confirmed that it stopped: it may still be at work."""
    replan: bool = False
    """The plan wants a planner to find another way."""
    lacking: tuple[str, ...] = ()
    """The resources that it has waited for in vain: requests keep them that were given up and may still be at work."""

    def __str__(self) -> str:
        details = f": expected {self.expected}" if self.expected else ""
        return f"{self.call}: {self.cause}{details}{f'; observed {self.observed}' if self.observed else ''}"


@dataclass(frozen=True, slots=True)
class CallResult:
    """What became of a call so far. Times are None until it was sent, and until it was over."""

    call: ActionCall
    outcome: str = "waiting"
    attempts: int = 0
    started: float | None = None
    ended: float | None = None
    assumed: bool = False
    """It succeeded, but some of its effects are assumed: nothing reports them."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended."""

    goal: bool
    reason: str
    calls: tuple[CallResult, ...]
    failures: tuple[Failure, ...]
    stopped: bool = False
    """It was told to stop."""


UNCONFIRMED: Final = "canceled, unconfirmed"
"""The outcome of a call that was stopped, but whose server has not confirmed that."""
SUSPENDED: Final = "suspended"
"""The outcome so far of a call that was cancelled for a pause and has not begun anew."""
RUNNING: Final = "running"
"""The outcome so far of a call whose request is out."""
HANDED_OVER: Final = "handed over"
"""The outcome of a call that another run goes on with."""

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
    "unconfirmed_pause": "timed_out",
    "effects_missing": "effects_missing",
}
"""The transitions after which a call recovers or fails, and how the cause is called."""


class Ledger:
    """What a run writes down about its calls.

    The mutable state is `results`, what became of calls the last time they were reached, `rounds`, the same of all times
    before, `failures` and, per call, the last message and the last cause.
    """

    def __init__(self, plan: PlanGraph) -> None:
        self._calls = plan.calls
        self._steps = {step.index: step for step in plan.every_step}
        self._outermost = frozenset(step.index for step in plan.steps)
        self._is_flat = len(plan.steps) == len(plan.every_step) == len(plan.calls)
        self.results = [CallResult(call) for call in plan.calls]
        self.rounds: list[CallResult] = []
        self.failures: list[Failure] = []
        self._messages: dict[int, str] = {}
        self._causes: dict[int, tuple[str, str, str]] = {}

    def told(self, handed: Collection[int] = ()) -> tuple[CallResult, ...]:
        """Return what became of the calls, every time they were reached.

        A plan of calls alone keeps its order; of any other plan calls are told in the order in which they were sent, and of those
        that were never reached the outermost ones.

        Args:
            handed: the numbers of calls whose requests another run takes over.
        """
        results = [replace(one, outcome=HANDED_OVER) if one.call.index in handed else one for one in self.results]
        if self._is_flat and not self.rounds:
            return tuple(results)
        reached = [one for one in (*self.rounds, *results) if one.outcome != "waiting"]
        others = [one for one in results if one.outcome == "waiting" and one.call.index in self._outermost]
        return (*sorted(reached, key=lambda one: (_first(one), one.call.index)), *others)

    def answered(self, call: int, outcome: Outcome) -> None:
        """Note how a request of the call ended."""
        self._messages[call] = outcome.message or outcome.kind.value

    def fired(self, rule: Rule, call: int, now: float, *, missing: tuple[str, ...], assumed: bool) -> None:
        """Note that a transition of the call fires; `missing` are the effects not seen."""
        result = self.results[call]
        if rule.name in ("join", "overtaken") and result.outcome != "waiting":
            self.rounds.append(result)
            self.results[call] = CallResult(self._calls[call])
            self._causes.pop(call, None)
        elif rule.deed is Deed.SEND:
            started = now if result.started is None else result.started
            self.results[call] = replace(result, outcome=RUNNING, attempts=result.attempts + 1, started=started)
        elif rule.name == "suspended":
            self.results[call] = replace(result, outcome=SUSPENDED)
        elif rule.name == "skip" and result.outcome == SUSPENDED:
            self.results[call] = replace(result, outcome="canceled", ended=now)
        elif rule.name in _DONE:
            self.results[call] = replace(result, outcome=_DONE[rule.name], ended=now, assumed=rule.deed is Deed.FINISH and assumed)
        elif rule.name == "fork" and result.ended is None:
            cause = self._causes[call][0] if call in self._causes else "left"
            self.results[call] = replace(result, outcome=f"{cause}, passed over", ended=now)
        if rule.name in _CAUSES:
            self.caused(call, (_CAUSES[rule.name], *self._expectation(rule.name, call, missing)))

    def adopted(self, call: ActionCall, before: CallResult) -> None:
        """Note that the call was sent by another run, and what was told of it there."""
        self.results[call.index] = replace(before, call=call)

    def sent(self, call: ActionCall) -> None:
        """Note with which values for its parameters the call was sent."""
        self.results[call.index] = replace(self.results[call.index], call=call)

    def caused(self, call: int, why: tuple[str, str, str]) -> None:
        """Note why the call is about to recover: the cause, what was expected and what was seen."""
        self._causes[call] = why

    def _expectation(self, transition: str, call: int, missing: tuple[str, ...]) -> tuple[str, str]:
        """Return what was expected, and what was seen in its place."""
        match transition:
            case "effects_missing":
                return " ".join(missing), "the action succeeded, but that is not so"
            case "unanswered" | "unheard":
                return "an answer to the goal in time", "none"
            case "expired":
                return "an end in time", f"none; then {self._messages[call]}"
            case "unconfirmed_pause":
                return "a confirmed cancellation in time, for a pause", "none"
            case "unconfirmed":
                return "an end, or a confirmed cancellation, in time", "neither"
            case _:
                return "success", self._messages[call]

    def failed(
        self, step: int, now: float, why: tuple[str, str, str] | None, *, how: str, unconfirmed: bool, lacking: tuple[str, ...]
    ) -> Failure:
        """Note that the step has failed, by the transition `how`; the cause is the last one noted unless `why` names another."""
        if why and step in self._causes:
            cause, expected, observed = self._causes[step]
            why = (why[0], why[1], f"{why[2]}; so it was not tried again after {cause}: expected {expected}, observed {observed}")
        told = why or self._causes.get(step) or (how, "", "")
        failed = self.results[step].call if step < len(self.results) else self._steps[step]
        failure = Failure(failed, *told, unconfirmed=unconfirmed, replan=how == Then.REPLAN.value, lacking=lacking)
        self.failures.append(failure)
        if isinstance(failure.call, ActionCall):
            self.results[step] = replace(self.results[step], outcome=failure.cause, ended=now)
        return failure


def _first(result: CallResult) -> float:
    return next((time for time in (result.started, result.ended) if time is not None), 0.0)
