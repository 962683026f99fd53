"""Plans as planners return them, and what else planners answer."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol


@dataclass(frozen=True, slots=True)
class PlanStep:
    """A ground action and when it starts, in seconds; its position, in a sequential plan."""

    action: str
    arguments: tuple[str, ...] = ()
    start: float = 0.0
    duration: float = 0.0

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps in the order of their starts."""

    steps: tuple[PlanStep, ...] = ()
    temporal: bool = False
    """Whether starts and durations are times; otherwise the steps are meant one after the other."""
    cost: float | None = None

    def __str__(self) -> str:
        if not self.steps:
            return "nothing to do: the goal holds already"
        head = f"{len(self.steps)} calls" + (f", {self.makespan:.1f} s" if self.temporal else "")
        return "\n".join((head, *(self._line(number, step) for number, step in enumerate(self.steps, 1))))

    def _line(self, number: int, step: PlanStep) -> str:
        return f"  {step.start:8.2f} s  {step}  [{step.duration:.2f} s]" if self.temporal else f"  {number:8d}.   {step}"

    @property
    def makespan(self) -> float:
        """The time from the start to the last end."""
        return max((step.start + step.duration for step in self.steps), default=0.0)


class PlanningStatus(Enum):
    """How a search for a plan ended."""

    SOLVED = "solved"
    UNSOLVABLE = "proved unsolvable"
    NO_PLAN = "no plan found"
    TIMED_OUT = "time-out"
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"
    UNSUPPORTED = "unsupported"
    INVALID = "invalid input"
    CRASHED = "planner crashed"
    INVALID_PLAN = "plan not valid"
    DISAGREEMENT = "validators disagree"


@dataclass(frozen=True, slots=True)
class PlanningResult:
    """The answer of a planner: a valid plan, or why there is none."""

    status: PlanningStatus
    plan: Plan | None = None
    message: str = ""
    planner: str = ""
    """Which found the plan, or did not; several that raced, joined by commas."""

    @property
    def reason(self) -> str:
        """The status, and what the planner said about it."""
        return f"{self.status.value}{f': {self.message}' if self.message else ''}"


class Stop(Protocol):
    """Tells a search when nobody wants its plan any more; a `threading.Event` does."""

    def is_set(self) -> bool:
        """Tell whether to stop."""
