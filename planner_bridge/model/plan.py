"""Plans and planning results, as planners return them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from pnm.errors import counted


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
    """Whether starts and durations are times; otherwise the steps follow one another."""
    cost: float | None = None
    """By the metric of the problem; None without one."""
    is_best: bool = False
    """Whether it is proved that no plan is better: costs less, or without a metric has fewer steps or takes less time."""

    def __str__(self) -> str:
        if not self.steps:
            return "nothing to do: the goal is empty, holds already, or comes by itself"
        parts = [counted(len(self.steps), "call"), *([f"{self.makespan:.1f} s"] if self.temporal else ())]
        parts += [f"cost {self.cost:g}"] if self.cost is not None else ()
        head = ", ".join((*parts, *(["no plan is better"] if self.is_best else ())))
        lines = (
            f"  {step.start:8.2f} s  {step}  [{step.duration:.2f} s]" if self.temporal else f"  {number:8d}.   {step}"
            for number, step in enumerate(self.steps, 1)
        )
        return "\n".join((head, *lines))

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
    """The planner that found the plan, or did not; the members of a portfolio, joined by commas."""

    @property
    def reason(self) -> str:
        """The status and the planner's message."""
        return f"{self.status.value}{f': {self.message}' if self.message else ''}"


class CancelToken(Protocol):
    """Set from another thread to end a search; a `threading.Event` is one."""

    def is_set(self) -> bool:
        """Whether to stop."""
