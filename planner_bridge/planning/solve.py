"""Problem → plan: solve → search → Kairos in this process, or an engine in a process of its own; a portfolio searches with several.

Every plan is validated before it is returned (`planner_bridge.planning.validate`). A limit in seconds bounds every
search, and what its plan does not need is left out in what remains of it; a search can be cancelled from another thread.
A plan may be improved while robots carry it out.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Final

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import CancelToken, Plan, PlanningResult, PlanningStatus, PlanStep, Policy
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.model.progression import Happening, NotApplicable, Progression, Stage, calls_of, happenings, refuse, snapshot
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.kairos import AT_WORK, DEFAULT_PLANNER, GLANCE, parse_for_kairos, search, validate, worth
from planner_bridge.planning.parts import can_have_parts
from planner_bridge.planning.validate import InvalidPlan, explained, last_state, validated
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TOLERANCE, Condition, Holds, Not, conjuncts, evaluate, fluents, names
from pnm.core.logic.effects import When, choices_in_effects, decided, names_written, possible_assignments
from pnm.core.logic.expressions import EXISTS, Constant, Fluent, Unknown, Value, ValueOf, value_of
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraphError
from pnm.errors import InputError, check_kinds, check_seconds, counted

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import kairos

    from planner_bridge.model.rates import Rates
    from planner_bridge.ordering.robot_time import ExpectedTimes
    from pnm.core.machine.bindings import Bindings

PORTFOLIO: Final = "race"
"""The planner's name for a portfolio of what is installed; ``race:kairos,aries`` names its members."""
_FOR_POLICIES: Final = 0.8
"""Part of the time for a policy; in the rest, a plan is looked for as if outcomes could be chosen."""
_POLICY_AT_WORK: Final = 2.0
"""Seconds for which a policy is improved at least while robots work, if nothing else is said."""
_LONGEST: Final = 1e9
"""Seconds that a search may take: the clocks of planners overflow with far more."""
_PORTFOLIO_OF: Final = f"{PORTFOLIO}:"
_BOUND: Final = 0.5
"""Seconds to find out how far from the best a plan is that people look at."""


def solve(
    problem: Problem,
    *,
    planner: str = DEFAULT_PLANNER,
    timeout: float = 30.0,
    improve: float | None = None,
    cancel: CancelToken | None = None,
    executor: Executor | None = None,
    bindings: Bindings | None = None,
    learned: Rates | None = None,
    known: Plan | None = None,
    before: Policy | None = None,
    is_looked_at: bool = False,
) -> PlanningResult:
    """Search for a plan, validate it, and leave out what it does not need, at most `timeout` seconds.

    Of an action with several outcomes the plan expects the one that suits it; there is a policy for the others, if one was found.

    Args:
        planner: kairos, an engine of unified-planning, ``race`` for several at once, or ``race:kairos,aries`` for these.
        timeout: seconds that the search may take, besides the time to load a planner; a plan that is found late keeps what it has.
        improve: seconds for which Kairos looks for a better plan once there is one; 0 for the first plan, the same every time. By default
            a share of the time that the plan is expected to take.
        cancel: set from another thread to end the search.
        executor: runs the planners of a portfolio; threads by default.
        bindings: say how long actions take, where the domain does not, and which resources they need for themselves.
        learned: say how long they take, how often they succeed, and which outcomes they have, by what has happened.
        known: a plan that robots carry out meanwhile: Kairos looks for a better one alone, and for longer.
        before: a policy that was followed so far: what was found for it is used if it is for the same goal.
        is_looked_at: whether the plan is for people alone. Unless they say how long it may be improved, they get plans with times or a
            metric at once; of others a lower bound says how far they are from the best, and when there is no need to look for a better one.

    Raises:
        InputError: the planner refuses the problem, is not known, or is not installed.
    """
    check_kinds("solve", {"problem": (problem, Problem), "planner": (planner, str)})
    check_seconds("the search for a plan", timeout)
    check_seconds("the search for a better plan", improve)
    bound = _BOUND if is_looked_at else 0.0
    if is_looked_at and improve is None and (problem.is_timed or problem.metric):
        improve, bound = GLANCE, 0.0
    rates = None
    if bindings or learned:
        from planner_bridge.model.rates import NO_RATES  # here, because most problems are about no robot that is known
        from planner_bridge.ordering.robot_time import ExpectedTimes
        from pnm.core.machine.bindings import NO_BINDINGS

        rates = ExpectedTimes(bindings or NO_BINDINGS, learned or NO_RATES, problem.init)
    if not problem.domain.uncertain:
        return explained(problem, _searched(problem, planner, timeout, improve, cancel, executor, rates, known, bound))
    if problem.has_tasks:
        message = "task networks with actions that have several outcomes"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    from planner_bridge.model.determinization import determinization  # here, because most actions have one outcome

    note, until = "", time.monotonic() + timeout

    def chosen() -> PlanningResult:
        """Search for a plan as if outcomes could be chosen."""
        each = determinization(problem)
        those = rates and replace(rates, bindings=each.bindings(rates.bindings), learned=each.rates(rates.learned))
        found = _searched(each.problem, planner, max(0.0, until - time.monotonic()), improve, cancel, executor, those)
        return found if found.plan is None else replace(found, plan=each.plan(found.plan))

    if planner == DEFAULT_PLANNER:
        from planner_bridge.planning.policies.task import Unsuitable  # here, as above

        try:
            return _with_policy(problem, timeout, improve, cancel, rates, bindings, before, chosen)
        except Unsuitable as unsuitable:
            note = str(unsuitable)
    found = chosen()
    return explained(problem, found) if found.plan is None else replace(found, message=note)


def _with_policy(
    problem: Problem,
    timeout: float,
    improve: float | None,
    cancel: CancelToken | None,
    rates: ExpectedTimes | None,
    bindings: Bindings | None,
    before: Policy | None,
    chosen: Callable[[], PlanningResult],
) -> PlanningResult:
    """Return the plan that a policy begins with, and the policy, which goes on getting better.

    If none is found in time, a plan is followed with luck, and the search goes on; at once where the last search was in vain.

    Args:
        chosen: searches for a plan as if outcomes could be chosen.

    Raises `Unsuitable` if there are no policies for such a problem.
    """
    from planner_bridge.model.determinization import untold  # here, because most actions have one outcome
    from planner_bridge.planning.policies.policy import PolicySearch, Thinking, WithLuck

    until = time.monotonic() + _FOR_POLICIES * timeout
    last = before.search if isinstance(before, Thinking) else None
    seconds = rates.expected if rates is not None and (problem.is_timed or rates.are_measure(problem)) else None

    def at_work(taken: float) -> float:
        return max(_POLICY_AT_WORK, AT_WORK * worth(taken)) if improve is None else improve

    def is_over() -> bool:
        return time.monotonic() > until or (cancel is not None and cancel.is_set())

    search = PolicySearch(problem, seconds, rates.outcomes if rates else None, last, is_over)
    found = chosen() if search.is_hard or search.task.measure != "calls" else None
    search.plan = found.plan if found else None
    thinking = Thinking(search, timeout, cancel, at_work)
    policy = thinking.policy if search.is_hard and found and found.plan else thinking.wait(until - time.monotonic(), improve, worth)
    plan = None if policy is None else policy.plan(initial_knowledge(problem))
    if plan is None:
        found = found or chosen()
        if found.plan is None:
            return explained(problem, found)
        thinking.fallback = WithLuck(problem, found.plan)
        return replace(found, message="no policy was found in time", policy=thinking)
    unseen = untold(problem, bindings, bindings.assumed) if bindings else ()
    notes = [f"nothing tells {' and '.join(ways)} of {action} apart: there the policy may not go on" for action, ways, _ in unseen]
    return PlanningResult(PlanningStatus.SOLVED, plan, "; ".join(notes), planner=DEFAULT_PLANNER, policy=thinking)


def _searched(
    problem: Problem,
    planner: str,
    timeout: float,
    improve: float | None,
    cancel: CancelToken | None,
    executor: Executor | None,
    rates: ExpectedTimes | None,
    known: Plan | None = None,
    bound: float = 0.0,
) -> PlanningResult:
    """Return what is found for a problem whose actions have one outcome each, with the planner's own reason if that is no plan."""
    asked = problem
    if rates is not None:
        from planner_bridge.model.guards import with_turns  # here, as above

        asked = with_turns(problem, rates.bindings)
    stop, timeout = cancel or threading.Event(), min(timeout, _LONGEST)
    until = time.monotonic() + timeout
    if planner == PORTFOLIO or planner.startswith(_PORTFOLIO_OF):
        from planner_bridge.planning.portfolio import solve_with_portfolio  # here, because most searches use one planner

        members = None if planner == PORTFOLIO else _portfolio_members(planner)
        found = solve_with_portfolio(asked, planners=members, timeout=timeout, executor=executor, cancel=stop)
        return reduced(problem, found, until=until, rates=rates)
    least = -inf
    if bound:
        from planner_bridge.planning.lower_bound import lower_bound  # here, because robots wait for most plans

        least = lower_bound(problem, rates, time.monotonic() + min(bound, timeout))
    parsed = parse_for_kairos(asked) if planner == DEFAULT_PLANNER else None  # once, for its search and its validator
    found = search(asked, planner, timeout, stop, improve=improve, parsed=parsed, rates=rates, known=known, least=least)
    result = reduced(problem, validated(problem, found, parsed), parsed, until=until, rates=rates)
    if result.plan is None or not least > 0.0:
        return result
    is_best = result.plan.is_best or result.plan.value <= least + TOLERANCE
    above = 0.0 if is_best else (result.plan.value - least) / least
    return replace(result, plan=replace(result.plan, is_best=is_best, above=above))


def check_planner(planner: str, cancel: CancelToken | None = None) -> None:
    """Refuse a planner that is not known or not installed, before it is needed; looking up an unfamiliar name takes some seconds.

    The check can be cancelled from another thread.
    """
    if planner in (DEFAULT_PLANNER, PORTFOLIO):
        return
    if planner.startswith(_PORTFOLIO_OF):
        from planner_bridge.planning.portfolio import check_members  # here and below, because Kairos needs neither

        check_members(_portfolio_members(planner))
    else:
        from planner_bridge.planning.engines import check_engine

        check_engine(planner, cancel or threading.Event())


def _portfolio_members(planner: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in planner.removeprefix(_PORTFOLIO_OF).split(","))


# --- reduction ------------------------------------------------------------------------------------
# Plan reduction: calls that a plan does not need are left out, one by one or with those that rest on them.
#
# Greedy action elimination (Nakhost and Müller, Action Elimination and Plan Neighborhood Graph Search, 2010): a step is left out, and
# with it all steps that cannot be carried out then; if the goal is reached all the same, and at no higher cost, the plan stays so.
# Steps without which no part of the plan reaches the goal (`indispensable`) are not tried, and where one of them is lost the rest need not
# be looked at: robots wait for this. When the work or the time is over, the plan stays as it is by then.


WORK: Final = 32_000
"""Happenings that are simulated at most: enough for every step of a plan of 250. All of them would grow with the square of its length."""
_CHOICES: Final = 8
"""Choices of objects in effects that take as long as one happening without."""


def reduced(
    problem: Problem,
    result: PlanningResult,
    parsed: kairos.Problem | None = None,
    *,
    until: float = inf,
    rates: ExpectedTimes | None = None,
) -> PlanningResult:
    """Return the result with a plan that has no needless step.

    A plan of a task network, or with preferences, is more than a way to a goal, and a step less shifts what processes do: they stay.

    Args:
        parsed: the problem as Kairos reads it, if that is there already.
        until: when to stop looking, on the clock of `time.monotonic`; the plan may have needless steps then.
    """
    plan = result.plan
    if plan is None or problem.network or problem.has_preferences or problem.domain.nature:
        return result
    if problem.metric is not None:
        plan = replace(plan, cost=cost_of(problem, plan))
    shorter, work = plan, WORK
    actions = dict(zip(plan.steps, with_lasting_facts(problem, [call.action for call in calls_of(problem, plan)]), strict=True))
    while len((less := (elimination := _Elimination(problem, shorter, actions, work)).without_needless(until)).steps) < len(shorter.steps):
        shorter, work = less, elimination.work  # without a call another one may be needless that was not before
    is_shorter = len(shorter.steps) < len(plan.steps)
    if is_shorter and validate(problem, shorter, parsed):
        return result
    if rates is not None and rates.are_measure(problem):
        from planner_bridge.ordering.robot_time import robot_time

        shorter = replace(shorter, seconds=robot_time(problem, shorter, rates))
    return replace(result, plan=shorter)


def with_lasting_facts(problem: Problem, actions: Sequence[GroundAction]) -> list[GroundAction]:
    """Return the actions with those conditions of their effects decided that none of them changes, nor anything by itself."""
    changing = {fluent[0] for change in problem.timed for fluent in change.changes}
    changing = changing.union(*(names_written((*action.start_effects, *action.end_effects)) for action in actions))
    state, rules = initial_knowledge(problem), problem.domain.rules

    def lasts(effect: When) -> bool:
        return changing.isdisjoint(rules.base(names(effect.condition)))

    if EXISTS in changing:  # then there are more objects later
        return [*actions]
    both = [(decided(action.start_effects, state, lasts), decided(action.end_effects, state, lasts)) for action in actions]
    return [replace(action, start_effects=start, end_effects=end) for action, (start, end) in zip(actions, both, strict=True)]


def indispensable(problem: Problem, actions: Sequence[GroundAction]) -> frozenset[int]:
    """Return numbers of actions that are in every part of the plan that reaches the goal; not all of them are found.

    What does not hold at first has to be made true. If a single action can do that, it is needed, and then what it demands is as well.
    """
    state, derived = initial_knowledge(problem), problem.domain.rules.derived
    by_itself = {fluent for change in problem.timed for fluent in change.changes}
    makers: dict[Fluent, dict[int, set[Value | None]]] = {}
    """The actions that may write a fluent, each with the values that it may write: None for one that is computed."""
    for number, action in enumerate(actions):
        for fluent, effect, _ in possible_assignments((*action.start_effects, *action.end_effects), state):
            value = effect.value.value if isinstance(effect.value, Constant) and effect.operation == "assign" else None
            makers.setdefault(fluent, {}).setdefault(number, set()).add(value)
    needed: set[int] = set()
    demands = [*conjuncts(problem.goal)]
    while demands:
        demand = demands.pop()
        if evaluate(demand, state) is True or not derived.isdisjoint(names(demand)):
            continue
        match demand:
            case Holds():
                useless: set[Value | None] = {False}
            case Not(Holds()):
                useless = {True}
            case _:
                useless = set()
        mentioned = fluents(demand, state)
        able = {number for fluent in mentioned for number, values in makers.get(fluent, {}).items() if not values <= useless}
        if by_itself.isdisjoint(mentioned) and len(able) == 1 and not able <= needed:
            needed |= able
            action = actions[able.pop()]
            demands += (part for condition in (action.precondition, action.end_condition) for part in conjuncts(condition))
    return frozenset(needed)


class _Elimination:
    """The search for needless steps: one simulation of the plan, and one of the rest for every step that may be needless.

    The mutable state is the plan, the numbers of the steps that were left out, and the work that is left.
    """

    def __init__(self, problem: Problem, plan: Plan, actions: Mapping[PlanStep, GroundAction], work: int) -> None:
        self._problem = problem
        self._first = plan
        self._actions = [actions[step] for step in plan.steps]
        effects = ((*action.start_effects, *action.end_effects) for action in self._actions)
        self._work = [1 + choices_in_effects(both, problem.count) // _CHOICES for both in effects]
        self._happenings = happenings(problem, plan)
        self._needed = indispensable(problem, self._actions)
        self._plan = plan
        self._lost = frozenset[int]()
        self.work = work

    def without_needless(self, until: float) -> Plan:
        """Return the plan without its needless steps, as far as they are found by then.

        Who gets in whose way is not looked at here, so the results have still to be validated.
        """
        simulation = Progression(initial_knowledge(self._problem))
        for position, happening in enumerate(self._happenings):
            for index in (event.call for event in happening.events if event.moment is Moment.START):
                if index in self._lost or index in self._needed:
                    continue
                if self.work <= 0 or time.monotonic() >= until:
                    return self._plan
                self._try_without(index, position, simulation)
            try:
                self._advance(simulation, happening, self._lost)
            except NotApplicable:
                break
        return self._plan

    def _advance(self, simulation: Progression, happening: Happening, lost: Collection[int]) -> None:
        events = [(event, self._actions[event.call]) for event in happening.events if event.call not in lost]
        self.work -= max((self._work[event.call] for event, _ in events), default=1)
        simulation.advance(events, happening.changes)

    def _try_without(self, index: int, position: int, before: Progression) -> None:
        """Leave a step out, and those after it that cannot be carried out without it, unless that is no better plan."""
        lost = self._lost_without(index, position, before)
        if lost is None:
            return
        left = [number for number in range(len(self._first.steps)) if number not in lost]
        while True:
            self.work -= sum(self._work[number] for number in left)
            shorter = replace(self._first, steps=tuple(self._first.steps[number] for number in left))
            try:
                cost = cost_of(self._problem, shorter)
            except InvalidPlan as error:
                # the goal is not reached, or an earlier step cannot go on
                if error.step is None or left[error.step] < index:
                    return
                del left[error.step]
            else:
                if cost is None or self._plan.cost is None or self._problem.sign * (cost - self._plan.cost) <= 0.0:
                    self._plan, self._lost = replace(shorter, cost=cost), frozenset(range(len(self._first.steps))).difference(left)
                return

    def _lost_without(self, index: int, position: int, before: Progression) -> set[int] | None:
        """Return the steps that cannot be carried out when one more is left out; None if the others do not reach the goal."""
        lost = {*self._lost, index}

        def drop(call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> bool:
            if stage != "start" or call in self._needed:
                return refuse(call, stage, condition, state)
            lost.add(call)
            return False

        simulation = Progression(snapshot(before.state), before.running, drop)
        try:
            for happening in self._happenings[position:]:
                self._advance(simulation, happening, lost)
        except NotApplicable:
            return None
        return lost if evaluate(self._problem.goal, simulation.state) is True else None


def cost_of(problem: Problem, plan: Plan) -> float | None:
    """Return the metric's value of a plan, None where only time counts; raise `InvalidPlan` if it does not solve the problem."""
    state = last_state(problem, plan)
    if problem.metric is None or problem.metric.expression == ValueOf(TOTAL_TIME):
        return None
    state.update({TOTAL_TIME: plan.makespan if plan.temporal else float(len(plan.steps))})
    cost = value_of(problem.metric.expression, state)
    return float(cost) if isinstance(cost, int | float) else plan.cost


# --- better rests ---------------------------------------------------------------------------------
# Better rests of plans, looked for while robots carry the plans out.
#
# What begins before the search is over stays as it is. The search continues with the rest as it is: parts of it are replaced by better
# ones, and Kairos looks for other plans from the state after what stays. A rest is better if it saves more expected robot time than the
# exchange of plans costs; with a metric, if it is better by that.


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
    from planner_bridge.ordering.robot_time import ends_of  # here, because only robots at work need it

    lasting, going_on = dict(enumerate(under_way.values())), [calls[number] for number in under_way]

    def ends(steps: tuple[PlanStep, ...]) -> list[float]:
        return ends_of(plan_graph(now, Plan(steps), going_on), rates, lasting)

    def work(some: Iterable[ActionCall]) -> float:
        return sum(rates.expected(call.action) for call in some)

    whole = work(waiting) + max(under_way.values(), default=0.0)
    try:
        times = ends(steps_of(waiting))
        whole = max(times, default=0.0)
        thinks = worth(whole) * AT_WORK if improve is None else min(improve, whole / 4.0)
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
        return f"it costs {its:g} in place of {cost:g}" if later.sign * (its - cost) < 0.0 else ""
    if seconds >= EXCHANGE and is_known:
        return f"it takes {seconds:.0f} s less"
    if min(seconds, work) < 0.0 or max(seconds, work) < EXCHANGE:
        return ""
    return f"its calls take {work:.0f} s less" if is_known else f"it has {counted(round(work), 'call')} less"
