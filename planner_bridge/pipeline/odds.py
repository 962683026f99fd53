"""The odds of a plan that is not replaced: a Markov chain over the attempts of its calls, in the order that its machine keeps.

A call makes one attempt and as many more as its budget pays for. An attempt ends in success, in a failure that another attempt may
follow, or in one for good; all attempts of a call are alike, and calls end independently of each other. The goal is reached if every
call succeeds, so its chance is the product of theirs, and exact. Chances that were learned are not known for sure, and are the same for
all calls that rest on them: the chance of the goal is the mean over what they may be, which is more than the product of their means.
Times have no such form where branches meet that have a past in
common: they are drawn from the chains, call by call, and carried along the orderings; only runs that reach the goal count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from math import inf, isinf, prod
from operator import add
from random import Random
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from planner_bridge.model.rates import NO_RATES, Basis, Call, Chance, End, Rates, as_may_be, wilson
from planner_bridge.ordering.robot_time import ExpectedTimes
from pnm.actions.faults import NO_FAULTS, FaultKind, Faults
from pnm.actions.simulated_robots import LAG, SLOWNESS
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import names_written
from pnm.core.logic.expressions import Fluent, Value, fluent_text, is_number
from pnm.core.machine.bindings import Bindings, WhenLost, is_open
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraph, necessary
from pnm.tasks import TaskOdds, percent

DRAWS: Final = 1000
"""Draws of the time of a plan."""
WEAKEST: Final = 3
"""Calls that are named as the weakest, at most."""
INTERVAL_DRAWS: Final = 400
"""Draws of chances that were estimated."""
_MOST_FAILED: Final = 2000
"""Attempts that fail of calls that rest on the same chances, at most: to reach the goal after more of them is all but impossible."""


class Leads(Enum):
    """What follows the end of an attempt."""

    DONE = "done"
    AGAIN = "again"
    """Another attempt, if the budget pays for one."""
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class AttemptEnd:
    """One way in which an attempt may end.

    Args:
        seconds: how long the attempt takes then, with weights.
    """

    leads: Leads
    chance: float
    seconds: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class AttemptOdds:
    """All ways in which an attempt may end.

    Args:
        rests: what they rest on, in words.
        total: the number of attempts that the chances were estimated from; 0 if they are known.
        outcomes: the chances of those of its action, if it has several.
    """

    endings: tuple[AttemptEnd, ...]
    rests: str
    total: float = 0.0
    outcomes: Chance | None = None

    def chance(self, leads: Leads) -> float:
        """Return the chance of what follows."""
        return sum(ending.chance for ending in self.endings if ending.leads is leads)

    @property
    def estimate(self) -> tuple[str, float, tuple[tuple[Leads, float], ...]]:
        """All but its seconds; calls for which this is the same rest on the same numbers."""
        return self.rests, self.total, tuple([(ending.leads, ending.chance) for ending in self.endings])

    @property
    def expected(self) -> float:
        """The seconds that a call takes on average until it has succeeded; infinite if it never does."""
        lasts = sum(
            end.chance * sum(t * weight for t, weight in end.seconds) / sum(weight for _, weight in end.seconds) for end in self.endings
        )
        return lasts / done if (done := self.chance(Leads.DONE)) else inf

    def draws(self, leads: Leads, random: Random, count: int) -> list[float]:
        """Draw the seconds of attempts that end so."""
        pairs = [(time, ending.chance * weight) for ending in self.endings if ending.leads is leads for time, weight in ending.seconds]
        if len(pairs) == 1:
            return [pairs[0][0]] * count
        times, weights = zip(*pairs, strict=True)
        return random.choices(times, weights, k=count)


_CERTAIN: Final = AttemptOdds((AttemptEnd(Leads.DONE, 1.0, ((0.0, 1.0),)),), "nothing: no server is needed")
_OUTCOMES: Final = {Basis.DECLARED: "declared outcomes", Basis.ASSUMED: "outcomes taken as equally likely"}
CallKind: TypeAlias = tuple[tuple[str, float, tuple[tuple[Leads, float], ...]], int]
"""What calls with the same chance of success have in common."""
Attempts: TypeAlias = Callable[[GroundAction], AttemptOdds | None]
"""What is known of the attempts of an action; None if they are not alike, or not independent of others."""


@dataclass(frozen=True, slots=True)
class CallOdds:
    """A call, what is known of each of its attempts, and how many more the budget pays for.

    Args:
        resources: that it has for itself while it is under way.
        began: seconds from now, so not above 0; None before it begins.
        ended: likewise, with success; None before.
        at_work: seconds for which a server has been at work on it.
    """

    call: ActionCall
    attempt: AttemptOdds
    retries: int
    resources: tuple[str, ...] = ()
    began: float | None = None
    ended: float | None = None
    at_work: float = 0.0

    @property
    def kind(self) -> CallKind:
        """What its chance rests on, and its retries."""
        return self.attempt.estimate, self.retries

    def chance(self, more: int = 0) -> float:
        """Return the chance of its success, with so many retries more than it has."""
        if self.ended is not None:
            return 1.0
        return _success(self.attempt.chance(Leads.DONE), self.attempt.chance(Leads.AGAIN), self.retries + more)

    def draws(self, random: Random, count: int) -> list[float]:
        """Draw the seconds of the call, given that it succeeds: in as many draws after each number of failures as is due to it.

        Of one that is at work those that are left: if it has taken longer than ever, as many again as it is late.
        """
        lasted, again = self.attempt.draws(Leads.DONE, random, count), self.attempt.chance(Leads.AGAIN)
        if again and self.retries:
            before = [again**tries for tries in range(self.retries + 1)]
            late = [int(count * sum(before[tries:]) / sum(before) + random.random()) for tries in range(1, self.retries + 1)]
            places, wasted = random.sample(range(count), late[0]), iter(self.attempt.draws(Leads.AGAIN, random, sum(late)))
            for number in late:  # of draws in which so many attempts fail, or more
                for place in places[:number]:
                    lasted[place] += next(wasted)
        if not self.at_work:
            return lasted
        left = [time - self.at_work for time in lasted if time > self.at_work] or [self.at_work - max(lasted)]
        return [left[number % len(left)] for number in range(count)]


def _success(done: float, again: float, retries: int) -> float:
    """Return the chance of success before the first end that no attempt may follow: all attempts before it have failed."""
    return min(1.0, done * sum(again**tries for tries in range(retries + 1)))


def chance_of(calls: Iterable[CallOdds], more: Mapping[str, int] = MappingProxyType({})) -> float:
    """Return the chance that all calls succeed, with so many retries more than they have, by action."""
    alike: dict[tuple[str, float, tuple[tuple[Leads, float], ...]], list[int]] = {}
    for call in calls:
        if call.ended is None:
            alike.setdefault(call.attempt.estimate, []).append(call.retries + more.get(call.call.action.name, 0))
    return prod(_together(*estimate, retries) for estimate, retries in alike.items())


def _together(rests: str, total: float, endings: tuple[tuple[Leads, float], ...], retries: Sequence[int]) -> float:
    """Return the chance that calls with so many retries succeed whose attempts end alike: the mean over a Dirichlet distribution.

    If k calls succeed after j attempts in all that do not, the chance of that is the mean of done^k again^j, for which there is a formula,
    times the number of ways. Each way has the weight here that it has if the chances are their means.

    Args:
        rests: what the chances rest on; assumed ones are taken as they are.
        total: the attempts that they were estimated from; 0 if they are known.
    """
    done, again = (sum(chance for leads, chance in endings if leads is kind) for kind in (Leads.DONE, Leads.AGAIN))
    means = prod(_success(done, again, number) for number in retries)
    if not total or not means or rests == Basis.ASSUMED.value:
        return means
    ways, k = [1.0], len(retries)
    for number in retries if again else ():
        scale, beyond, before, ways = done / _success(done, again, number), again ** (number + 1), (*ways, *[0.0] * number), list[float]()
        way = 0.0
        for j, other in enumerate(before[:_MOST_FAILED]):
            way = again * way + scale * (other - (beyond * before[j - number - 1] if j > number else 0.0))
            ways.append(way)
    ratio = prod((total + i / done) / (total + i) for i in range(k))
    found = ratio * ways[0]
    for j, (last, way) in enumerate(pairwise(ways)):
        ratio *= (total + j / again) / (total + k + j)
        found += ratio * way
        if way < last and ratio * way < 1e-17 * found:
            break
    return min(1.0, means * found)


def _quantile(values: tuple[float, ...], share: float) -> float:
    return values[min(len(values) - 1, int(share * len(values)))]


@dataclass(frozen=True)
class Odds:
    """The odds of a goal.

    Args:
        chance: of reaching it.
        interval: that has the chance with 95 %; both ends are the chance itself if nothing was estimated.
        times: seconds of runs that reach it, sorted.
        numbers: the values that numeric fluents have at the end of such runs, sorted; only of those that change.
        runs: of the machine from which all this was estimated; 0 if it was computed.
        actions: that runs which reach it carry out on average; 0 if they are those of a plan.
    """

    chance: float
    interval: tuple[float, float]
    times: tuple[float, ...] = ()
    numbers: Mapping[Fluent, tuple[float, ...]] = field(default_factory=dict)
    runs: int = 0
    actions: float = 0.0

    def time(self, share: float) -> float:
        """Return the seconds within which this share of the runs that reach the goal is over."""
        return _quantile(self.times, share)

    @property
    def ends(self) -> Mapping[Fluent, tuple[float, float, float]]:
        """The median of each number at the end, and what it lies between in 90 % of the runs."""
        return {one: (_quantile(every, 0.5), _quantile(every, 0.05), _quantile(every, 0.95)) for one, every in self.numbers.items()}

    def as_json(self) -> dict[str, Any]:
        """Return them as `pnm odds --json` prints them."""
        times = {"median": self.time(0.5), "ninety_percent": self.time(0.9)} if self.times else None
        numbers = {fluent_text(fluent): dict(zip(("median", "low", "high"), ends, strict=True)) for fluent, ends in self.ends.items()}
        return {"chance": self.chance, "interval": [*self.interval], "runs": self.runs, "seconds": times, "numbers": numbers} | (
            {"actions": self.actions} if self.actions else {}
        )

    @staticmethod
    def estimated(
        counted: int, times: Iterable[float], numbers: Mapping[Fluent, Iterable[float]], runs: int, alone: Odds | None = None
    ) -> Odds:
        """Return the odds after runs, with their interval.

        Args:
            counted: all runs; those alone that needed a new plan, if the odds are known if there is none.
            times: seconds of those that reached the goal, of the runs that are counted.
            alone: the odds if there is no new plan. The share of the others is estimated by Jeffreys' prior: there may be few, or none.
        """
        lasts, sure = sorted(times), alone.chance if alone else 0.0
        reached, least = len(lasts), 0.5 if alone else 0.0
        low, high = wilson(reached / counted, counted) if counted else (0.0, 1.0)
        others = (1.0 - sure) * (reached + least) / (counted + 2 * least)
        if alone and alone.times and lasts:
            several = round(len(alone.times) * others / sure)
            lasts = sorted((*alone.times, *(lasts[int(reached * (number + 0.5) / several)] for number in range(several))))
        ends = {fluent: tuple(sorted(values)) for fluent, values in numbers.items()}
        between = (sure + (1.0 - sure) * low, sure + (1.0 - sure) * high)
        return Odds(sure + others, between, tuple(lasts or (alone.times if alone else ())), ends, runs)


def odds_of_calls(graph: PlanGraph, bindings: Bindings, attempts: Attempts) -> tuple[CallOdds, ...] | None:
    """Return the odds of the calls of a plan; None if they depend on each other, on conditions, or on the time."""
    found: list[CallOdds] = []
    for step in graph.steps:
        if not isinstance(step, ActionCall) or not (isinf(step.latest_start) and isinf(step.deadline)):
            return None
        if any(recovery.causes - {Cause.CANCELED} for recovery in step.recoveries):  # nobody cancels here
            return None
        attempt = attempts(step.action) if step.action.operation is None else _CERTAIN
        if attempt is None:
            return None
        retries = bindings.of(step.action.name).retries if step.retries is None else step.retries
        resources = tuple(name for name in bindings.resources(step.action) if not is_open(name))
        found.append(CallOdds(step, attempt, retries, resources))
    return tuple(found)


def exact(graph: PlanGraph, calls: tuple[CallOdds, ...], knowledge: KnowledgeBase) -> Odds | None:
    """Return the odds of a plan whose calls are independent; see the beginning of this module.

    None if the plan does not lead from this knowledge to its goal in the order of its calls alone, as where facts change by themselves,
    or where actions may turn out in several ways.
    """
    if any(call.call.action.outcomes for call in calls):
        return None
    walk = Progression(snapshot(knowledge))
    try:
        for event in graph.order:
            walk.advance([(event, calls[event.call].call.action)])
    except NotApplicable:
        return None
    if evaluate(graph.goal, walk.state) is not True:
        return None
    chance = chance_of(calls)
    after = sorted((fluent, value) for fluent, value in walk.state.facts().items() if is_number(value) and value != knowledge.value(fluent))
    numbers = {fluent: (float(value),) for fluent, value in after}
    lasts = tuple(sorted(times(graph, calls))) if chance else ()
    return Odds(chance, interval(calls) or (chance, chance), lasts, numbers if chance else {})


def interval(
    calls: Iterable[CallOdds], chance: Callable[[Mapping[CallKind, float], int], float] | None = None, count: int = INTERVAL_DRAWS
) -> tuple[float, float] | None:
    """Return what the chance lies between with 95 % if chances of attempts are estimates; None if none is.

    The chance of the goal is the product of those of the calls, unless a function is given, as for `in_worlds`.
    """
    alike = Counter(call.kind for call in calls)
    if not any(total for (_, total, _), _ in alike):
        return None
    product = chance or (lambda success, _: prod(success[kind] ** number for kind, number in alike.items()))
    chances = tuple(sorted(in_worlds(alike, product, count, assumed=True)))
    return _quantile(chances, 0.025), _quantile(chances, 0.975)


def in_worlds(
    kinds: Iterable[CallKind], chance: Callable[[Mapping[CallKind, float], int], float], count: int, *, assumed: bool
) -> Iterator[float]:
    """Yield the chance of the goal in so many worlds: what was estimated is drawn in each, once for all calls that rest on it.

    Args:
        chance: of the goal, given those of calls, and the number of the world.
        assumed: whether chances that are only assumed are drawn, too.
    """
    random, ways = Random(0), dict[object, list[dict[Leads, float]]]()
    for estimate, _ in (kinds := (*kinds,)):
        if estimate not in ways:
            rests, total, endings = estimate
            drawn = as_may_be([share for _, share in endings], total if assumed or rests != Basis.ASSUMED.value else 0.0, random, count)
            ways[estimate] = [
                {kind: sum(share for (leads, _), share in zip(endings, shares, strict=True) if leads is kind) for kind in Leads}
                for shares in drawn
            ]
    for world in range(count):
        shares = {estimate: drawn[world] for estimate, drawn in ways.items()}
        yield chance({kind: _success(shares[kind[0]][Leads.DONE], shares[kind[0]][Leads.AGAIN], kind[1]) for kind in kinds}, world)


def times(graph: PlanGraph, calls: tuple[CallOdds, ...], count: int = DRAWS, began: float = 0.0) -> list[float]:
    """Draw the time until the plan is carried out, with the same random numbers every time; nothing if that can never be.

    Calls that need the same resource take turns, in the order of the plan.

    Args:
        count: of draws.
        began: seconds from now, so not above 0.
    """
    random, last = Random(0), dict[str, PlanEvent]()
    waits: dict[PlanEvent, list[tuple[PlanEvent, float]]] = {event: [] for event in graph.order}
    for ordering in necessary(graph.flow):
        waits[ordering.after].append((ordering.before, ordering.delay))
    for event in (event for event in graph.order if event.moment is Moment.START):
        waits[event] += [(last[name], 0.0) for name in calls[event.call].resources if name in last]
        last |= dict.fromkeys(calls[event.call].resources, PlanEvent(event.call, Moment.END))
    sorter = TopologicalSorter({event: [one for one, _ in before] for event, before in waits.items()})
    for call in range(len(calls)):
        sorter.add(PlanEvent(call, Moment.END), PlanEvent(call, Moment.START))
    at: dict[PlanEvent, list[float]] = {}
    try:
        order = tuple(sorter.static_order())
    except CycleError:  # calls that have to overlap need the same resource
        return []
    for event in order:
        before = [[time + delay for time in at[one]] if delay else at[one] for one, delay in waits[event]]
        odds, is_end = calls[event.call], event.moment is Moment.END
        if (known := odds.ended if is_end else odds.began) is not None:
            at[event] = [known] * count
            continue
        if is_end:
            since = [0.0] * count if odds.began is not None else at[PlanEvent(event.call, Moment.START)]
            before.append(list(map(add, since, odds.draws(random, count))))
        else:
            before.append([max(0.0, odds.call.earliest + began)] * count)
        at[event] = list(map(max, *before)) if len(before) > 1 else before[0]
    due = [max(0.0, graph.due + began)] * count
    return list(map(max, due, due, *(at[event] for event in at if event.moment is Moment.END)))


# --- what attempts rest on -----------------------------------------------------------------------


def declared(faults: Faults, bindings: Bindings, untimed: float) -> Attempts:
    """Return what a simulated world declares of the attempts of its robots.

    Args:
        untimed: seconds that an action without a duration takes there.
    """

    def attempts(action: GroundAction) -> AttemptOdds | None:
        lasts, limit = untimed if action.duration is None else action.duration, bindings.timeout(action)
        left, endings = 1.0, list[AttemptEnd]()
        is_seen = bool(names_written(action.end_effects) - bindings.assumed)
        for fault in (fault for fault in faults.faults if fault.concerns(action)):
            if fault.after or fault.times is not None or fault.ignores_cancel or fault.outcome:
                return None
            leads, seconds = Leads.AGAIN, lasts
            match fault.kind:
                case FaultKind.ABORT:
                    seconds = lasts / 2
                case FaultKind.REJECT:
                    seconds = 0.0
                case FaultKind.NO_EFFECT if not action.outcomes:
                    leads, seconds = (Leads.AGAIN, lasts + LAG) if is_seen else (Leads.DONE, lasts)
                case FaultKind.HANG:
                    seconds = limit
                case FaultKind.SLOW:
                    leads, seconds = (Leads.DONE, lasts * SLOWNESS) if lasts * SLOWNESS <= limit else (Leads.AGAIN, limit)
                case FaultKind.LOSE_SERVER | FaultKind.NO_EFFECT:  # what changes nothing may look like an outcome
                    return None
            endings.append(AttemptEnd(leads, left * fault.chance, ((seconds, 1.0),)))
            left *= 1.0 - fault.chance
        outcomes = NO_RATES.outcomes(Call("", action.name), action.outcomes) if action.outcomes else None
        return AttemptOdds((AttemptEnd(Leads.DONE, left, ((lasts, 1.0),)), *endings), "declared", outcomes=outcomes)

    return (lambda _: None) if faults.changes else attempts


def learned(expected: ExpectedTimes) -> Attempts:
    """Return what is learned of the attempts of robots; what is not known of an action is assumed."""
    rates, bindings = expected.learned, expected.bindings

    def attempts(action: GroundAction) -> AttemptOdds:
        call, binding, endings = Call.of(action, bindings), bindings.of(action.name), list[AttemptEnd]()
        chance, is_asked = rates.chance(call), binding.when_lost is WhenLost.ABORT
        lasts, told = expected.declared(action), expected.told(action)
        for end in chance.weights:
            leads = Leads.DONE if end is End.SUCCEEDED else Leads.AGAIN
            if end is End.ABORTED_FOR_GOOD or (end is End.LOST and is_asked):
                leads = Leads.FAILED
            seconds = told if told and leads is Leads.DONE else rates.seconds(call, lasts, succeeded=leads is Leads.DONE)
            endings.append(AttemptEnd(leads, chance.of(end), seconds.buckets))
        outcomes = rates.outcomes(call, action.outcomes) if action.outcomes else None
        return AttemptOdds(tuple(endings), str(chance.rests), sum(chance.weights.values()), outcomes)

    return attempts


@dataclass(frozen=True)
class KnownRobots:
    """What is known of the attempts of robots: what simulated ones declare, if there is that; else what is learned of real ones."""

    rates: Rates = NO_RATES
    faults: Faults = NO_FAULTS

    def __bool__(self) -> bool:
        return self.faults != NO_FAULTS or self.rates != NO_RATES

    def attempts(self, bindings: Bindings, world: Mapping[Fluent, Value], *, is_timed: bool) -> Attempts:
        """Return the odds of attempts; what is not known of an action is assumed. Where nothing is timed, an action takes a second.

        Args:
            world: has the functions that bindings name for seconds.
        """
        if self.faults != NO_FAULTS:
            return declared(self.faults, bindings, 0.0 if is_timed else 1.0)
        return learned(ExpectedTimes(bindings, self.rates, world))


NOTHING_KNOWN: Final = KnownRobots()


# --- all that is known of a goal -----------------------------------------------------------------


@dataclass(frozen=True)
class GoalOdds:
    """All that is known of the odds of a goal.

    Args:
        alone: if nothing is planned anew, exactly; None if calls depend on each other.
        rolled: by roll-outs of the machine; None if there were none.
        calls: of the plan, if they do not depend on each other.
    """

    alone: Odds | None
    rolled: Odds | None
    calls: tuple[CallOdds, ...] = ()

    @property
    def best(self) -> Odds | None:
        """The odds that take most into account; None if there was no time for any."""
        return self.rolled or self.alone

    @property
    def weakest(self) -> list[CallOdds]:
        """The calls that may fail, the weakest first."""
        return sorted((call for call in self.calls if call.chance() < 1.0), key=CallOdds.chance)

    @property
    def more_retries(self) -> dict[str, tuple[int, list[float]]]:
        """The actions of the weakest calls with their retries, and the chance if nothing is planned anew with one or two more."""
        gains: dict[str, tuple[int, list[float]]] = {}
        is_product = self.alone and self.alone.chance and not self.alone.actions
        for action in dict.fromkeys(call.call.action.name for call in self.weakest[:WEAKEST]) if is_product else ():
            retries = max(call.retries for call in self.calls if call.call.action.name == action)
            more = [chance_of(self.calls, {action: extra}) for extra in (1, 2)]
            gains[action] = retries, more
        return gains

    @property
    def rests(self) -> dict[str, list[str]]:
        """For everything that chances rest on, the actions whose chances do."""
        found: dict[str, dict[str, None]] = {}
        for call in self.calls:
            found.setdefault(call.attempt.rests, {})[call.call.action.name] = None
            if outcomes := call.attempt.outcomes:
                rests = _OUTCOMES.get(outcomes.rests.basis, f"outcomes {outcomes.rests}")
                found.setdefault(rests, {})[call.call.action.name] = None
        return {rests: [*actions] for rests, actions in found.items()}

    @property
    def told(self) -> TaskOdds | None:
        """Them as tasks have them; None if there was no time for any."""
        if (best := self.best) is None:
            return None
        median, most = (best.time(share) if best.times else 0.0 for share in (0.5, 0.9))
        return TaskOdds(best.chance, median, most, "; ".join(f"{rests}: {', '.join(actions)}" for rests, actions in self.rests.items()))

    def refusal(self, least: float) -> str:
        """Return why a plan does not begin that needs this chance at least; empty if it may."""
        if self.best is not None and self.best.chance >= least:
            return ""
        return f"its odds are {self}; expected {percent(least)} at least"

    def __str__(self) -> str:
        if (told := self.told) is None:
            return "not known"
        return f"{told}{'' if self.rolled or told.chance == 1.0 else ', if nothing is planned anew'}"

    def lines(self) -> Iterator[str]:
        """Yield them for people."""
        head = "odds     "
        if self.alone:
            low, high = self.alone.interval
            between = f", {percent(low)} to {percent(high)} by what chances rest on" if low < high else ""
            yield f"{head}{percent(self.alone.chance)} if nothing is planned anew{between}"
            head = " " * len(head)
        if self.rolled:
            low, high = self.rolled.interval
            how = f"{percent(low)} to {percent(high)} by {self.rolled.runs} roll-outs"
            yield f"{head}{percent(self.rolled.chance)}{' with new plans' if self.alone else ''}, {how}"
        if (best := self.best) is None:
            yield f"{head}not known: there was no time for a roll-out; expected more --seconds"
            return
        if best.times:
            yield f"time     {best.time(0.5):.1f} s in half of the runs that reach the goal, {best.time(0.9):.1f} s at most in 90 % of them"
        if self.alone and self.alone.actions:
            yield f"actions  {self.alone.actions:.1f} on average in runs that reach the goal, if nothing is planned anew"
        for fluent, (middle, low, high) in best.ends.items():
            between = f", {low:g} to {high:g} in 90 % of the runs" if low < high else ""
            yield f"number   {fluent_text(fluent)} is {middle:g} at the end{between}"
        for rests, actions in self.rests.items():
            yield f"chances  {rests}: {', '.join(actions)}"
        for call in self.weakest[:WEAKEST]:
            tries = f"{call.retries + 1} attempts" if call.retries else "1 attempt"
            yield f"weakest  {percent(call.chance())} {call.call.action}: {tries} of {percent(call.attempt.chance(Leads.DONE))}"
        for action, (retries, chances) in self.more_retries.items():
            gains = ", ".join(f"{percent(chance)} with {retries + more}" for more, chance in enumerate(chances, 1))
            yield f"retries  {action} has {retries}: {gains}, if nothing is planned anew"

    def as_json(self) -> dict[str, Any]:
        """Return them as `pnm odds --json` prints them."""
        calls = [
            {
                "call": str(call.call.action),
                "chance": call.chance(),
                "attempts": call.retries + 1,
                "chance_of_attempt": call.attempt.chance(Leads.DONE),
                "rests_on": call.attempt.rests,
            }
            for call in self.weakest
        ]
        retries = [{"action": action, "retries": has, "chances": chances} for action, (has, chances) in self.more_retries.items()]
        alone, rolled = (odds.as_json() if odds else None for odds in (self.alone, self.rolled))
        best = self.best.chance if self.best else None
        return {"chance": best, "alone": alone, "with_new_plans": rolled, "rests_on": self.rests, "weakest": calls, "retries": retries}
