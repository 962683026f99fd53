"""After a failed run: does the rest of the plan still work, or must there be a new one, or is it over?

Pure: decides from what is known; `planner_bridge.pipeline` acts on it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from planner_bridge.course import Course, Denied, seen_instead, snapshot
from planner_bridge.forbidding import ForbiddenCall
from planner_bridge.model import Problem
from planner_bridge.plans import in_causal_order
from pnm.conditions import evaluate
from pnm.knowledge import KnowledgeBase
from pnm.ledger import UNCONFIRMED
from pnm.plan_graph import ActionCall, PlanEvent, PlanGraph
from pnm.results import CallResult, Failure
from pnm.trajectory import IMPOSSIBLE, Constraint, instances, is_fulfilled, progressed

_FINISHED = frozenset({"succeeded", "already true"})
_WORLD = frozenset({"precondition_false", "invariant_false"})
"""Causes that speak against the state of the world, not against the action: it may be planned with again."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How long a task is pursued."""

    replans: int = 10
    """New nets after the first, whether or not a planner was asked."""
    seconds: float | None = None
    """From the start of the task, on the clock of its runs; then it is stopped. By default an hour, or what `allowed` says."""
    forbid_after: int = 2
    """A ground action that failed so often since it last succeeded is not planned with any more."""
    backoff: float = 0.5
    """Seconds before the second replan in a row without progress; doubled each time."""
    longest_backoff: float = 30.0

    def allowed(self, planned: float = 0.0) -> float:
        """Return how many seconds a task may take whose plan takes so many: three times as long if nothing else is said."""
        return max(3600.0, 3.0 * planned) if self.seconds is None else self.seconds


@dataclass(frozen=True)
class History:
    """What a task remembers about its failures."""

    failed: dict[ForbiddenCall, int] = field(default_factory=dict)
    unconfirmed: frozenset[ForbiddenCall] = frozenset()
    """Calls whose server has not confirmed that it stopped: it may still be at work."""
    replans: int = 0
    fruitless: int = 0
    """Runs in a row in which no call succeeded."""

    def after(self, calls: Iterable[CallResult], failures: Iterable[Failure]) -> History:
        """Return the history with one more failed run."""
        calls, failures = tuple(calls), tuple(failures)
        failed = dict(self.failed)
        of_calls = [(one, one.call) for one in failures if isinstance(one.call, ActionCall)]
        for failure, failed_call in of_calls:
            if failure.cause not in _WORLD:
                call = ForbiddenCall.of(failed_call.action)
                failed[call] = failed.get(call, 0) + 1
        for one in calls:
            if one.outcome == "succeeded":
                failed.pop(ForbiddenCall.of(one.call.action), None)
        at_work = [call for failure, call in of_calls if failure.unconfirmed]
        at_work += [one.call for one in calls if one.outcome == UNCONFIRMED]
        progress = any(one.outcome == "succeeded" for one in calls)
        return History(
            failed,
            self.unconfirmed | {ForbiddenCall.of(call.action) for call in at_work},
            self.replans + 1,
            0 if progress else self.fruitless + 1,
        )

    def forbidden(self, limits: Limits) -> frozenset[ForbiddenCall]:
        """Return the ground actions that failed too often, or whose servers may still be at work."""
        return self.unconfirmed | {call for call, times in self.failed.items() if times >= limits.forbid_after}

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


Decision = Resume | PlanAgain | GiveUp


def decide(
    now: Problem, plan: PlanGraph, calls: tuple[CallResult, ...], knowledge: KnowledgeBase, history: History, limits: Limits
) -> Decision:
    """Decide what follows a run that ended without the goal.

    Args:
        now: the problem from the world as it is known to be.
        plan: what the run executed.
        calls: what became of its calls.
        knowledge: what is known.
        history: of all failures, those of this run included.
        limits: how long to go on.
    """
    if history.replans > limits.replans:
        return GiveUp(f"the limit of {limits.replans} replans is reached")
    forbidden = history.forbidden(limits)
    constraints = (*now.domain.constraints, *now.constraints)
    whole = "; the whole network of tasks is planned for once more" if now.network else ""
    if now.timed:  # only a planner knows what the delay means
        return PlanAgain(forbidden, f"facts will change by themselves, so the times of the plan matter{whole}")
    if timed := [str(one) for one in constraints if one.times]:
        return PlanAgain(forbidden, f"the times of the plan matter to {', '.join(timed)}{whole}")
    rest = rest_of(now, plan, calls)
    obstacle = why_not(rest, knowledge, forbidden, constraints)
    return PlanAgain(forbidden, obstacle + whole) if obstacle else Resume(rest)


def rest_of(now: Problem, plan: PlanGraph, calls: tuple[CallResult, ...]) -> PlanGraph:
    """Return the calls that are not finished, in an order of events of the old plan, with the orderings that their causes demand."""
    kept = [one.call for one in calls if one.outcome not in _FINISHED]
    number = {call.index: position for position, call in enumerate(kept)}
    renumbered = tuple(replace(call, index=number[call.index]) for call in kept)
    order = [PlanEvent(number[event.call], event.moment) for event in plan.in_order() if event.call in number]
    return in_causal_order(now, renumbered, order)


def why_not(
    plan: PlanGraph,
    knowledge: KnowledgeBase,
    forbidden: frozenset[ForbiddenCall] = frozenset(),
    constraints: tuple[Constraint, ...] = (),
) -> str:
    """Return why the plan does not lead from what is known to its goal; empty when it does.

    Walks through the events in an order that the plan allows and applies them to a copy of the state,
    through which the constraints, none of which may speak of times, are progressed.
    """
    for call in plan.calls:
        if ForbiddenCall.of(call.action) in forbidden:
            return f"{call.action} has failed too often, or its server may still be at work"
    course = Course(snapshot(knowledge))
    left = {one: progressed((one,), course.state) for constraint in constraints for one in instances(constraint, course.state)}
    for event in plan.in_order():
        try:
            course.happen([(event, plan.calls[event.call].action)])
        except Denied as denied:
            return f"{plan.calls[denied.call].action} would {denied.deed} although {denied.observed}"
        left = {constraint: progressed(rest, course.state) for constraint, rest in left.items()}
        for constraint, rest in left.items():
            if IMPOSSIBLE in rest:
                return f"the {event.moment.value} of {plan.calls[event.call].action} would violate {constraint}"
    if evaluate(plan.goal, course.state) is not True:
        return f"the rest of the plan would leave {seen_instead(plan.goal, course.state)}"
    missing = [str(constraint) for constraint, rest in left.items() if not is_fulfilled(rest, course.state)]
    return f"the rest of the plan would leave {', '.join(missing)} unfulfilled" if missing else ""
