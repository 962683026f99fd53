"""Better rests of plans, looked for while robots carry the plans out.

What begins before the search is over stays as it is. The search continues with the rest as it is: parts of it are replaced by better
ones, and Kairos looks for other plans from the state after what stays. A rest is better if it saves more expected robot time than the
exchange of plans costs; with a metric, if it is better by that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, calls_of
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.ordering.robot_time import ExpectedTimes, ends_of
from planner_bridge.planning.kairos import AT_WORK, DEFAULT_PLANNER, LONGEST, SHARE
from planner_bridge.planning.parts import can_have_parts
from planner_bridge.planning.solve import cost_of
from pnm.core.logic.expressions import Unknown
from pnm.core.machine.plan_graph import ActionCall, Moment, PlanEvent, PlanGraphError
from pnm.errors import InputError, counted

WORTH_IT: Final = 10.0
"""Seconds of robot time that are left of a plan, at least, when a better rest of it is looked for."""
EXCHANGE: Final = 1.0
"""Seconds of robot time that a better rest saves, at least: nothing begins while plans are exchanged."""
_SLACK: Final = 1.5
"""What begins within the time for the search, and half as much again, stays as it is."""


@dataclass(frozen=True, slots=True)
class Improvement:
    """A better rest of a plan: steps in place of calls that have not begun, by number, and in words what they save."""

    replaced: frozenset[int]
    steps: tuple[PlanStep, ...]
    why: str

    def rest(self, waiting: Iterable[ActionCall]) -> Plan:
        """Return the plan from now on, given the calls of the old one that have still to begin."""
        return Plan((*steps_of(call for call in waiting if call.index not in self.replaced), *self.steps))


def steps_of(calls: Iterable[ActionCall]) -> tuple[PlanStep, ...]:
    """Return calls as steps of a plan without times."""
    return tuple(PlanStep(call.action.name, call.action.arguments) for call in calls)


def can_be_improved(problem: Problem, planner: str) -> bool:
    """Return whether better rests can be looked for: plans are sequences of calls of which only the end matters, and Kairos finds them."""
    return planner == DEFAULT_PLANNER and can_have_parts(problem) and not problem.domain.uncertain


def improvement(
    now: Problem,
    under_way: Mapping[int, float],
    calls: Sequence[ActionCall],
    waiting: Sequence[ActionCall],
    rates: ExpectedTimes,
    improve: float | None,
    search: Callable[..., PlanningResult],
) -> tuple[float, Improvement | None]:
    """Look for a better rest of a plan; return the seconds that the rest takes as it is, and the better one.

    Args:
        now: the problem from the state in which everything that is under way has ended.
        under_way: the seconds for that, by the numbers of the calls.
        calls: of the plan.
        waiting: those of them that have still to begin, in an order that the plan allows.
        improve: seconds for the search; None for what it is worth.
        search: `solve`, with what is the same for all searches of a task.
    """
    lasting, going_on = dict(enumerate(under_way.values())), [calls[number] for number in under_way]

    def ends(steps: tuple[PlanStep, ...]) -> list[float]:
        return ends_of(plan_graph(now, Plan(steps), going_on), rates, lasting)

    def work(some: Iterable[ActionCall]) -> float:
        return sum(rates.expected(call.action) for call in some)

    whole = work(waiting) + max(under_way.values(), default=0.0)
    try:
        times = ends(steps_of(waiting))
        whole = max(times, default=0.0)
        thinks = min(LONGEST, whole * SHARE) * AT_WORK if improve is None else min(improve, whole / 4.0)
        begins = {call.index: end - rates.expected(call.action) for call, end in zip(waiting, times[len(going_on) :], strict=True)}
        stays = [call for call in waiting if begins[call.index] <= thinks * _SLACK]
        replaced = [call for call in waiting if begins[call.index] > thinks * _SLACK]
        if whole < WORTH_IT or not replaced:
            return whole, None
        after, known = Progression(initial_knowledge(now)), Plan(steps_of(replaced))
        for call in stays:
            for moment in Moment:
                after.advance([(PlanEvent(call.index, moment), call.action)])
        facts = {fluent: value for fluent, value in after.state.facts().items() if not isinstance(value, Unknown)}
        later = replace(now, init=facts)
        found = search(later, known=known, improve=improve and thinks).plan
        if found is None or found.steps == known.steps:
            return whole, None
        saves = whole - max(ends((*steps_of(stays), *found.steps)), default=0.0)
        why = _saved(later, known, found, saves, work(replaced) - work(calls_of(later, found)), is_known=rates.are_measure(now))
    except (InputError, NotApplicable, PlanGraphError):  # what is under way may not fit into any plan
        return whole, None
    return whole, Improvement(frozenset(call.index for call in replaced), found.steps, why) if why else None


def _saved(later: Problem, known: Plan, found: Plan, seconds: float, work: float, *, is_known: bool) -> str:
    """Return in words what a better plan saves; empty if that is not worth the exchange.

    Args:
        seconds: those until all is carried out that it saves.
        work: the seconds of all calls that it saves.
        is_known: whether anything is known about how long calls take.
    """
    if (cost := cost_of(later, known)) is not None and (its := cost_of(later, found)) is not None:
        is_less = its > cost if later.metric and later.metric.direction == "maximize" else its < cost
        return f"it costs {its:g} in place of {cost:g}" if is_less else ""
    if seconds >= EXCHANGE and is_known:
        return f"it takes {seconds:.0f} s less"
    if min(seconds, work) < 0.0 or max(seconds, work) < EXCHANGE:
        return ""
    return f"its calls take {work:.0f} s less" if is_known else f"it has {counted(round(work), 'call')} less"
