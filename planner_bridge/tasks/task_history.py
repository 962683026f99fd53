"""History of a task: plans found, runs, and failure counts for replanning."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from planner_bridge.model.forbidden_actions import ANY, ForbiddenCall
from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.tasks.replanning import Decision, GiveUp, History, PlanAgain, Resume
from planner_bridge.tasks.result import Episode
from pnm.core.execution.call_results import Failure, RunResult
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Cause

_HAPPENED: Final = {
    Cause.ABORTED: "was aborted",
    Cause.CANCELED: "was cancelled",
    Cause.REJECTED: "was rejected",
    Cause.TIMED_OUT: "timed out",
    Cause.UNAVAILABLE: "found no server",
    Cause.LOST: "lost its server",
    Cause.WITHHELD: "has waited in vain for what others keep",
}
"""Predicates of sentences about calls, by the cause of the failure."""


@dataclass(frozen=True, slots=True)
class Way:
    """How to go on after a run: with a new plan, or with the rest of the old one."""

    decision: Resume | PlanAgain
    history: History
    """The one from then on."""
    plan: Plan | None = None


@dataclass
class Chronicle:
    """What is remembered. Everything in it is mutable state."""

    history: History = field(default_factory=History)
    episodes: list[Episode] = field(default_factory=list)
    plans: int = 0
    """How many have been found, or given."""

    @property
    def failures(self) -> list[Failure]:
        """Everything that failed in the runs that are over."""
        return [failure for episode in self.episodes for failure in episode.result.failures]

    def follow(self, way: Way, machine: PetriNetMachine, result: RunResult) -> None:
        """Note that a run is followed by another."""
        self.history = way.history
        self._add(machine, result, way.decision)

    def end(self, machine: PetriNetMachine, result: RunResult, decision: GiveUp | None = None) -> None:
        """Note that a run is followed by none."""
        self._add(machine, result, decision)

    def _add(self, machine: PetriNetMachine, result: RunResult, decision: Decision | None) -> None:
        self.episodes.append(Episode(machine, result, decision))

    @property
    def last_failure(self) -> str:
        """What failed last; empty when nothing has."""
        return "" if not self.episodes or self.episodes[-1].result.goal else f"last failure: {self.episodes[-1].result.reason}"

    def unfulfilled(self, missing: tuple[Constraint, ...]) -> str:
        """Say which constraints are not fulfilled after what was done; empty when all are, or nothing was done."""
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        return f"not fulfilled: {', '.join(map(str, missing[:3]))}{more}" if self.episodes and missing else ""


def no_plan(found: PlanningResult, forbidden: frozenset[ForbiddenCall]) -> str:
    """Say why there is no plan."""
    failed = sorted(str(call) for call in forbidden if ANY not in call.arguments)
    lacking = sorted(str(call) for call in forbidden if ANY in call.arguments)
    without = [
        *([f" without {', '.join(failed)}, not to be tried again"] if failed else []),
        *([f" without {', '.join(lacking)}, for which others keep what is needed"] if lacking else []),
    ]
    return f"no plan{' and'.join(without)}: {found.reason}"


def tries_again(seconds: float, result: RunResult) -> str:
    """Say that there is a pause before what follows a run, and why the run has failed."""
    return f"tries again in {seconds:g} s after {_happened(result.failures[-1]) if result.failures else result.reason}"


def _happened(failure: Failure) -> str:
    subject = failure.call.action if isinstance(failure.call, ActionCall) else failure.call
    return f"{subject} {_HAPPENED.get(failure.cause, f'failed: {failure.cause}')}"


def sentence(*parts: str) -> str:
    """Join what there is to be said."""
    return "; ".join(filter(None, parts))
