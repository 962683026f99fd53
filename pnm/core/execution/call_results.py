"""Results of runs, of their calls and of their failures, and how they are recorded as transitions fire."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Final, NamedTuple, TypeAlias
from uuid import UUID

from pnm.core.kept_state import KeptState
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import Rule
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph, Step
from pnm.core.machine.requests import CallOutcome, Outcome

# by these names, because a look into the class takes longer than all else that becomes of a call
_WAITING, _RUNNING, _PASSED_OVER = CallOutcome.WAITING, CallOutcome.RUNNING, CallOutcome.PASSED_OVER
_SUSPENDED, _SKIPPED, _CANCELED = CallOutcome.SUSPENDED, CallOutcome.SKIPPED, CallOutcome.CANCELED

REMEMBERED: Final = 500
"""How many results of earlier rounds of a loop are kept."""
_HANDED_ON: Final = 50
"""How many of them a run has that goes on in another process."""
SUCCESS: Final = "success"
"""The expected alternative for a call that ends otherwise."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a call, or another step, failed: which check or outcome, what was expected and what was seen."""

    call: Step
    cause: Cause
    expected: str = ""
    observed: str = ""
    unconfirmed: bool = False
    """The server has not confirmed that it stopped: it may still be at work."""
    replan: bool = False
    """The plan wants a planner to find another way."""
    lacking: tuple[str, ...] = ()
    """The resources that it has waited for in vain: requests keep them that were given up and may still be at work."""

    @property
    def details(self) -> str:
        """The expectation and the observation, in words; for an end without success only the latter."""
        expected = f"expected {self.expected}" if self.expected and not (self.expected == SUCCESS and self.observed) else ""
        observed = f"observed {self.observed}" if expected and self.observed else self.observed
        return "; ".join(filter(None, (expected, observed)))

    @property
    def why(self) -> str:
        """The cause with its details."""
        return f"{self.cause}{f': {self.details}' if self.details else ''}"

    def __str__(self) -> str:
        return f"{self.call}: {self.why}"


class CallResult(NamedTuple):
    """Result of a call so far; its times are None until it was sent, and until it was over."""

    call: ActionCall
    kind: CallOutcome = CallOutcome.WAITING
    attempts: int = 0
    started: float | None = None
    ended: float | None = None
    assumed: bool = False
    """It succeeded, but some of its effects are assumed: nothing reports them."""
    cause: Cause | None = None
    """Why it failed or was passed over."""
    declared: str = ""
    """Which of its declared outcomes it has had, if its action has several."""

    @property
    def is_done(self) -> bool:
        """Whether its effects are there: it succeeded, or was not needed."""
        return self.kind in (CallOutcome.SUCCEEDED, CallOutcome.ALREADY_TRUE)

    @property
    def is_under_way(self) -> bool:
        """Whether its request is out, in this run or in one that succeeds it."""
        return self.kind in (CallOutcome.RUNNING, CallOutcome.HANDED_OVER)

    @property
    def outcome(self) -> str:
        """The outcome in words: the cause of a failure, or the declared outcome of a success, stands for it."""
        match self.kind:
            case CallOutcome.SUCCEEDED if self.declared:
                return self.declared
            case CallOutcome.FAILED:
                return str(self.cause)
            case CallOutcome.PASSED_OVER:
                return f"{self.cause}, {self.kind}"
            case _:
                return self.kind.value


class Earlier(NamedTuple):
    """What is known of calls whose results are kept no more: the number of requests, and of those to action servers."""

    attempts: int = 0
    requests: int = 0

    def with_result(self, result: CallResult) -> Earlier:
        """Return the same with one more."""
        return Earlier(self.attempts + result.attempts, self.requests + result.attempts * (result.call.action.operation is None))


_NOTHING_EARLIER: Final = Earlier()


@dataclass(frozen=True, slots=True, repr=False)
class RunResult:
    """Result of a run: whether the goal holds, and the results of its calls."""

    goal: bool
    reason: str
    calls: tuple[CallResult, ...]
    failures: tuple[Failure, ...]
    stopped: bool = False
    """The run was stopped."""
    earlier: Earlier = _NOTHING_EARLIER
    """Of rounds of loops that are too long ago for `calls`."""

    @property
    def requests(self) -> int:
        """The number of requests to action servers."""
        return self.earlier.requests + sum(call.attempts for call in self.calls if call.call.action.operation is None)

    def __repr__(self) -> str:
        return f"<RunResult {'goal' if self.goal else self.reason}: {len(self.calls)} calls, {len(self.failures)} failures>"


class Explanation(NamedTuple):
    """Cause of a failure, with what was expected and what was observed instead."""

    cause: Cause
    expected: str
    observed: str


@dataclass(frozen=True, slots=True)
class Sent:
    """A request that a run has sent, as its journal tells it to those who do not execute the run."""

    request: UUID
    call: int
    attempt: int
    """Its number among those of the call."""
    arguments: tuple[str, ...] | None = None
    """Those that it was sent with; None if they are those of the plan."""


@dataclass(frozen=True, slots=True)
class Hindered:
    """A hindrance or a failure of a step, as its journal tells it to readers that do not execute the run."""

    step: int
    cause: Explanation
    is_failure: bool = False
    """The step was given up; else it is tried again, or recovers."""
    arguments: tuple[str, ...] | None = None
    """Those that its call was sent with last; None if they are those of the plan."""


Told: TypeAlias = Sent | Hindered


def own_arguments(call: ActionCall, plan: PlanGraph) -> tuple[str, ...] | None:
    """Return the arguments that a call was sent with; None if they are those of the plan."""
    arguments = call.action.arguments
    return None if arguments == plan.calls[call.index].action.arguments else arguments


def action_with(action: GroundAction, arguments: tuple[str, ...] | None) -> GroundAction:
    """Return an action of a plan with other arguments; None for those of the plan."""
    return action if arguments is None else replace(action, arguments=arguments)


def sent_with(call: ActionCall, arguments: tuple[str, ...] | None) -> ActionCall:
    """Return a call of a plan as it was sent with arguments; None for those of the plan."""
    return call if arguments is None else replace(call, action=action_with(call.action, arguments))


@dataclass(frozen=True, slots=True)
class Became:
    """The result of a call without what its plan says of it: the number of the call, and what has become of it."""

    call: int
    kind: CallOutcome
    attempts: int = 0
    started: float | None = None
    ended: float | None = None
    assumed: bool = False
    cause: Cause | None = None
    declared: str = ""
    arguments: tuple[str, ...] | None = None
    """Those that it was sent with last; None if they are those of the plan."""

    @staticmethod
    def from_result(result: CallResult, plan: PlanGraph) -> Became:
        """Return what has become of a call of a plan."""
        return Became(result.call.index, *result[1:], own_arguments(result.call, plan))

    def of(self, plan: PlanGraph) -> CallResult:
        """Return the result of the call of a plan."""
        call = sent_with(plan.calls[self.call], self.arguments)
        return CallResult(call, self.kind, self.attempts, self.started, self.ended, self.assumed, self.cause, self.declared)


class CallResults(KeptState):
    """Results of the calls of a run, and its failures.

    The mutable state is what became of calls the last time they were reached, and as often before as is remembered; `failures`,
    `last_check` and, per call, how its last request ended and the last cause.
    """

    KEPT = ("_current", "_rounds", "earlier", "failures", "last_check", "_answers", "_causes")

    def __init__(self, plan: PlanGraph) -> None:
        self._plan, self._calls = plan, plan.calls
        self._current: dict[int, CallResult] = {}
        """Those of the calls that were reached."""
        self._rounds: deque[CallResult] = deque()
        self.earlier = _NOTHING_EARLIER
        """Of rounds that are not remembered: a run may go on for ever."""
        self.failures: list[Failure] = []
        self.last_check: Explanation | None = None
        """The last check with a consequence."""
        self._answers: dict[int, Outcome] = {}
        self._causes: dict[int, Explanation] = {}

    def values(self) -> dict[str, Any]:
        """Return the state; of results without what their plan says, and of the ends of requests without what servers had for results.

        Of earlier rounds it has the last results, and only the number of requests of the others.
        """
        rounds = (*self._rounds,)
        short = {
            "_current": {call: Became.from_result(result, self._plan) for call, result in self._current.items()},
            "_rounds": tuple([Became.from_result(result, self._plan) for result in rounds[-_HANDED_ON:]]),
            "earlier": reduce(Earlier.with_result, rounds[:-_HANDED_ON], self.earlier),
            "_answers": {call: replace(answer, result={}) for call, answer in self._answers.items()},
        }
        return {**super().values(), **short}

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back."""
        current = {call: became.of(self._plan) for call, became in values["_current"].items()}
        super().restore({**values, "_current": current, "_rounds": [became.of(self._plan) for became in values["_rounds"]]})

    def calls(self, handed: Collection[int] = ()) -> tuple[CallResult, ...]:
        """Return the results of the calls, every time they were reached, as far as that is remembered.

        A plan of calls alone keeps its order; of any other plan calls come in the order in which they were sent, and of those
        that were never reached the outermost ones. Another run takes over the requests of the calls that are `handed` over.
        """
        current = map(self.current, range(len(self._calls)))
        results = [result._replace(kind=CallOutcome.HANDED_OVER) if result.call.index in handed else result for result in current]
        plan = self._plan
        if len(plan.steps) == len(plan.every_step) == len(plan.calls) and not self._rounds:
            return tuple(results)
        reached = [result for result in (*self._rounds, *results) if result.kind is not CallOutcome.WAITING]
        outermost = {step.index for step in plan.steps}
        others = [result for result in results if result.kind is CallOutcome.WAITING and result.call.index in outermost]
        reached.sort(
            key=lambda result: (next((time for time in (result.started, result.ended) if time is not None), 0.0), result.call.index)
        )
        return (*reached, *others)

    def current(self, call: int) -> CallResult:
        """Return the result of a call the last time it was reached."""
        return self._current.get(call) or CallResult(self._calls[call])

    def sent(self, call: ActionCall) -> None:
        """Note a call with the arguments that it is sent with."""
        self._current[call.index] = self._current[call.index]._replace(call=call)

    def answered(self, call: int, outcome: Outcome) -> None:
        """Keep how a request of the call has ended."""
        self._answers[call] = outcome

    def turned(self, outcome: CallOutcome, call: int, now: float, assumed: bool = False, declared: str = "") -> None:
        """Record an outcome of a call, so far or for good; it is `assumed` if nothing reports some of its effects."""
        before = self._current.get(call)
        if before is None:
            before = self._current[call] = CallResult(self._calls[call])
        if outcome is _RUNNING:
            sent, _, attempts, started, ended, was_assumed, cause, _ = before
            started = now if started is None else started
            self._current[call] = CallResult(sent, outcome, attempts + 1, started, ended, was_assumed, cause)
        elif outcome is _WAITING:
            if before.kind is not _WAITING:
                self._rounds.append(self._current.pop(call))
                if len(self._rounds) > REMEMBERED:
                    self.earlier = self.earlier.with_result(self._rounds.popleft())
                self._causes.pop(call, None)
        elif outcome is _PASSED_OVER:
            if before.ended is None:
                self._current[call] = before._replace(kind=outcome, cause=self._causes[call].cause, ended=now)
        elif outcome is _SUSPENDED:
            self._current[call] = before._replace(kind=outcome)
        elif outcome is _SKIPPED and before.kind is _SUSPENDED:
            self._current[call] = before._replace(kind=CallOutcome.CANCELED, ended=now)
        elif outcome is not _CANCELED or before.kind is not CallOutcome.FAILED:  # how its request ended changes nothing then
            self._current[call] = CallResult(before.call, outcome, before.attempts, before.started, now, assumed, None, declared)

    def hindered(self, rule: Rule, call: int, check: Explanation | None, unseen: tuple[str, str] | None) -> Explanation | None:
        """Record, and return, the cause of a recovery or failure of a call that the firing of a transition tells.

        It is that of a check, if one has led to a recovery; `unseen` are the effects that are not seen, and what is seen instead.
        """
        if check is not None:
            self._causes[call] = check
        elif rule.cause is not None and not rule.guard.is_check:
            answer = self._answers.get(call)
            message = (answer.message or answer.kind.value) if answer else ""
            expected, seen = unseen or (rule.expected or SUCCESS, rule.observed.format(message=message) or message)
            self._causes[call] = Explanation(rule.cause, expected, seen)
        else:
            return None
        return self._causes[call]

    def adopted(self, call: ActionCall, before: CallResult) -> None:
        """Record the result so far of a call that another run has sent."""
        self._current[call.index] = before._replace(call=call)

    def failed(self, step: int, now: float, check: Explanation | None, rule: Rule, lacking: tuple[str, ...]) -> Failure:
        """Record the failure of a step: its cause is a check that has led to it at once, or else the one noted last."""
        before = self._causes.get(step)
        if check and before:
            again = f"so it was not tried again after {before.cause}: expected {before.expected}, observed {before.observed}"
            check = check._replace(observed=f"{check.observed}; {again}")
        explanation = check or self._causes[step]
        result = self._current.get(step)
        call = next(one for one in self._plan.every_step if one.index == step) if result is None else result.call
        failure = Failure(call, *explanation, unconfirmed=rule.gives_up, replan=rule.replans, lacking=lacking)
        self.failures.append(failure)
        if isinstance(call, ActionCall):
            self._current[step] = (result or CallResult(call))._replace(kind=CallOutcome.FAILED, cause=failure.cause, ended=now)
        return failure
