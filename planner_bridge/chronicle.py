"""What has become of a pursuit so far: its plans, its runs, and what they teach."""

from __future__ import annotations

from dataclasses import dataclass, field

from planner_bridge.forbidding import ANY, ForbiddenCall
from planner_bridge.plan import Plan, PlanningResult
from planner_bridge.replanning import Decision, GiveUp, History, PlanAgain, Resume
from planner_bridge.tasks import Episode
from pnm.machine import PetriNetMachine
from pnm.results import Failure, RunResult
from pnm.trajectory import Constraint


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

    def last_failure(self, missing: tuple[Constraint, ...]) -> str:
        """Say, behind the reason for an end, what failed last and which constraints are not fulfilled."""
        if not self.episodes:
            return ""
        result = self.episodes[-1].result
        failure = "" if result.goal else f"; last failure: {result.reason}"
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        return failure + (f"; not fulfilled: {', '.join(map(str, missing[:3]))}{more}" if missing else "")


def no_plan(found: PlanningResult, forbidden: frozenset[ForbiddenCall]) -> str:
    """Say why there is no plan."""
    failed = sorted(str(call) for call in forbidden if ANY not in call.arguments)
    lacking = sorted(str(call) for call in forbidden if ANY in call.arguments)
    without = [
        *([f" without {', '.join(failed)}, which failed too often"] if failed else []),
        *([f" without {', '.join(lacking)}, which would need what others keep"] if lacking else []),
    ]
    return f"no plan{' and'.join(without)}: {found.reason}"
