"""The odds of a policy: a Markov chain over the states between its stretches.

A stretch is a plan, whose calls have exact odds. It ends in one of the outcomes of its last call, by their chances: the declared ones,
else the learned ones, else all are as likely. If all calls of it succeed, the policy says what follows; a failure for good ends the
chain, because what is planned then is no part of the policy. The chance and the number of calls are solved exactly, for chances as they
are known; where these were learned, the chance is the mean over draws of what they may be. Times are drawn along the chain.

While a plan is carried out, what is left of it comes first.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count
from math import prod
from random import Random
from statistics import fmean
from typing import Final

from planner_bridge.model.determinization import untold
from planner_bridge.model.grounding import decisive_names, initial_knowledge, problem_now
from planner_bridge.model.plan import Policy
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from planner_bridge.model.rates import Basis, Chance, Rests
from planner_bridge.ordering.plan_to_graph import stretch_graph
from planner_bridge.ordering.robot_time import function_of
from planner_bridge.pipeline.odds import (
    DRAWS,
    INTERVAL_DRAWS,
    Attempts,
    CallKind,
    CallOdds,
    GoalOdds,
    KnownRobots,
    Odds,
    chance_of,
    in_worlds,
    interval,
    odds_of_calls,
    times,
)
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.run_view import RunView
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import Alternative
from pnm.core.logic.expressions import Fluent, Value, is_number
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.requests import CallOutcome

MOST_STATES: Final = 200
"""States between stretches, at most."""
_DRAWS: Final = 20_000
"""Draws of the times of all stretches together, or of all calls of what is left of a plan; each has `_LEAST` at least."""
_LEAST: Final = 50
_DRAWN: Final = 200_000
"""Stretches of all ways to the goal that are drawn, together."""
_GOAL, _NOWHERE = -1, -2
_ONE_OUTCOME: Final = Chance({"": 1.0}, Rests(Basis.ASSUMED))
_STEP: Final = 1e-100
"""A chance is multiplied by 1 + `_STEP` i for every call: its imaginary part is then its derivative, which counts the calls."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """What the policy does in a state, and the number of the state that each outcome leads to, by its name, if all calls succeed."""

    graph: PlanGraph
    calls: tuple[CallOdds, ...]
    then: Mapping[str, int] = field(default_factory=dict)
    began: float = 0.0
    """Seconds from now, so not above 0."""

    @property
    def outcomes(self) -> Chance:
        """The chances of its outcomes; it has one, without a name, if no action has several."""
        return next((call.attempt.outcomes for call in self.calls if call.attempt.outcomes), _ONE_OUTCOME)

    def leads(self, chance: Chance) -> dict[int, float]:
        """Return the numbers of the states that it leads to, with their chances by those of its outcomes."""
        found: dict[int, float] = defaultdict(float)
        for name, after in self.then.items():
            found[after] += chance.of(name)
        return found

    @property
    def left(self) -> tuple[CallOdds, ...]:
        """The calls that have not ended."""
        return tuple([call for call in self.calls if call.ended is None])


@dataclass(frozen=True, slots=True)
class PolicyChain:
    """The Markov chain of a policy: its stretches, by the numbers of the states in which they begin; the initial one is the first."""

    stretches: tuple[Stretch, ...]

    @staticmethod
    def of(
        problem: Problem, policy: Policy, bindings: Bindings, attempts: Attempts, most: int = MOST_STATES, begun: PlanGraph | None = None
    ) -> PolicyChain | None:
        """Return the chain; None if there is no policy yet, calls have no exact odds, or there are more states, or outcomes untold.

        Args:
            begun: what is carried out from the initial state on; by default what the policy does there.
        """
        if not policy.entries or any(untold(problem, bindings, bindings.assumed)):
            return None
        read = decisive_names(problem)
        numbers: dict[frozenset[tuple[Fluent, object]], int] = {}
        states: list[KnowledgeBase] = []

        def number(state: KnowledgeBase) -> int:
            if evaluate(problem.goal, state) is True:
                return _GOAL
            key = frozenset([one for one in state.facts().items() if one[0][0] in read and one[1] is not False])
            if numbers.setdefault(key, len(states)) == len(states):
                states.append(state)
            return numbers[key]

        first = initial_knowledge(problem)
        if begun:
            states.append(first)  # whoever comes there again begins it anew
        else:
            number(first)
        found: list[Stretch] = []
        for state in states:
            plan = None if begun else policy.stretch(state)
            graph = begun or (stretch_graph(problem_now(problem, state), plan) if plan else PlanGraph(()))
            calls = odds_of_calls(graph, bindings, attempts)
            if calls is None or len(states) > most:
                return None
            then = {} if graph.calls else {"": _NOWHERE}
            ways = next((call.action.outcomes for call in graph.calls if call.action.outcomes), (Alternative(()),))
            for way in ways if graph.calls else ():
                walk = Progression(snapshot(state))
                try:
                    for event in graph.order:
                        action = graph.calls[event.call].action
                        walk.advance([(event, replace(action, end_effects=way.effects) if action.outcomes else action)])
                except NotApplicable:
                    return None
                then[way.name] = number(walk.state)
            found.append(Stretch(graph, calls, then))
            begun = None
        return PolicyChain(tuple(found))

    @property
    def calls(self) -> tuple[CallOdds, ...]:
        """All calls, each once."""
        return tuple({(str(call.call.action), call.kind): call for stretch in self.stretches for call in stretch.left}.values())

    def odds(self) -> Odds:
        """Return the odds of the goal.

        Its chance is the mean over what learned chances may be, by as many draws as its interval; the calls are counted with their means.
        """
        kinds = {call.kind: call.chance() for call in self.calls}
        means = {stretch.outcomes.estimate: stretch.outcomes for stretch in self.stretches}
        values = self.chances(kinds, means)
        draws, random = _draws(len(values)), Random(0)
        worlds = min(INTERVAL_DRAWS, draws)
        outcomes = {key: chance.drawn(random, worlds) for key, chance in means.items()}

        def chance_in(success: Mapping[CallKind, float], world: int) -> float:
            return self.chances(success, {key: drawn[world] for key, drawn in outcomes.items()})[0].real

        between = interval(self.calls, chance_in, worlds)
        chance = round(fmean(in_worlds(kinds, chance_in, worlds, assumed=False)) if between else values[0].real, 12)
        lasts = self.times({number: value.real for number, value in values.items()}, draws) if chance else ()
        return Odds(chance, between or (chance, chance), lasts, actions=values[0].imag / _STEP / values[0].real if chance else 0.0)

    def chances(self, success: Mapping[CallKind, float], outcomes: Mapping[tuple[object, ...], Chance]) -> dict[int, complex]:
        """Return the chance of the goal from every state: states are taken out of the chain, the last one first, and put in again.

        What leaves a state is summed up, and not taken from 1 (Grassmann, Taksar and Heyman 1985): nothing small is lost.

        Args:
            outcomes: the chances of the outcomes of stretches, by the key of what is known of them.
        """
        rows = list[dict[int, complex]]()
        for stretch in self.stretches:
            chance, leads = prod(success[call.kind] for call in stretch.left), stretch.leads(outcomes[stretch.outcomes.estimate])
            row = {after: chance * share * (1.0 + 1j * _STEP * len(stretch.left)) for after, share in leads.items()}
            rows.append({**row, _NOWHERE: row.get(_NOWHERE, 0.0) + 1.0 - chance})
        for number in reversed(range(len(rows))):
            row = rows[number]
            stays = row.pop(number, 0j)
            leaves = complex(sum(share.real for share in row.values()), -stays.imag)
            rows[number] = row = {after: share / leaves for after, share in row.items()} if leaves.real else {_NOWHERE: 1.0}
            for before in rows[:number]:
                if (reaches := before.pop(number, None)) is not None:
                    for after, share in row.items():
                        before[after] = before.get(after, 0.0) + reaches * share
        values: dict[int, complex] = {_GOAL: 1.0, _NOWHERE: 0.0}
        for number, row in enumerate(rows):
            values[number] = sum((share * values[after] for after, share in row.items()), 0j)
        return values

    def times(self, chances: Mapping[int, float], draws: int) -> tuple[float, ...]:
        """Draw the seconds of runs that reach the goal, with the same random numbers every time."""
        random, found = Random(0), list[float]()

        @cache
        def lasts(number: int) -> list[float]:
            return times(self.stretches[number].graph, self.stretches[number].calls, draws, self.stretches[number].began)

        @cache
        def leads(number: int) -> tuple[tuple[int, ...], list[float]]:
            shares = self.stretches[number].leads(self.stretches[number].outcomes)
            return (*shares,), [share * chances[after] for after, share in shares.items()]

        done = count()
        while len(found) < DRAWS and next(done) < _DRAWN:
            at, seconds = 0, 0.0
            while at != _GOAL:
                if not lasts(at):
                    return ()
                seconds, (ends, weights), _ = seconds + random.choice(lasts(at)), leads(at), next(done)
                (at,) = random.choices(ends, weights)
            found.append(seconds)
        return tuple(sorted(found))


def _draws(number: int) -> int:
    """Return the draws of each of so many stretches or calls: the more there are, the fewer."""
    return max(_LEAST, min(DRAWS, _DRAWS // max(1, number)))


# --- what is left of a plan -----------------------------------------------------------------------


_AS_PLANNED: Final = {CallOutcome.WAITING, CallOutcome.RUNNING, CallOutcome.SUSPENDED, CallOutcome.SUCCEEDED, CallOutcome.ALREADY_TRUE}
"""What becomes of calls as long as nothing else has to follow than their plan."""


@dataclass(frozen=True)
class RestOfPlan:
    """How far a run has come.

    Args:
        results: of its calls, by number.
        accepted: when servers took on what is under way.
        origin: the time from which its plan counts.
        now: the time on the same clock.
        world: the functions that bindings name for the seconds of its calls.
    """

    graph: PlanGraph
    bindings: Bindings
    results: Mapping[int, CallResult]
    accepted: Mapping[int, float]
    origin: float
    now: float
    world: Mapping[Fluent, Value] = field(default_factory=dict)

    @staticmethod
    def of(run: RunView, since: float) -> RestOfPlan:
        """Return how far a run has come, at the time of the last event of its calls, or since when it is so at least."""
        plan = run.machine.plan
        calls = [run.result_of(call.index) for call in plan.calls]
        accepted = {request.call.index: request.accepted for request in run.under_way()}
        events = [time for call in calls for time in (call.started, call.ended) if time is not None]
        now = max(since, run.origin or since, *events, *accepted.values())
        results = {result.call.index: result for result in calls}
        named = {function_of(call.call.action, run.bindings) for call in calls} - {None}
        world = {fluent: value for fluent in named if fluent and is_number(value := run.knowledge.value(fluent))}
        return RestOfPlan(plan, run.bindings, results, accepted, now if run.origin is None else run.origin, now, world)

    def attempts(self, known: KnownRobots) -> Attempts:
        """Return what is known of the attempts of its calls."""
        return known.attempts(self.bindings, self.world, is_timed=any(call.action.duration is not None for call in self.graph.calls))

    def calls(self, known: KnownRobots) -> tuple[CallOdds, ...] | None:
        """Return the odds of its calls; None if there are none, or something has failed, and something else follows."""
        found = odds_of_calls(self.graph, self.bindings, self.attempts(known))
        if found is None or not {result.kind for result in self.results.values()} <= _AS_PLANNED:
            return None

        def left_of(odds: CallOdds) -> CallOdds:
            if (result := self.results[odds.call.index]).kind is CallOutcome.WAITING:
                return odds
            began = 0.0 if result.started is None else result.started - self.now
            if result.is_done:
                return replace(odds, began=began, ended=0.0 if result.ended is None else result.ended - self.now)
            at_work = self.now - self.accepted.get(odds.call.index, self.now)
            spent = result.attempts - (result.kind is not CallOutcome.SUSPENDED)
            return replace(odds, began=began, retries=max(0, odds.retries - spent), at_work=at_work)

        return tuple(map(left_of, found))

    def chain(self, known: KnownRobots, policy: Policy, began: Problem) -> PolicyChain | None:
        """Return the chain of its plan and of what its policy has after it, however far it has come; None as for `PolicyChain.of`.

        Args:
            began: the problem from the state in which the run began.
        """
        return PolicyChain.of(began, policy, self.bindings, self.attempts(known), begun=self.graph)

    def odds(self, known: KnownRobots, chain: PolicyChain | None = None) -> GoalOdds | None:
        """Return the odds of what is left of its plan, and of what follows it; None if there are none.

        Args:
            chain: says what follows where its last call has several outcomes.
        """
        calls = self.calls(known)
        if calls is None:
            return None
        begun = Stretch(self.graph, calls, began=self.origin - self.now)
        if any(call.call.action.outcomes for call in calls):
            if chain is None or not any(call.call.action.outcomes for call in begun.left):
                return None  # it is not known what follows, or not yet how it has turned out
            chain = PolicyChain((replace(begun, then=chain.stretches[0].then), *chain.stretches[1:]))
            return GoalOdds(chain.odds(), None, chain.calls)
        chance = chance_of(begun.left)
        lasts = tuple(sorted(times(self.graph, calls, _draws(len(begun.left)), begun.began))) if chance else ()
        return GoalOdds(Odds(chance, (chance, chance), lasts), None, begun.left)
