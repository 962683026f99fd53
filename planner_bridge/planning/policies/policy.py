"""Policies: entries that say for partial states what to do, and the stretches of a plan that follow from them."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from itertools import chain, product, takewhile
from math import inf, isfinite
from types import MappingProxyType
from typing import Final, NamedTuple, Self

from planner_bridge.model.grounding import ground_step, initial_knowledge, modelled_duration
from planner_bridge.model.plan import GAP, CancelToken, Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import snapshot
from planner_bridge.model.rates import Basis, Chance, Rests
from planner_bridge.planning.policies.chance import improve, take_chances
from planner_bridge.planning.policies.encoding import OutcomePlanner
from planner_bridge.planning.policies.grounding import Chances, Seconds, even_chances, policy_task, task_from
from planner_bridge.planning.policies.numbers import ANY_NUMBER, Scale
from planner_bridge.planning.policies.proof import proved_places
from planner_bridge.planning.policies.search import Interrupted, Search, SettledPart
from planner_bridge.planning.policies.steps import MOST, Step, policy_steps
from planner_bridge.planning.policies.task import ANY, NEVER, OF_METRIC, PartialState, PolicyTask
from pnm.core.knowledge_base import KnowledgeBase, statement_text
from pnm.core.logic.conditions import Compare, evaluate
from pnm.core.logic.effects import Effects, changes
from pnm.core.logic.expressions import Constant, Fluent, State, ValueOf
from pnm.core.machine.plan_graph import GroundAction

_CHANCE: Final = 0.5
"""Seconds for a better chance before the first action."""
_CERTAIN: Final = 0.6
"""Part of the time in which a policy is looked for that reaches the goal for certain."""
_AGAIN: Final = 0.1
"""The same where the search before was in vain."""
_SOON: Final = 0.1
"""The same where there is a plan for robots that wait, before it is looked whether a policy is likely enough to begin with."""
_LIKELY: Final = 0.95
"""A chance of the goal for which that is so."""


class PolicyEntry(NamedTuple):
    """What to do in every state in which these facts and numbers are so."""

    facts: Mapping[Fluent, bool]
    action: str
    arguments: tuple[str, ...]
    distance: float
    """Actions until the goal, with luck."""
    expected: float
    """The cost until the goal, on average: calls, if nothing else is known."""
    chance: float
    """Of the goal."""
    numbers: Mapping[Fluent, tuple[float, float]] = MappingProxyType({})
    """The ranges in which these numbers have to be."""
    outcomes: Mapping[str, float] = MappingProxyType({})
    """The chances that its outcomes were taken to have, if its action has several."""

    def comparisons(self) -> Iterator[Compare]:
        """Yield what has to hold for numbers."""
        for fluent, (least, greatest) in self.numbers.items():
            for operation, limit in ((">=", least), ("<=", greatest)):
                if isfinite(limit):
                    yield Compare(operation, ValueOf(fluent), Constant(limit))

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


class PolicyCall(NamedTuple):
    """What a policy does in a state."""

    place: int
    """That of the entry."""
    entry: PolicyEntry
    duration: float | None
    outcome: str
    """With luck; empty if there is but one."""
    after: Mapping[str, KnowledgeBase]
    """The state after each outcome."""


class _Alone:
    """A policy that no better one takes the place of."""

    @property
    def policies(self) -> tuple[Self, ...]:
        """The policy itself."""
        return (self,)

    def follow(self, policy: object) -> None:
        """Note nothing: there is but this one."""


@dataclass(frozen=True, eq=False)
class Policy(_Alone):
    """What to do wherever the outcomes of actions may lead: of the entries that fit a state, the first one counts."""

    problem: Problem
    entries: tuple[PolicyEntry, ...]
    """Those with the least expected cost first."""
    chance: float = 1.0
    """Of the goal, from the initial state."""
    is_proved: bool = False
    """Whether a check of the policy alone has shown that it reaches the goal if every outcome comes up sooner or later."""
    steps: Callable[[], list[Step]] = field(default=list, repr=False)
    """Returns which entries follow which."""
    measure: str = "calls"
    """What the expected cost is."""

    def __repr__(self) -> str:
        return f"<Policy for {self.problem.name}: {len(self.entries)} entries, {self.claim}>"

    def __str__(self) -> str:
        steps = self.steps()
        more = [f"  {len(steps) - MOST:8d} more"] if len(steps) > MOST else []
        expected = f", {steps[0].expected:.1f} {self.measure} expected" if steps else ""
        return "\n".join((f"{self.claim}{expected}", *(line for step in steps[:MOST] for line in step.lines()), *more))

    @property
    def claim(self) -> str:
        """What can be said of the goal, in words."""
        if self.is_proved:
            return "reaches the goal whatever the outcomes, if each comes up sooner or later (proved)"
        return f"reaches the goal with a chance of {self.chance:.1%}"

    def as_json(self) -> dict[str, object]:
        """Return the claim, the entries, and the steps that they lead to, as JSON has them."""
        entries = [
            {
                "facts": [*(statement_text(fluent, value) for fluent, value in entry.facts.items()), *map(str, entry.comparisons())],
                "action": entry.action,
                "arguments": [*entry.arguments],
                "expected": round(entry.expected, 3),
                "chance": round(entry.chance, 6),
            }
            for entry in self.entries
        ]
        return {"is_proved": self.is_proved, "chance": round(self.chance, 6), "measure": self.measure, "entries": entries} | {
            "steps": [step.as_json() for step in self.steps()]
        }

    def entry(self, state: State) -> PolicyEntry | None:
        """Return the entry for the state; None if there is none."""
        place = self.place(state)
        return None if place is None else self.entries[place]

    def place(self, state: State) -> int | None:
        """Return the place of the entry for the state; None if there is none."""
        true = false = 0
        for fluent, bit in self._bits.items():
            match state.value(fluent):
                case True:
                    true |= bit
                case False | None:
                    false |= bit
        true |= sum(bit for comparison, bit in self._comparisons.items() if evaluate(comparison, state) is True)
        return next((place for place, part in enumerate(self._parts) if not (part[0] & ~true or part[1] & ~false)), None)

    def stretch(self, state: KnowledgeBase) -> Plan | None:
        """Return what to do from a state up to the next action with several outcomes, or to the goal; None if there is no entry for it."""
        return self._plan(state, is_whole=False)

    def plan(self, state: KnowledgeBase) -> Plan | None:
        """Return what to do from a state up to the goal with luck: of several outcomes, that which is nearest to it comes about."""
        return self._plan(state, is_whole=True)

    def _plan(self, state: KnowledgeBase, is_whole: bool) -> Plan | None:
        steps, now = list[PlanStep](), 0.0
        for call in self.calls(state, is_whole=is_whole):
            if call is None:
                return None
            steps.append(PlanStep(call.entry.action, call.entry.arguments, now, call.duration or 0.0, call.outcome))
            now += GAP + (call.duration or 0.0) if self.problem.is_timed else 1.0
        return Plan(tuple(steps), self.problem.is_timed)

    def calls(self, state: KnowledgeBase, *, is_whole: bool = False) -> Iterator[PolicyCall | None]:
        """Yield what to do from a state on, as `stretch` or `plan` has it; None at last if there is no entry for what follows."""
        used, domain = set[int](), self.problem.domain  # each one leads nearer; one that does not would do so for ever
        while evaluate(self.problem.goal, state) is not True:
            place = self.place(state)
            if place is None or place in used:
                yield None
                return
            used.add(place)
            entry = self.entries[place]
            duration = modelled_duration(domain.actions[entry.action], entry.arguments, state)
            action = ground_step(domain, entry.action, entry.arguments, duration, "", self.problem.members)
            ways = _ways(action, _after(action.start_effects, state))
            outcome = min(ways, key=lambda way: self._left(ways[way])) if action.outcomes else ""
            yield PolicyCall(place, entry, duration, outcome, ways)
            if action.outcomes and not is_whole:
                return
            state = ways[outcome]

    def _left(self, state: State) -> tuple[float, float]:
        """Return the risk and the expected cost of what is left: less for one outcome at least, so that plans come to an end."""
        if evaluate(self.problem.goal, state) is True:
            return 0.0, 0.0
        entry = self.entry(state)
        return (1.0, inf) if entry is None else (1.0 - entry.chance, entry.expected)

    @cached_property
    def _bits(self) -> dict[Fluent, int]:
        mentioned = dict.fromkeys(fluent for entry in self.entries for fluent in entry.facts)
        return {fluent: 1 << place for place, fluent in enumerate(mentioned)}

    @cached_property
    def _comparisons(self) -> dict[Compare, int]:
        found = dict.fromkeys(comparison for entry in self.entries for comparison in entry.comparisons())
        return {comparison: 1 << place for place, comparison in enumerate(found, len(self._bits))}

    @cached_property
    def _parts(self) -> list[tuple[int, int]]:
        bits, comparisons = self._bits, self._comparisons
        return [
            (
                sum(bits[fluent] for fluent, value in entry.facts.items() if value)
                + sum(comparisons[comparison] for comparison in entry.comparisons()),
                sum(bits[fluent] for fluent, value in entry.facts.items() if not value),
            )
            for entry in self.entries
        ]


def _after(effects: Effects, before: KnowledgeBase) -> KnowledgeBase:
    state = snapshot(before)
    state.record(changes(effects, before))
    return state


def _ways(action: GroundAction, begun: KnowledgeBase) -> dict[str, KnowledgeBase]:
    """Return the states that the outcomes of an action lead to, by their names; of one with a single outcome, by no name."""
    return {way.name: _after(way.effects, begun) for way in action.outcomes} or {"": _after(action.end_effects, begun)}


@dataclass(frozen=True, eq=False)
class WithLuck(_Alone):
    """A plan that is followed like a policy, wherever a rest of it leads to the goal if outcomes are as it expects."""

    problem: Problem
    whole: Plan
    entries: tuple[PolicyEntry, ...] = ()
    chance: float = 0.0
    is_proved: bool = False

    def stretch(self, state: KnowledgeBase) -> Plan | None:
        """Return what to do from a state up to the next action with several outcomes; None if no rest of the plan leads to the goal."""
        steps, domain = self.whole.steps, self.problem.domain

        def leads_on(steps: Sequence[PlanStep], state: KnowledgeBase) -> bool:
            for step in steps:
                ground = ground_step(domain, step.action, step.arguments, step.duration, "", self.problem.members)
                if evaluate(ground.precondition, state) is not True:
                    return False
                begun = _after(ground.start_effects, state)
                if not all(evaluate(condition, begun) is True for condition in (ground.invariant, ground.end_condition)):
                    return False
                ways = _ways(ground, begun)
                if (after := ways.get(step.outcome, ways.get(""))) is None:
                    return False
                state = after
            return evaluate(self.problem.goal, state) is True

        for first in reversed(range(len(steps))):  # the shortest rest: with luck, the next one is shorter
            if leads_on(steps[first:], state):
                last = next((place for place in range(first, len(steps)) if steps[place].action in domain.uncertain), len(steps))
                return replace(self.whole, steps=steps[first : last + 1])
        return None


class Thinking:
    """A policy that becomes better while robots work. Those found so far, the best one first, are mutable state: a thread adds to them."""

    def __init__(
        self, search: PolicySearch, timeout: float, cancel: CancelToken | None = None, at_work: Callable[[float], float] = lambda _: inf
    ) -> None:
        self.problem: Problem = search.problem
        self.search = search
        self.found: tuple[Policy, ...] = ()
        self.fallback: WithLuck | None = None
        """What is followed as long as there is none."""
        self._followed, self._left = set[Policy | WithLuck](), set[Policy | WithLuck]()
        """Those that were followed, and of these the ones that said nothing of where that has led."""
        self.error: Exception | None = None
        """What ended the search before its time, a fault of this program."""
        self._found, self._over = threading.Event(), threading.Event()
        stop = _Either(cancel)
        better = search.policies(timeout, stop, at_work)
        thread = threading.Thread(target=_think, args=(weakref.ref(self), better, self._found, self._over), daemon=True)
        thread.start()
        weakref.finalize(self, _end, stop, thread)

    def wait(self, timeout: float, improve: float | None, worth: Callable[[float], float]) -> Policy | None:
        """Return a policy, once there is one; None if there is none in time.

        Args:
            timeout: seconds at most.
            improve: seconds to wait for a better one; by default, some for one that has other costs than its calls, of which it was not
                made to have few, and for one that is not sure to reach the goal at least what that is worth.
            worth: returns the seconds to think of what takes so many.
        """
        until = time.monotonic() + timeout
        self._found.wait(timeout)
        if self.error is not None and not self.found:
            raise self.error
        if (found := self.policy) is not None and (improve is not None or not found.is_proved or found.measure != "calls"):
            if improve is None:
                first = None if found.is_proved or found.measure == OF_METRIC else found.entry(initial_knowledge(self.problem))
                improve = _CHANCE if first is None else max(_CHANCE, worth(first.expected))
            self._over.wait(max(0.0, min(improve, until - time.monotonic())))
        return self.policy

    @property
    def policies(self) -> tuple[Policy | WithLuck, ...]:
        """What to follow, the best one first."""
        return tuple(one for one in (*self.found, self.fallback) if one is not None and one not in self._left)

    def follow(self, policy: Policy | WithLuck) -> None:
        """Note that one is followed, and no more a better one that was: whoever followed both in turn might go round for ever."""
        better = takewhile(lambda one: one is not policy, self.policies)
        self._left.update(self._followed.intersection(better))
        self._followed.add(policy)

    @property
    def policy(self) -> Policy | None:
        """The best policy so far."""
        return self.found[0] if self.found else None

    @property
    def entries(self) -> tuple[PolicyEntry, ...]:
        """Those of the best policy so far."""
        return self.policy.entries if self.policy else ()

    @property
    def chance(self) -> float:
        """That of the best policy so far."""
        return self.policy.chance if self.policy else 0.0

    @property
    def is_proved(self) -> bool:
        """Whether the best policy so far is proved to reach the goal."""
        return self.policy is not None and self.policy.is_proved

    def stretch(self, state: KnowledgeBase) -> Plan | None:
        """Return what to do from a state up to the next action with several outcomes; see `Policy.stretch`."""
        found = (policy.stretch(state) for policy in self.policies)  # an earlier one may have led to where the best one never gets
        return next((plan for plan in found if plan is not None), None)


class _Either:
    """Set when either this or the token from elsewhere is."""

    def __init__(self, other: CancelToken | None) -> None:
        self._own, self._other = threading.Event(), other
        self.set = self._own.set

    def is_set(self) -> bool:
        return self._own.is_set() or (self._other is not None and self._other.is_set())


def _think(owner: weakref.ref[Thinking], better: Iterator[Policy], found: threading.Event, over: threading.Event) -> None:
    try:
        for policy in better:
            thinking = owner()
            if thinking is None:
                break
            thinking.found = policy, *thinking.found
            del thinking
            found.set()
    except Exception as error:  # told where a policy is waited for
        if (thinking := owner()) is not None:
            thinking.error = error
    over.set()
    found.set()


def _end(stop: _Either, thread: threading.Thread) -> None:
    """Let a thread come to its end: at the end of the program, too, which does not wait for daemons."""
    stop.set()
    if thread is not threading.current_thread():
        thread.join(10.0)  # a process that ends within a call of Kairos is aborted: on a busy machine a second is too short


class PolicySearch:
    """The search for policies of a problem. The mutable state is what it has found so far, which another search may take over.

    Args:
        seconds: how long actions take, where policies are measured by that; by default, as long as the domain says.
        chances: how likely outcomes are; by default, as the domain says, and else all of an action as likely.
        before: a search for the same goal, from another state or with fewer forbidden calls.
        is_over: says that the time is over, or nobody waits for it any more, while the problem is made ready.

    Raises `Unsuitable` if the problem has more than facts and numbers that only actions change, or is not ready in time.
    """

    def __init__(
        self,
        problem: Problem,
        seconds: Seconds | None = None,
        chances: Chances | None = None,
        before: PolicySearch | None = None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> None:
        self.plan: Plan | None = None
        """A good one for the case that outcomes can be chosen, if there is one before the search begins."""
        known = task_from(before.task, before.problem, problem) if before else None
        self.problem: Problem = problem
        self.task: PolicyTask = known or policy_task(problem, seconds, chances, is_over)
        self.certain: Search | None = before.certain if before and known else None
        """The last search for a policy that reaches the goal for certain."""
        self.is_hard: bool = before is not None and before.is_in_vain
        """Whether the search before was in vain."""

    @property
    def is_in_vain(self) -> bool:
        """Whether no policy that reaches the goal for certain has been found for the state that it was made for."""
        return self.certain is not None and self.certain.settled(self.certain.task.initial) is None

    def policies(
        self, timeout: float, cancel: CancelToken | None = None, at_work: Callable[[float], float] = lambda _: inf
    ) -> Iterator[Policy]:
        """Yield better and better policies: that reach the goal for certain, or else with the best chance that is found so far.

        Args:
            at_work: returns the seconds for which a policy that takes so many, and is certain, is improved.
        """
        problem, task, began = self.problem, self.task, time.monotonic()
        until, kairos, before = began + timeout, OutcomePlanner(problem, task, self.plan), self.certain
        search = Search(task, kairos, until, cancel)
        if before is not None:
            search.take_over(before)
        self.certain = search
        stages = [(_AGAIN, 1.0, kairos.luck)] if self.is_hard else [(_CERTAIN, 1.0, kairos.luck)]
        if self.plan is not None and not self.is_hard:
            stages.insert(0, (_SOON, 2 * _SOON, _LIKELY))
        best = 1.0, inf
        for share, end, least in stages:
            search.until = began + timeout * share
            with suppress(Interrupted):
                if (yield from _certain(problem, search, until, at_work)):
                    return
            if all(scale.is_exact for scale in task.scales):
                chances = Search(task, kairos, began + timeout * end, cancel)
                chances.entries += search.entries
                with suppress(Interrupted):
                    for _ in take_chances(chances, chances.until):
                        first = chances.settled(task.initial)
                        if first is not None and 1.0 - first.risk >= least and (first.risk, first.expected) < best:
                            best = first.risk, first.expected
                            yield _policy(problem, chances)
        if not search.dead.is_certain:  # a plan that was not found in time may be found in more
            kairos.is_patient, known = True, search.entries
            self.certain = search = Search(task, kairos, until, cancel)
            search.entries += known
        search.until = until
        with suppress(Interrupted):
            if not search.is_over(until):
                yield from _certain(problem, search, until, at_work)


def policies(problem: Problem, timeout: float, seconds: Seconds | None = None) -> Iterator[Policy]:
    """Return better and better policies; see `PolicySearch`."""
    return PolicySearch(problem, seconds).policies(timeout)


def _certain(problem: Problem, search: Search, until: float, at_work: Callable[[float], float]) -> Generator[Policy, None, bool]:
    """Yield better and better policies that reach the goal for certain; return whether there are any, in so far as there was time."""
    if not search.run(search.task.initial):
        return False
    first = search.settled(search.task.initial)
    assert first is not None, "the initial state is settled"
    taken = first.distance if search.task.measure == OF_METRIC else first.expected
    search.until = until = min(until, time.monotonic() + at_work(taken))
    is_exact, best = all(scale.is_exact for scale in search.task.scales), (True, inf)
    for _ in chain((None,), improve(search, until)):
        policy, now = _policy(problem, search), search.settled(search.task.initial)
        if now is not None and (policy.is_proved or is_exact) and (not policy.is_proved, now.expected) < best:
            best = not policy.is_proved, now.expected  # who follows one that is as good as the last one learns nothing
            yield policy
    return True


def _policy(problem: Problem, search: Search) -> Policy:
    task, first = search.task, search.settled(search.task.initial)
    assert first is not None, "there is an entry for the initial state"
    ranked = [part for part in sorted(search.entries) if part.action is not None]
    entries = [
        PolicyEntry(
            {**dict.fromkeys(task.named(need.true), True), **dict.fromkeys(task.named(need.false), False)},
            action.name,
            action.arguments,
            distance,
            expected,
            1.0 - risk,
            {scale.fluent: bounds for scale in task.scales if (bounds := scale.bounds(*need)) != ANY_NUMBER},
            {way.name: way.chance for way in action.outcomes} if len(action.outcomes) > 1 else {},
        )
        for risk, expected, distance, need, _, action in ranked
        if action is not None
    ]
    certain = sum(entry.chance == 1.0 for entry in entries)  # they come first
    proved = None if first.risk else proved_in(problem, entries[:certain], task.scales)
    kept = [*range(len(entries))] if proved is None else [*proved, *range(certain, len(entries))]
    steps = partial(policy_steps, task, [ranked[place] for place in kept])
    return Policy(problem, tuple(entries[place] for place in kept), 1.0 - first.risk, proved is not None, steps, task.measure)


def steps_of(problem: Problem, entries: Sequence[PolicyEntry]) -> list[Step]:
    """Return which entries follow which, from the initial state of the problem on, as whoever has found them has it."""
    known = {(entry.action, entry.arguments): Chance(entry.outcomes, Rests(Basis.ASSUMED)) for entry in entries if entry.outcomes}
    task = policy_task(problem, chances=lambda action, ways: known.get((action.name, action.arguments)) or even_chances(action, ways))
    actions, scales = {str(action): action for action in task.actions}, {scale.fluent: scale for scale in task.scales}
    bits = {fact: PartialState(1 << number) for number, fact in enumerate(task.facts)}

    def need(entry: PolicyEntry) -> PartialState:
        facts = [bits.get(fluent, NEVER if value else ANY) for fluent, value in entry.facts.items()]
        parts = [fact if value else PartialState(0, fact.true) for fact, value in zip(facts, entry.facts.values(), strict=True)]
        parts += [PartialState(*scales[fluent].facts(bounds)) for fluent, bounds in entry.numbers.items() if fluent in scales]
        return reduce(PartialState.joined, parts, ANY if str(entry) in actions else NEVER)

    return policy_steps(
        task,
        [
            SettledPart(1.0 - one.chance, one.expected, one.distance, need(one), number, actions.get(str(one)))
            for number, one in enumerate(entries)
        ],
    )


def proved_in(problem: Problem, entries: Sequence[PolicyEntry], scales: Sequence[Scale]) -> list[int] | None:
    """Return the places of entries proved to reach the goal, or None: with numbers that leave the ranges of their scales, or not."""
    sides = product((True, False), repeat=2) if scales else [(False, False)]  # what never comes about may leave a range
    ends = ({scale.fluent: (scale.ends[0] if low else -inf, scale.ends[1] if high else inf) for scale in scales} for low, high in sides)
    found = (proved_places(problem, entries, initial_knowledge(problem), one) for one in ends)
    return next((places for places in found if places is not None), None)
