"""After a failed run: does the rest of the plan still work, or must there be a new one, or is it over?

Pure: decides from what is known; `planner_bridge.pipeline` acts on it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from planner_bridge.state import ForbiddenCall
from pnm.conditions import Condition, evaluate, failing, observed
from pnm.effects import changes
from pnm.knowledge import KnowledgeBase
from pnm.plan_graph import GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.results import CallResult, Failure

_FINISHED = frozenset({"succeeded", "already true"})
_WORLD = frozenset({"precondition_false", "invariant_false"})
"""Causes that speak against the state of the world, not against the action: it may be planned with again."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How long a task is pursued."""

    replans: int = 10
    """New nets after the first, whether or not a planner was asked."""
    seconds: float = 3600.0
    """From the start of the task, on the clock of the run."""
    forbid_after: int = 2
    """A ground action that failed so often is not planned with any more."""
    backoff: float = 0.5
    """Seconds before the second replan in a row without progress; doubled each time."""
    longest_backoff: float = 30.0


@dataclass(frozen=True)
class History:
    """What a task remembers about its failures."""

    failed: dict[ForbiddenCall, int] = field(default_factory=dict)
    replans: int = 0
    fruitless: int = 0
    """Runs in a row in which no call succeeded."""

    def after(self, calls: Iterable[CallResult], failures: Iterable[Failure]) -> History:
        """Return the history with one more failed run."""
        failed = dict(self.failed)
        for failure in failures:
            if failure.cause in _WORLD:
                continue
            call = ForbiddenCall(failure.call.action.name, failure.call.action.arguments)
            failed[call] = failed.get(call, 0) + 1
        progress = any(one.outcome == "succeeded" for one in calls)
        return History(failed, self.replans + 1, 0 if progress else self.fruitless + 1)

    def forbidden(self, limits: Limits) -> frozenset[ForbiddenCall]:
        """Return the ground actions that failed too often."""
        return frozenset(call for call, times in self.failed.items() if times >= limits.forbid_after)

    def pause(self, limits: Limits) -> float:
        """Return how many seconds to wait before trying again."""
        return 0.0 if self.fruitless < 2 else min(limits.longest_backoff, limits.backoff * 2.0 ** (self.fruitless - 2))


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on with the rest of the plan in a new net; no planner is asked."""

    rest: PlanGraph


@dataclass(frozen=True, slots=True)
class PlanAgain:
    """Ask the planner, without the forbidden calls."""

    forbidden: frozenset[ForbiddenCall]
    why: str


@dataclass(frozen=True, slots=True)
class GiveUp:
    """A limit is reached."""

    reason: str


def decide(
    plan: PlanGraph,
    calls: tuple[CallResult, ...],
    knowledge: KnowledgeBase,
    history: History,
    limits: Limits,
    elapsed: float,
    *,
    timed: bool = False,
) -> Resume | PlanAgain | GiveUp:
    """Decide what follows a run that ended without the goal; `history` includes that run.

    With `timed` changes ahead the old plan is not trusted: only a planner knows what its delay means.
    """
    if history.replans > limits.replans:
        return GiveUp(f"the limit of {limits.replans} replans is reached")
    if elapsed > limits.seconds:
        return GiveUp(f"the limit of {limits.seconds:g} s is reached")
    forbidden = history.forbidden(limits)
    rest = rest_of(plan, calls, elapsed)
    obstacle = "facts will change by themselves, so the times of the plan matter" if timed else why_not(rest, knowledge, forbidden)
    return Resume(rest) if not obstacle else PlanAgain(forbidden, obstacle)


def rest_of(plan: PlanGraph, calls: tuple[CallResult, ...], elapsed: float = 0.0) -> PlanGraph:
    """Return the calls that are not finished, renumbered, with the orderings among them."""
    kept = [one.call for one in calls if one.outcome not in _FINISHED]
    number = {call.index: position for position, call in enumerate(kept)}
    renumbered = tuple(replace(call, index=number[call.index], release=max(0.0, call.release - elapsed)) for call in kept)
    orderings = tuple(
        Ordering(_moved(one.before, number), _moved(one.after, number), one.protects)
        for one in plan.orderings
        if one.before.call in number and one.after.call in number
    )
    return PlanGraph(renumbered, orderings, plan.goal)


def _moved(event: PlanEvent, number: dict[int, int]) -> PlanEvent:
    return PlanEvent(number[event.call], event.moment)


def why_not(plan: PlanGraph, knowledge: KnowledgeBase, forbidden: frozenset[ForbiddenCall] = frozenset()) -> str:
    """Return why the plan does not lead from what is known to its goal; empty when it does.

    Walks through the events in an order that the plan allows and applies them to a copy of the state.
    """
    for call in plan.calls:
        if ForbiddenCall(call.action.name, call.action.arguments) in forbidden:
            return f"{call.action} has failed too often"
    state = KnowledgeBase(knowledge.facts(), objects=knowledge.objects_by_type())
    running: dict[int, GroundAction] = {}
    for event in plan.in_order():
        action = plan.calls[event.call].action
        starts = event.moment is Moment.START
        condition = action.precondition if starts else action.end_condition
        if evaluate(condition, state) is not True:
            return f"{action} would {'start' if starts else 'end'} although {_denied(condition, state)}"
        state.update(changes(action.start_effects if starts else action.end_effects, state))
        if starts:
            running[event.call] = action
        else:
            del running[event.call]
        for other in running.values():
            if evaluate(other.invariant, state) is not True:
                return f"{other} would go on although {_denied(other.invariant, state)}"
    return "" if evaluate(plan.goal, state) is True else f"the rest of the plan would leave {_denied(plan.goal, state)}"


def _denied(condition: Condition, state: KnowledgeBase) -> str:
    return "; ".join(observed(part, state) for part in failing(condition, state))
