"""What a task is given, who listens to it, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

from planner_bridge.monitoring import ConstraintResult, PreferenceResult, Violation
from planner_bridge.plan import Plan, PlanningResult
from planner_bridge.planning import DEFAULT_PLANNER
from planner_bridge.replanning import Decision, GiveUp, Limits, PlanAgain, Resume
from pnm.analysis import Proof
from pnm.bindings import Bindings
from pnm.ledger import HANDED_OVER
from pnm.machine import OnFailure, PetriNetMachine
from pnm.observer import Observer
from pnm.results import CallResult, Failure, RunResult
from pnm.sensing import NO_SENSING, Sensing
from pnm.tasking import Code, TaskState

if TYPE_CHECKING:
    from concurrent.futures import Executor


class TaskObserver(Observer):
    """Listens to a whole task: one more empty method per moment."""

    def planning(self, planner: str) -> None:
        """Note that a planner is being asked."""

    def planned(self, plan: Plan) -> None:
        """Note that a plan was found."""

    def unplanned(self, result: PlanningResult) -> None:
        """Note that no plan was found."""

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Note that a machine is ready to run, and proved sound."""

    def resigned(self, reason: str) -> None:
        """Note that a hand-written plan has failed, and wants a planner to find another way."""

    def replanning(self, decision: Resume | PlanAgain, result: RunResult) -> None:
        """Note that a run failed and what follows."""

    def entered(self, state: TaskState, why: str) -> None:
        """Note that the task is in another state, and why."""

    def violated(self, violation: Violation, now: float) -> None:
        """Note that a constraint is violated; the task will not go on."""


class OnChange(Enum):
    """When a plan is looked at again because facts have changed."""

    EAGER = "eager"
    """At once, if the plan has to do with them."""
    LAZY = "lazy"
    """When a call needs them, and fails."""


@dataclass(frozen=True)
class Settings:
    """How a task is pursued."""

    planner: str = DEFAULT_PLANNER
    planner_timeout: float = 30.0
    bindings: Bindings = field(default_factory=Bindings)
    limits: Limits = field(default_factory=Limits)
    on_failure: OnFailure = OnFailure.DRAIN
    on_change: OnChange = OnChange.LAZY
    executor: Executor | None = None
    """Runs the planners when they race; a process for each by default."""
    sensing: Sensing = NO_SENSING
    """Which topics and services of ROS 2 speak of what."""


@dataclass(frozen=True)
class Episode:
    """One machine and its run; `decision` is what followed if the goal was not reached."""

    machine: PetriNetMachine
    result: RunResult
    decision: Decision | None = None


@dataclass(frozen=True)
class TaskResult:
    """How a task ended, episode by episode."""

    code: Code
    reason: str
    plans: int
    """How often a planner found a plan."""
    episodes: tuple[Episode, ...]
    seconds: dict[str, float]
    """Where the time went: parse, plan, translate, verify, execute."""
    began: float = 0.0
    """When the task began, on the clock of its calls."""
    constraints: tuple[ConstraintResult, ...] = ()
    """What became of the constraints of domain and problem."""
    preferences: tuple[PreferenceResult, ...] = ()
    """What became of the preferences, name by name."""

    @property
    def goal_reached(self) -> bool:
        """Whether the goal holds."""
        return self.code is Code.GOAL_REACHED

    @property
    def calls(self) -> tuple[CallResult, ...]:
        """What became of the calls of all episodes; of a call that was handed on, where it ended."""
        return tuple(call for episode in self.episodes for call in episode.result.calls if call.outcome != HANDED_OVER)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Everything that failed in all episodes."""
        return tuple(failure for episode in self.episodes for failure in episode.result.failures)

    @property
    def replans(self) -> int:
        """How many new machines followed the first."""
        return max(0, len(self.episodes) - 1)

    def as_json(self) -> dict[str, Any]:
        """Return the result as `pnm run --json` prints it."""
        return {
            "goal_reached": self.goal_reached,
            "code": self.code.word,
            "reason": self.reason,
            "plans": self.plans,
            "replans": self.replans,
            "calls": [_call_as_json(call, self.began) for call in self.calls],
            "failures": [
                {"call": str(one.call), "cause": one.cause, "expected": one.expected, "observed": one.observed} for one in self.failures
            ],
            "decisions": [_decision_as_json(episode.decision) for episode in self.episodes if episode.decision],
            "constraints": [_constraint_as_json(one) for one in self.constraints],
            "preferences": [{"name": one.name, "status": one.status, "violated": one.violated} for one in self.preferences],
            "seconds": {name: round(seconds, 6) for name, seconds in self.seconds.items()},
        }


def _call_as_json(result: CallResult, began: float) -> dict[str, Any]:
    return {
        "action": result.call.action.name,
        "arguments": list(result.call.action.arguments),
        "outcome": result.outcome,
        "attempts": result.attempts,
        "started": None if result.started is None else round(result.started - began, 4),
        "ended": None if result.ended is None else round(result.ended - began, 4),
        "assumed": result.assumed,
    }


def _constraint_as_json(result: ConstraintResult) -> dict[str, Any]:
    violations = [{"constraint": str(one.constraint), "time": round(one.time, 4), "observed": one.observed} for one in result.violations]
    return {"constraint": str(result.constraint), "status": result.status, "violations": violations}


def _decision_as_json(decision: Decision) -> dict[str, Any]:
    match decision:
        case Resume(rest):
            return {"decision": "resume", "calls": [str(call.action) for call in rest.calls]}
        case PlanAgain(forbidden, why):
            return {"decision": "plan again", "why": why, "forbidden": sorted(map(str, forbidden))}
        case GiveUp(reason):
            return {"decision": "give up", "why": reason}
