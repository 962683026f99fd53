"""The odds of a plan that is not replaced: a Markov chain over the attempts of its calls, in the order that its machine keeps.

A call makes one attempt and as many more as its budget pays for. An attempt ends in success, in a failure that another attempt may
follow, or in one for good; all attempts of a call are alike, and calls end independently of each other. The goal is reached if every
call succeeds, so its chance is the product of theirs, and exact. Times have no such form where branches meet that have a past in
common: they are drawn from the chains, call by call, and carried along the orderings; only runs that reach the goal count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from itertools import islice
from math import isinf, prod, sqrt
from operator import add
from random import Random
from typing import Final, TypeAlias

from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from pnm.actions.faults import FaultKind, Faults
from pnm.actions.simulated_robots import LAG, SLOWNESS
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import names_written
from pnm.core.logic.expressions import Fluent, is_number
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraph, necessary

DRAWS: Final = 1000
"""Draws of the time of a plan."""
_INTERVAL_DRAWS: Final = 400
"""Draws of chances that were estimated."""
_Z: Final = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""


class Leads(Enum):
    """What follows the end of an attempt."""

    DONE = "done"
    AGAIN = "again"
    """Another attempt, if the budget pays for one."""
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Ending:
    """One way in which an attempt may end.

    Args:
        seconds: how long the attempt takes then, with weights.
    """

    leads: Leads
    chance: float
    seconds: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Attempt:
    """All ways in which an attempt may end.

    Args:
        rests: what they rest on, in words.
        total: the number of attempts that the chances were estimated from; 0 if they are known.
    """

    endings: tuple[Ending, ...]
    rests: str
    total: float = 0.0

    def chance(self, leads: Leads) -> float:
        """Return the chance of what follows."""
        return sum(ending.chance for ending in self.endings if ending.leads is leads)

    @property
    def estimate(self) -> tuple[str, float, tuple[tuple[Leads, float], ...]]:
        """All but its seconds; calls for which this is the same rest on the same numbers."""
        return self.rests, self.total, tuple([(ending.leads, ending.chance) for ending in self.endings])

    def draws(self, leads: Leads, random: Random, count: int) -> list[float]:
        """Draw the seconds of attempts that end so."""
        pairs = [(time, ending.chance * weight) for ending in self.endings if ending.leads is leads for time, weight in ending.seconds]
        times, weights = zip(*pairs, strict=True)
        return random.choices(times, weights, k=count)


_CERTAIN: Final = Attempt((Ending(Leads.DONE, 1.0, ((0.0, 1.0),)),), "nothing: no server is needed")
Attempts: TypeAlias = Callable[[GroundAction], Attempt | None]
"""What is known of the attempts of an action; None if they are not alike, or not independent of others."""


@dataclass(frozen=True, slots=True)
class CallOdds:
    """A call, what is known of each of its attempts, and how many more the budget pays for."""

    call: ActionCall
    attempt: Attempt
    retries: int

    def chance(self, more: int = 0) -> float:
        """Return the chance of its success, with so many retries more than it has."""
        return _success(self.attempt.chance(Leads.DONE), self.attempt.chance(Leads.AGAIN), self.retries + more)

    def draws(self, random: Random, count: int) -> list[float]:
        """Draw the seconds of the call, given that it succeeds."""
        lasted, again = self.attempt.draws(Leads.DONE, random, count), self.attempt.chance(Leads.AGAIN)
        tries = range(self.retries + 1)
        failed = random.choices(tries, [again**number for number in tries], k=count) if again else ()
        if not any(failed):
            return lasted
        wasted = iter(self.attempt.draws(Leads.AGAIN, random, sum(failed)))
        return [seconds + sum(islice(wasted, number)) if number else seconds for seconds, number in zip(lasted, failed, strict=True)]


def _success(done: float, again: float, retries: int) -> float:
    """Return the chance of success before the first end that no attempt may follow: all attempts before it have failed."""
    return min(1.0, done * sum(again**tries for tries in range(retries + 1)))


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
    """

    chance: float
    interval: tuple[float, float]
    times: tuple[float, ...] = ()
    numbers: Mapping[Fluent, tuple[float, ...]] = field(default_factory=dict)
    runs: int = 0

    def time(self, share: float) -> float:
        """Return the seconds within which this share of the runs that reach the goal is over."""
        return _quantile(self.times, share)

    @property
    def ends(self) -> Mapping[Fluent, tuple[float, float, float]]:
        """The median of each number at the end, and what it lies between in 90 % of the runs."""
        return {one: (_quantile(every, 0.5), _quantile(every, 0.05), _quantile(every, 0.95)) for one, every in self.numbers.items()}

    @staticmethod
    def estimated(reached: int, runs: int, times: Iterable[float], numbers: Mapping[Fluent, Iterable[float]]) -> Odds:
        """Return the odds after runs of which some reached the goal, with the interval of Wilson (1927)."""
        share, spread = reached / runs, _Z**2 / runs
        middle, half = (share + spread / 2) / (1 + spread), sqrt(share * (1 - share) * spread + spread**2 / 4) / (1 + spread)
        ends = {fluent: tuple(sorted(values)) for fluent, values in numbers.items()}
        return Odds(share, (max(0.0, middle - half), min(1.0, middle + half)), tuple(sorted(times)), ends, runs)


def percent(chance: float) -> str:
    """Return a chance in words, with as many places as tell it from 0 and from 1."""
    written = (f"{100.0 * chance:.{places}f}" for places in range(1, 5))
    return f"{next((text for text in written if 0.0 < float(text) < 100.0), f'{100.0 * chance:g}')} %"


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
        found.append(CallOdds(step, attempt, bindings.of(step.action.name).retries if step.retries is None else step.retries))
    return tuple(found)


def exact(graph: PlanGraph, calls: tuple[CallOdds, ...], knowledge: KnowledgeBase) -> Odds | None:
    """Return the odds of a plan whose calls are independent; see the beginning of this module.

    None if the plan does not lead from this knowledge to its goal in the order of its calls alone, as where facts change by themselves.
    """
    walk = Progression(snapshot(knowledge))
    try:
        for event in graph.order:
            walk.advance([(event, calls[event.call].call.action)])
    except NotApplicable:
        return None
    if evaluate(graph.goal, walk.state) is not True:
        return None
    chance = prod(call.chance() for call in calls)
    after = sorted((fluent, value) for fluent, value in walk.state.facts().items() if is_number(value) and value != knowledge.value(fluent))
    numbers = {fluent: (float(value),) for fluent, value in after}
    times = tuple(sorted(_times(graph, calls))) if chance else ()
    return Odds(chance, _interval(calls) or (chance, chance), times, numbers if chance else {})


def _interval(calls: tuple[CallOdds, ...]) -> tuple[float, float] | None:
    """Return what the chance lies between with 95 % if chances of attempts are estimates; None if none is.

    They are drawn from their Dirichlet distributions, once for all calls that rest on the same attempts.
    """
    alike, random = Counter((call.attempt.estimate, call.retries) for call in calls), Random(0)
    if not any(total for (_, total, _), _ in alike):
        return None

    def drawn() -> float:
        ways: dict[object, dict[Leads, float]] = {}
        for estimate, _ in alike:
            if estimate not in ways:
                _, total, endings = estimate
                shares = [(leads, random.gammavariate(total * chance, 1.0) if total and chance else chance) for leads, chance in endings]
                every = sum(share for _, share in shares)
                ways[estimate] = {kind: sum(share for leads, share in shares if leads is kind) / every for kind in Leads}
        both = ((ways[estimate], retries, count) for (estimate, retries), count in alike.items())
        return prod(_success(way[Leads.DONE], way[Leads.AGAIN], retries) ** count for way, retries, count in both)

    chances = tuple(sorted(drawn() for _ in range(_INTERVAL_DRAWS)))
    return _quantile(chances, 0.025), _quantile(chances, 0.975)


def _times(graph: PlanGraph, calls: tuple[CallOdds, ...]) -> list[float]:
    """Draw the time of the plan, with the same random numbers every time."""
    random = Random(0)
    waits: dict[PlanEvent, list[tuple[PlanEvent, float]]] = {}
    for ordering in necessary(graph.flow):
        waits.setdefault(ordering.after, []).append((ordering.before, ordering.delay))
    times: dict[PlanEvent, list[float]] = {}
    for event in graph.order:
        odds = calls[event.call]
        if event.moment is Moment.START:
            own = [odds.call.earliest] * DRAWS
        else:
            own = list(map(add, times[PlanEvent(event.call, Moment.START)], odds.draws(random, DRAWS)))
        before = [[time + delay for time in times[one]] if delay else times[one] for one, delay in waits.get(event, ())]
        times[event] = list(map(max, own, *before)) if before else own
    over = [times[event] for event in times if event.moment is Moment.END]
    return list(map(max, [graph.due] * DRAWS, *over))


# --- what attempts rest on -----------------------------------------------------------------------


def declared(faults: Faults, bindings: Bindings, untimed: float) -> Attempts:
    """Return what a simulated world declares of the attempts of its robots.

    Args:
        untimed: seconds that an action without a duration takes there.
    """

    def attempts(action: GroundAction) -> Attempt | None:
        lasts, limit = untimed if action.duration is None else action.duration, bindings.timeout(action)
        left, endings = 1.0, list[Ending]()
        is_seen = bool(names_written(action.end_effects) - bindings.assumed)
        for fault in (fault for fault in faults.faults if fault.concerns(action)):
            if fault.after or fault.times is not None or fault.ignores_cancel:
                return None
            leads, seconds = Leads.AGAIN, lasts
            match fault.kind:
                case FaultKind.ABORT:
                    seconds = lasts / 2
                case FaultKind.REJECT:
                    seconds = 0.0
                case FaultKind.NO_EFFECT:
                    leads, seconds = (Leads.AGAIN, lasts + LAG) if is_seen else (Leads.DONE, lasts)
                case FaultKind.HANG:
                    seconds = limit
                case FaultKind.SLOW:
                    leads, seconds = (Leads.DONE, lasts * SLOWNESS) if lasts * SLOWNESS <= limit else (Leads.AGAIN, limit)
                case FaultKind.LOSE_SERVER:
                    return None
            endings.append(Ending(leads, left * fault.chance, ((seconds, 1.0),)))
            left *= 1.0 - fault.chance
        return Attempt((Ending(Leads.DONE, left, ((lasts, 1.0),)), *endings), "declared")

    return (lambda _: None) if faults.changes else attempts
