"""How runs, their calls and their failures are told."""

from __future__ import annotations

from dataclasses import dataclass

from pnm.plan_graph import ActionCall, Step


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
