"""The best chance of the goal, and then the least expected cost, among the actions of many states: value iteration.

The states are those of an envelope: all that can be reached if they are few, else those on the way of plans and what may go wrong there.
What lies outside counts as lost, unless entries of the policy are known for it.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import product
from math import inf
from typing import Final, NamedTuple

from planner_bridge.planning.policies.dead_ends import DeadStates
from planner_bridge.planning.policies.encoding import WAYS, OutOfTime
from planner_bridge.planning.policies.search import SAME, BestWays, Search
from planner_bridge.planning.policies.task import LEAST_CHANCE, PartialState, PolicyAction

MOST_STATES: Final = 20_000
"""States of an envelope at most."""
_EXACT: Final = 1e-7
_NONE: Final[Mapping[PolicyAction, Sequence[PartialState]]] = {}
_NOTHING: Final[Mapping[int, float]] = {}
_CLOSE: Final = 1e-4
_FEW: Final = 2_000
"""States that are looked into in any case."""
_SOME: Final = 5_000
"""States in which fewer actions are looked for, at most."""
_SHARE: Final = 0.3
"""Part of the time for the states that are the likeliest to matter, before all are looked into."""
_STEPS: Final = 300
"""Actions for which chances are followed from the initial state."""
_HARDLY: Final = 0.003
"""A chance of a state that hardly counts."""
_IN_VAIN: Final = 200
"""States beside those of a policy that are looked at together, and nothing costs less, before that is the end."""
_AT_ONCE: Final = 20
"""States that are planned for before what is best is worked out anew, at most."""


class KnownEnd(NamedTuple):
    """What is known of a state that is not looked into."""

    risk: float
    """Of not reaching the goal."""
    expected: float
    """The cost that is expected from there on."""


class ActionWay(NamedTuple):
    """An action in a state, and the states that it may lead to, with their chances."""

    action: PolicyAction
    after: tuple[tuple[int, float], ...]


class Envelope:
    """States with all their ways: mutable state.

    Args:
        end: says what is known of a state, None if it has to be looked into.
        is_lost: says whether a state that is to be looked into turns out to be a dead end.
    """

    def __init__(self, search: Search, end: Callable[[int], KnownEnd | None], is_lost: Callable[[int], bool] = lambda state: False) -> None:
        self._task, self._end, self._is_lost, self._is_over = search.task, end, is_lost, search.is_over
        self.ways: dict[int, list[ActionWay]] = {}
        self.ends: dict[int, KnownEnd] = {}
        self.open: dict[int, None] = {}
        """States that are not looked into yet."""
        self._before: dict[int, dict[int, list[int]]] = defaultdict(dict)
        """For each state, the states that lead there, each with the numbers of its ways that do."""

    def is_dead_end(self, state: int) -> bool:
        """Return whether a state that matters is a dead end, and note it."""
        if self._is_lost(state):
            self.open.pop(state, None)
            self.ends[state] = KnownEnd(1.0, 0.0)
        return state in self.ends

    def expand(self, state: int) -> list[int]:
        """Look into a state; return the states that its actions may lead to, and that nothing is known of yet."""
        new: list[int] = []
        if self.is_dead_end(state):
            return new
        self.open.pop(state, None)
        self.ways[state] = found = []
        for action in self._task.usable(state):
            after: dict[int, float] = defaultdict(float)
            for outcome in action.outcomes:
                after[outcome.after(state)] += outcome.chance
            if after.keys() != {state}:
                found.append(ActionWay(action, tuple(after.items())))
                for one in after:
                    self._before[one].setdefault(state, []).append(len(found) - 1)
                    if one not in self.ways and one not in self.ends and one not in self.open:
                        end = self._end(one)
                        if end is None:
                            self.open[one] = None
                            new.append(one)
                        else:
                            self.ends[one] = end
        return new

    def grow(self, state: int, until: float, most: int = MOST_STATES) -> bool:
        """Look into all states that can be reached; return whether these are not too many."""
        waiting = [state, *self.open]
        for one in waiting:
            if one not in self.ways and one not in self.ends:
                if len(self.ways) >= most or self._is_over(until):
                    return False
                waiting += self.expand(one)
        return True

    def best(self, until: float, known: Mapping[int, float] = _NOTHING, unseen: float = 1.0) -> BestWays:
        """Return what is best in every state that has a chance.

        Args:
            known: the cost that is expected from states on at most.
            unseen: the risk of states that are not looked into yet.
        """
        states, certain = [*reversed(self.ways)], self._certain()
        risks = {state: end.risk for state, end in self.ends.items()} | dict.fromkeys(self.open, unseen)
        risks |= {state: 0.0 if state in certain else 1.0 for state in states}
        after = {state: [way.after for way in self.ways[state]] for state in states if state not in certain and self.ways[state]}

        def risk(state: int) -> float:
            return min([sum([p * risks[one] for one, p in pairs]) for pairs in after[state]])

        self._iterate(risks, [*after], risk, lambda old, new: old - new > _EXACT, until)
        costs = {state: end.expected for state, end in self.ends.items()} | dict.fromkeys(self.open, 0.0)
        costs |= {state: known.get(state, 0.0) for state in states}
        choice: dict[int, PolicyAction] = {}
        good: dict[int, list[tuple[PolicyAction, float, list[tuple[int, float]]]]] = {}
        for state in states:
            limit = risks[state] + (0.0 if state in certain else SAME)
            if limit < 1.0:
                fitting = [way for way in self.ways[state] if sum([p * risks[one] for one, p in way.after]) <= limit]
                stays = [sum(p for one, p in way.after if one == state) for way in fitting]
                others = [[pair for pair in way.after if pair[0] != state] for way in fitting]
                good[state] = [(way.action, max(1.0 - p, LEAST_CHANCE), rest) for way, p, rest in zip(fitting, stays, others, strict=True)]

        def cost(state: int) -> float:
            value = inf
            for action, goes, rest in good[state]:
                one = (action.cost + sum([p * costs[after] for after, p in rest])) / goes
                if one < value:
                    value, choice[state] = one, action
            return value

        self._iterate(costs, [*good], cost, lambda old, new: abs(new - old) > _CLOSE * new, until)
        return BestWays(choice, risks, costs)

    def _iterate(
        self,
        values: dict[int, float],
        states: list[int],
        value: Callable[[int], float],
        differs: Callable[[float, float], bool],
        until: float,
    ) -> None:
        """Work out values of states anew until none differs: each again only when one that it may lead to has changed."""
        every = set(states)
        touched = dict.fromkeys(states)
        while touched and not self._is_over(until):
            now, touched = touched, {}
            for state in now:
                if differs(values[state], new := value(state)):
                    values[state] = new
                    touched |= dict.fromkeys(one for one in self._before[state] if one in every)

    def _certain(self) -> set[int]:
        """Return the states from which the goal can be reached for certain."""
        kept = set(self.ways)
        sure = [state for state, end in self.ends.items() if not end.risk]

        def is_safe(state: int, number: int) -> bool:
            return all(after in kept or (after in self.ends and not self.ends[after].risk) for after, _ in self.ways[state][number].after)

        while True:
            reaching, waiting = set[int](), [*sure]
            while waiting:
                for state, numbers in self._before[waiting.pop()].items():
                    if state in kept and state not in reaching and any(is_safe(state, number) for number in numbers):
                        reaching.add(state)
                        waiting.append(state)
            if len(reaching) == len(kept):
                return kept
            kept = reaching


def improve(search: Search, until: float) -> Iterator[None]:
    """Choose actions anew, among all that keep the goal certain, in the states that the entries lead to, as long as that takes less.

    Then also in more and more states beside these, to which other actions may lead, and for which entries are found, and in those on the
    way of plans of their own for the states where another plan went on. All states are looked into if they are few, at once if very few.
    """
    initial, others, most, planned = search.task.initial, list[int](), _AT_ONCE, set[int]()
    every = Envelope(search, lambda state: KnownEnd(0.0, 0.0) if search.task.goal_in(state) else None)
    if every.grow(initial, until, _FEW):
        search.follow(every.best(until), initial)
        yield
        return
    while (before := search.settled(initial)) is not None:
        costs: dict[int, float] = {}
        for root in (initial, *others):
            waiting = [root] if len(costs) < _FEW else []
            for state in waiting:
                entry = search.settled(state)
                if entry is not None and entry.action is not None and state not in costs:
                    costs[state] = entry.expected
                    waiting += (outcome.after(state) for outcome in entry.action.outcomes)
                if search.is_over(until) or len(costs) > _SOME:
                    return

        def end(state: int, costs: Mapping[int, float] = costs) -> KnownEnd | None:
            if state in costs:
                return None
            entry = search.settled(state)
            return KnownEnd(1.0, 0.0) if entry is None else KnownEnd(0.0, entry.expected)

        envelope = Envelope(search, end)
        if not envelope.grow(initial, until):
            return
        search.follow(envelope.best(until, costs), initial)
        first = search.settled(initial)
        if first is not None and first.expected < before.expected * (1.0 - _CLOSE):
            most = _AT_ONCE
            yield
        elif most < _IN_VAIN and len(search.entries) < _FEW and (new := settle_neighbours(search, dict.fromkeys((*costs, *others)), most)):
            others += new
            most *= 2
        elif len(search.entries) < _FEW and (new := settle_plans(search, costs, planned, until)):
            others += new
        else:
            if every.grow(initial, until, _SOME):
                search.follow(every.best(until), initial)
                yield
            return


def settle_neighbours(search: Search, known: Mapping[int, None], most: int) -> list[int]:
    """Find entries for states that other actions may lead to, those of several outcomes first; return the new ones, about so many."""
    found: dict[int, None] = {}
    for is_certain, state in product((False, True), known):
        if len(found) >= most:
            break
        for action in search.task.usable(state):
            after = dict.fromkeys(outcome.after(state) for outcome in action.outcomes)
            if (len(after) == 1) is is_certain and not all(one in known or one in found for one in after) and all(map(search.run, after)):
                found |= {one: None for one in after if one not in known}
    return [*found]


def settle_plans(search: Search, known: Mapping[int, float], planned: set[int], until: float) -> list[int]:
    """Find entries for the states on the way of new plans for known states that are not planned for yet; return those of some plans."""
    found: dict[int, None] = {}
    for state in known:
        if len(found) >= _AT_ONCE or search.is_over(until):
            break
        if state not in planned and search.task.goal_in(state) is None:
            planned.add(state)
            with suppress(OutOfTime):
                steps = search.kairos.plan(state, search.dead.forbidden, until, WAYS[:1]) or []
                search.keep(state, steps)
                for action, number in steps:
                    state = action.outcomes[number].after(state)
                    if state not in known and search.run(state):
                        found[state] = None
    return [*found]


def take_chances(search: Search, until: float) -> Iterator[None]:
    """Find better and better chances of the goal where it cannot be reached for certain: entries of the search."""
    task, hopeless, avoided = search.task, DeadStates(search.task), DeadStates(search.task)
    tested = set[int]()

    def end(state: int) -> KnownEnd | None:
        entry = search.settled(state)
        if entry is not None and not entry.risk:
            return KnownEnd(0.0, entry.expected)
        return KnownEnd(1.0, 0.0) if state in hopeless else None

    def is_lost(state: int) -> bool:
        if state not in tested and state not in hopeless and (part := hopeless.explained(state)):
            hopeless.ends.append(part)
            avoided.add(part)
        tested.add(state)
        return state in hopeless

    def follow() -> float:
        """Make entries of what is best; return its risk, which is 1 if there are none."""
        best = envelope.best(inf)
        if task.initial not in best.choice:
            return 1.0
        search.give_up(frozenset(one for one, risk in best.risks.items() if risk >= 1.0 - SAME))
        search.follow(best, task.initial)
        return best.risks[task.initial]

    if end(task.initial) is not None or is_lost(task.initial):
        return
    envelope = Envelope(search, end, is_lost)
    now = time.monotonic()
    _widen(search, avoided, envelope, now + _SHARE * (until - now), unseen=1.0)
    for most in (0, _FEW, 2 * _FEW, 4 * _FEW, MOST_STATES):
        is_whole = bool(most) and envelope.grow(task.initial, until, most)
        if (risk := follow()) < 1.0:
            yield
        if is_whole or search.is_over(until):
            return
        now = time.monotonic()
        if most == _FEW and _widen(search, avoided, envelope, now + _SHARE * (until - now), unseen=0.0, enough=risk):
            if follow() < risk:
                yield
            return


def _widen(search: Search, avoided: DeadStates, envelope: Envelope, until: float, unseen: float, enough: float = inf) -> bool:
    """Look into states on the way of plans, and again of plans from where outcomes are likely to lead out; return whether none does.

    After RFF (Teichteil-Koenigsbuch, Kuter and Infantes, *Incremental Plan Aggregation for Generating Policies in MDPs*, 2010). If states
    that are not looked into count as sure (`unseen` is 0), nothing is better in the end (LAO*, Hansen and Zilberstein, 2001), nor as
    soon as the risk is not below one that is known to be possible (`enough`).
    Plans say what to do as long as their chance is too small to count.
    """
    likely, planned, best = [search.task.initial], dict[int, PolicyAction](), BestWays({}, {}, {})
    while likely:
        for state in likely:
            envelope.expand(state)
            for forbidden in (avoided.forbidden, _NONE) if state in envelope.ways else ():
                at = state
                try:
                    steps = search.kairos.plan(state, forbidden, until, WAYS[:-1])
                except OutOfTime:
                    steps = None
                for action, number in steps or ():
                    planned.setdefault(at, action)
                    if at not in envelope.ways and at not in envelope.ends:
                        envelope.expand(at)
                    for outcome in action.outcomes:
                        if (one := outcome.after(at)) in envelope.open:
                            envelope.is_dead_end(one)
                    at = action.outcomes[number].after(at)
        if search.is_over(until) or len(envelope.ways) > MOST_STATES:
            return False
        best = envelope.best(until, best.costs, unseen)
        if best.risks[search.task.initial] >= enough - SAME:
            return True
        likely = _reached(search.task.initial, {**planned, **best.choice}, envelope)
    return True


def _reached(initial: int, choice: Mapping[int, PolicyAction], envelope: Envelope) -> list[int]:
    """Return the states where the chosen actions lead out of the envelope, the likeliest first, without those that hardly count."""
    out: dict[int, float] = defaultdict(float)
    here = {initial: 1.0} if initial in choice else {}
    for _ in range(_STEPS):
        after: dict[int, float] = defaultdict(float)
        for state, likely in here.items():
            for outcome in choice[state].outcomes:
                after[outcome.after(state)] += likely * outcome.chance
        here = {}
        for state, likely in after.items():
            if state in choice:
                here[state] = likely
            elif state in envelope.open:
                out[state] += likely
    return sorted((state for state, likely in out.items() if likely > _HARDLY), key=lambda state: (-out[state], state))[:_AT_ONCE]
