"""The result of a task: its code and reason, its episodes, where its time went; and the sentences that give reasons."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import zip_longest
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, TypeAlias, TypeVar

from planner_bridge.model import problem
from planner_bridge.model.guards import ForbiddenCall
from planner_bridge.model.plan import PlanningStatus, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.tasks import replanning
from planner_bridge.tasks.replanning import BetterRest, Decision, Foreseen, GiveUp, History, NextStretch, PlanAgain, ResumePlan
from pnm.core.execution.call_results import CallResult, Failure, RunResult
from pnm.core.logic import domain, trajectory
from pnm.core.logic.trajectory import Constraint, ConstraintProgress
from pnm.core.machine.failure_causes import FailureKind
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import GroundAction, step_words
from pnm.core.machine.requests import CallOutcome
from pnm.errors import counted
from pnm.journal.codec import RECORDS, value_classes
from pnm.journal.replay import ReplayedRun, ReplayedTask
from pnm.knowledge.people import HelpAsked, HelpEnded
from pnm.tasks import Code, TaskEnding

if TYPE_CHECKING:
    from planner_bridge.planning.policies import policy as policies

N = TypeVar("N")

_PLANNING: Final = {
    PlanningStatus.UNSOLVABLE: Code.NO_PLAN,
    PlanningStatus.NO_PLAN: Code.NO_PLAN,
    PlanningStatus.TIMED_OUT: Code.PLANNER_TIMEOUT,
    PlanningStatus.CANCELLED: Code.CANCELLED,
}

_CODES: Final = {
    FailureKind.ACTION: Code.ACTION_FAILED,
    FailureKind.CONDITION: Code.CONDITION_LOST,
    FailureKind.TIME: Code.TIMED_OUT,
    FailureKind.SERVER: Code.SERVER_UNAVAILABLE,
}


def code_of_planning(status: PlanningStatus, failures: Sequence[Failure]) -> Code:
    """Return the code of a task for which no plan was found, after these failures: they are why there is none any more."""
    code = _PLANNING.get(status, Code.PLANNER_ERROR)
    return code_of_failures(failures) if failures and code is Code.NO_PLAN else code


def code_of_failures(failures: Sequence[Failure]) -> Code:
    """Return the code of a task that ends with these failures, the last of which counts."""
    return _CODES[failures[-1].cause.kind] if failures else Code.CONDITION_LOST


class Stopwatch:
    """Adds up where the time of a task goes, in seconds of the wall clock."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("parse", "plan", "translate", "verify", "execute"), 0.0)

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Measure one part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - began


@dataclass(frozen=True)
class Episode:
    """One machine and its run.

    Args:
        decision: what followed if the goal was not reached.
        called: the requests of plans that calls of it are, less those calls.
    """

    machine: PetriNetMachine
    result: RunResult
    decision: Decision | None = None
    called: int = 0


@dataclass(frozen=True, slots=True)
class TaskCounts:
    """The counts of events in a task.

    Args:
        plans: that a planner has found, or that were given to begin with.
        replans: new machines after the first, with the rest of a plan or with another one; those with a better rest do not count.
        requests: to action servers, those of plans that a plan calls among them; such a call is none.
        failures: calls, and other steps, that were given up.
    """

    plans: int
    replans: int
    requests: int
    failures: int
    has_run: bool

    def as_json(self) -> dict[str, int]:
        """Return them as programs get them."""
        return {"plans": self.plans, "replans": self.replans, "requests": self.requests, "failures": self.failures}

    def __str__(self) -> str:
        planned = ((self.plans, "plan"), (self.replans, "replan")) if self.plans or not self.has_run else ()
        return ", ".join(counted(number, word) for number, word in (*planned, (self.requests, "request"), (self.failures, "failure")))


@dataclass(frozen=True, repr=False)
class TaskResult:
    """The result of a task, episode by episode."""

    code: Code
    reason: str
    plans: int
    """The number of plans that a planner found."""
    episodes: tuple[Episode, ...]
    seconds: dict[str, float]
    """The time of each stage: parse, plan, translate, verify, execute."""
    began: float = 0.0
    """The beginning of the task, on the clock of its calls."""
    constraints: tuple[ConstraintResult, ...] = ()
    """The results of the constraints of domain and problem."""
    preferences: tuple[PreferenceResult, ...] = ()
    """The results of the preferences, name by name."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.code.word}: {len(self.calls)} calls, {self.replans} replans, {len(self.failures)} failures>"

    def ending(self) -> TaskEnding:
        """Return the end of the task as the clients of a task manager see it."""
        return TaskEnding(self.code, self.reason)

    @property
    def goal_reached(self) -> bool:
        """Whether the goal holds."""
        return self.code is Code.GOAL_REACHED

    @property
    def calls(self) -> tuple[CallResult, ...]:
        """The results of the calls of all episodes; a call that was handed on is in the episode of its end."""
        return tuple(call for episode in self.episodes for call in episode.result.calls if call.kind is not CallOutcome.HANDED_OVER)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Everything that failed in all episodes."""
        return tuple(failure for episode in self.episodes for failure in episode.result.failures)

    @property
    def replans(self) -> int:
        """The number of new machines after the first; those that were foreseen do not count."""
        return sum(not isinstance(episode.decision, Foreseen) for episode in self.episodes[:-1])

    @property
    def counts(self) -> TaskCounts:
        """Counts of events."""
        handed = sum(call.attempts for one in self.episodes for call in one.result.calls if call.kind is CallOutcome.HANDED_OVER)
        requests = sum(episode.result.requests + episode.called for episode in self.episodes) - handed
        return TaskCounts(self.plans, self.replans, requests, len(self.failures), has_run=bool(self.episodes))

    def as_json(self) -> dict[str, Any]:
        """Return the result as `pnm run --json` prints it."""
        return {
            "goal_reached": self.goal_reached,
            "code": self.code.word,
            "reason": self.reason,
            "plans": self.plans,
            "replans": self.replans,
            "requests": self.counts.requests,
            "calls": [
                {
                    "action": result.call.action.name,
                    "arguments": list(result.call.action.arguments),
                    "outcome": result.outcome,
                    "attempts": result.attempts,
                    "started": None if result.started is None else round(result.started - self.began, 4),
                    "ended": None if result.ended is None else round(result.ended - self.began, 4),
                    "assumed": result.assumed,
                }
                for result in self.calls
            ],
            "failures": [
                {"call": str(failure.call), "cause": failure.cause, "expected": failure.expected, "observed": failure.observed}
                for failure in self.failures
            ],
            "decisions": [_decision_as_json(episode.decision) for episode in self.episodes if episode.decision],
            "constraints": [
                {
                    "constraint": str(result.constraint),
                    "status": result.status,
                    "violations": [each.as_json() for each in result.violations],
                }
                for result in self.constraints
            ],
            "preferences": [{"name": result.name, "status": result.status, "violated": result.violated} for result in self.preferences],
            "seconds": {name: round(seconds, 6) for name, seconds in self.seconds.items()},
        }


@dataclass(frozen=True, repr=False)
class PlanResult(TaskResult):
    """The result of a hand-written plan."""

    results: Mapping[str, object] = field(default_factory=dict)
    """The variables that the plan gives back."""
    variables: Mapping[str, object] = field(default_factory=dict)
    """All variables of its run."""
    cause: str = ""
    """Why the plan has failed, in one word."""

    def ending(self) -> TaskEnding:
        """Return the end of the task with the results of the plan."""
        return TaskEnding(self.code, self.reason, results=self.results, cause="" if self.goal_reached else self.cause)

    def as_json(self) -> dict[str, Any]:
        """Return the result as `pnm run --plan --json` prints it."""
        return {**super().as_json(), "results": _finite(dict(self.results)), "variables": _finite(dict(self.variables))}


def _finite(value: object) -> object:
    """Return the value with text for infinity and NaN: JSON has neither, but servers may answer with them."""
    match value:
        case float() if not isfinite(value):
            return str(value)
        case dict():
            return {name: _finite(item) for name, item in value.items()}
        case list() | tuple():
            return [_finite(item) for item in value]
        case _:
            return value


def _decision_as_json(decision: Decision) -> dict[str, Any]:
    match decision:
        case ResumePlan(rest, because):
            calls = [str(call.action) for call in rest.calls]
            return {"decision": "resume", "calls": calls, **({"because": because} if because else {})}
        case PlanAgain(forbidden, why, because):
            never = sorted(map(str, forbidden))
            return {"decision": "plan again", "why": why, "forbidden": never, **({"because": because} if because else {})}
        case BetterRest(why):
            return {"decision": "better rest", "why": why}
        case NextStretch(outcome, rest):
            return {"decision": "next stretch", "outcome": outcome, "calls": [str(call.action) for call in rest.calls] if rest else None}
        case GiveUp(reason):
            return {"decision": "give up", "why": reason}


ConstraintStatus: TypeAlias = Literal["fulfilled", "violated", "not monitored"]


@dataclass(frozen=True, slots=True)
class Violation:
    """A ground constraint that is not kept."""

    constraint: Constraint
    time: float
    """Seconds after the start of the task."""
    observed: str

    def as_json(self) -> dict[str, Any]:
        """Return the violation as `pnm run --json` prints it."""
        return {"constraint": str(self.constraint), "time": round(self.time, 4), "observed": self.observed}

    def __str__(self) -> str:
        return f"{self.constraint} is violated after {self.time:.2f} s: {self.observed}"


@dataclass(frozen=True, slots=True)
class ConstraintResult:
    """The result of a constraint of the domain or the problem."""

    constraint: Constraint
    status: ConstraintStatus
    violations: tuple[Violation, ...] = ()
    """One for every choice of objects for which it was not kept."""


@dataclass(frozen=True, slots=True)
class PreferenceResult:
    """The result of the preferences of one name."""

    name: str
    status: ConstraintStatus
    violated: int | None = None
    """The number of their violated instances, as in ``(is-violated name)``; None when they are not monitored."""


@dataclass
class TaskLog:
    """The record of a task: failures, runs and the number of plans. Everything in it is mutable state."""

    history: History = field(default_factory=History)
    episodes: list[Episode] = field(default_factory=list)
    plans: int = 0
    """The number of plans that were found, or given."""
    helped: int = 0
    """The number of times that a person has helped."""

    @property
    def failures(self) -> list[Failure]:
        """Everything that failed in the runs that are over."""
        return [failure for episode in self.episodes for failure in episode.result.failures]

    def end(self, machine: PetriNetMachine, result: RunResult, decision: Decision | None = None) -> None:
        """Record a run that is over, or is succeeded by another."""
        self.episodes.append(Episode(machine, result, decision))

    @property
    def last_failure(self) -> str:
        """The failure of the last run; empty when it reached its goal."""
        return "" if not self.episodes or self.episodes[-1].result.goal else f"last failure: {self.episodes[-1].result.reason}"

    def unfulfilled(self, missing: tuple[Constraint, ...]) -> str:
        """Return which constraints are not fulfilled after the runs; empty when all are, or nothing was executed."""
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        return f"not fulfilled: {', '.join(map(str, missing[:3]))}{more}" if self.episodes and missing else ""


# --- going on in another process -----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GoalNote:
    """The memory of a goal from one run to the next.

    Args:
        decision: why another run follows the last one; None for a plan that was found, and for help.
        helped: how often a person has helped.
    """

    history: History
    plans: int
    decision: Decision | None = None
    helped: int = 0


@dataclass(frozen=True, slots=True)
class PolicyNote:
    """The policy that the last plan is the beginning of; without entries if there is none.

    Args:
        problem: that it is for, without its initial state; None in older journals.
    """

    is_whole: ClassVar = True
    """The last one says all."""
    entries: tuple[tuple[Any, ...], ...] = ()
    chance: float = 1.0
    is_proved: bool = False
    problem: Problem | None = None

    def __str__(self) -> str:
        return f"noted a policy for {counted(len(self.entries), 'kind')} of states"

    @staticmethod
    def of(policy: Policy | None) -> PolicyNote:
        """Return the note of a policy."""
        if policy is None:
            return PolicyNote()
        problem = replace(policy.problem, init={}, unknown=frozenset())
        return PolicyNote(tuple(map(tuple, policy.entries)), policy.chance, policy.is_proved, problem)

    def chances(self, action: GroundAction) -> Mapping[str, float]:
        """Return the chances that the outcomes of an action were taken to have; none in older journals."""
        from planner_bridge.planning.policies.policy import PolicyEntry  # here, because most actions have one outcome

        entries = (PolicyEntry(*entry) for entry in self.entries)
        return next((one.outcomes for one in entries if (one.action, one.arguments) == (action.name, action.arguments)), {})

    def policy(self, problem: Problem) -> policies.Policy | None:
        """Return the policy for a problem."""
        from planner_bridge.planning.policies import policy  # here, because most actions have one outcome

        entries = tuple([policy.PolicyEntry(*entry) for entry in self.entries])
        steps = cache(partial(policy.steps_of, problem, entries))
        return policy.Policy(problem, entries, self.chance, self.is_proved, steps) if entries else None


@dataclass(frozen=True, slots=True)
class TrajectoryNote:
    """The results of the constraints and preferences of a task.

    Args:
        began: when the task began, on the clock of the event loop.
        progress: what is left of every ground constraint, in their order.
        violations: of those that are violated, by their position.
    """

    is_whole: ClassVar = True
    """The last one says all."""
    began: float
    progress: tuple[ConstraintProgress, ...] = ()
    violations: Mapping[int, Violation] = field(default_factory=dict)

    def __str__(self) -> str:
        return "noted how far the trajectory constraints are fulfilled"


_NOTES: Final = (GoalNote, PolicyNote, TrajectoryNote, Violation, HelpAsked, HelpEnded)
TASKS: Final = RECORDS.including((*_NOTES, ForbiddenCall, *value_classes(replanning, trajectory, problem, domain)))
"""The codec of the journal of tasks."""


def notes_of(task: ReplayedTask, kind: type[N]) -> list[N]:
    """Return the notes of a kind that another process has kept of a task."""
    return [note for note in task.notes if isinstance(note, kind)]


def restored_log(task: ReplayedTask) -> tuple[TaskLog, ReplayedRun | None]:
    """Return the log of a task as another process left it, and the run that had begun and goes on."""
    notes = notes_of(task, GoalNote)
    decisions = [note.decision for note in notes if note.decision is not None]
    begun = [replayed for replayed in task.runs if replayed.run.begun]
    # A run is succeeded, or followed, before that is noted: the last one that has begun is the one that counts, unless it is followed.
    current = begun[-1] if len(begun) > len(decisions) else None
    before = begun[:-1] if current else begun
    episodes = [
        Episode(replayed.run.machine, replayed.result or replayed.run.interim_result(), decision)
        for replayed, decision in zip_longest(before, decisions[: len(before)])
    ]
    last = notes[-1] if notes else GoalNote(History(), 0)
    return TaskLog(last.history, episodes, last.plans, last.helped), current


def retry_reason(seconds: float, result: RunResult) -> str:
    """Return when a plan is tried again, and why its run has failed."""
    event = result.reason
    if result.failures:
        event = f"{step_words(result.failures[-1].call)} {result.failures[-1].cause.happened}"
    return f"tries again in {seconds:g} s after {event}"


def join_reasons(*parts: str) -> str:
    """Join the reasons that are not empty."""
    return "; ".join(filter(None, parts))
