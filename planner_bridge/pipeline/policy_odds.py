"""The odds of a policy: a Markov chain over the states between its stretches.

A stretch is a plan, whose calls have exact odds. It ends in one of the outcomes of its last call, by their chances: the declared ones,
or else all are as likely. If all calls of it succeed, the policy says what follows; a failure for good ends the chain, because what is
planned then is no part of the policy. The chance and the number of calls are solved exactly, and times are drawn along the chain.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from math import prod
from random import Random
from typing import Final

from planner_bridge.model.determinization import untold
from planner_bridge.model.grounding import dynamic_names, initial_knowledge, problem_now
from planner_bridge.model.plan import Policy
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from planner_bridge.ordering.plan_to_graph import stretch_graph
from planner_bridge.pipeline.odds import DRAWS, INTERVAL_DRAWS, Attempts, CallKind, CallOdds, Odds, interval, odds_of_calls, times
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import Alternative
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import PlanGraph

MOST_STATES: Final = 200
"""States between stretches, at most."""
_DRAWS: Final = 20_000
"""Draws of the times of all stretches together, each of which has `_LEAST` at least."""
_LEAST: Final = 50
_DRAWN: Final = 200_000
"""Stretches of all ways to the goal that are drawn, together."""
_GOAL, _NOWHERE = -1, -2
_STEP: Final = 1e-100
"""A chance is multiplied by 1 + `_STEP` i for every call: its imaginary part is then its derivative, which counts the calls."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """What the policy does in a state, and the numbers of the states that this leads to, with their chances if all calls succeed."""

    graph: PlanGraph
    calls: tuple[CallOdds, ...]
    leads: Mapping[int, float]


@dataclass(frozen=True, slots=True)
class PolicyChain:
    """The Markov chain of a policy: its stretches, by the numbers of the states in which they begin; the initial one is the first."""

    stretches: tuple[Stretch, ...]

    @staticmethod
    def of(problem: Problem, policy: Policy, bindings: Bindings, attempts: Attempts, most: int = MOST_STATES) -> PolicyChain | None:
        """Return the chain; None if calls have no exact odds, there are more states, or nothing tells some outcomes apart."""
        if any(untold(problem, bindings, bindings.assumed)):
            return None
        facts = dynamic_names(problem) - problem.domain.functions.keys()
        numbers: dict[frozenset[Fluent], int] = {}
        states: list[KnowledgeBase] = []

        def number(state: KnowledgeBase) -> int:
            if evaluate(problem.goal, state) is True:
                return _GOAL
            key = frozenset([fluent for fluent, value in state.facts().items() if value is True and fluent[0] in facts])
            if numbers.setdefault(key, len(states)) == len(states):
                states.append(state)
            return numbers[key]

        number(initial_knowledge(problem))
        found: list[Stretch] = []
        for state in states:
            plan = policy.stretch(state)
            graph = stretch_graph(problem_now(problem, state), plan) if plan else PlanGraph(())
            calls = odds_of_calls(graph, bindings, attempts)
            if calls is None or len(states) > most:
                return None
            leads: dict[int, float] = defaultdict(float) if plan else {_NOWHERE: 1.0}
            ways = next((call.action.outcomes for call in graph.calls if call.action.outcomes), (Alternative(()),))
            for way in ways if plan else ():
                walk = Progression(snapshot(state))
                try:
                    for event in graph.order:
                        action = graph.calls[event.call].action
                        walk.advance([(event, replace(action, end_effects=way.effects) if action.outcomes else action)])
                except NotApplicable:
                    return None
                leads[number(walk.state)] += 1.0 / len(ways) if way.chance is None else way.chance
            found.append(Stretch(graph, calls, leads))
        return PolicyChain(tuple(found))

    @property
    def calls(self) -> tuple[CallOdds, ...]:
        """All calls, each once."""
        return tuple({str(call.call.action): call for stretch in self.stretches for call in stretch.calls}.values())

    def odds(self) -> Odds:
        """Return the odds of the goal."""
        values = self.chances({call.kind: call.chance() for call in self.calls})
        chance = round(values[0].real, 12)
        draws = max(_LEAST, min(DRAWS, _DRAWS // len(values)))
        between = interval(self.calls, lambda success: self.chances(success)[0].real, min(INTERVAL_DRAWS, draws))
        lasts = self.times({number: value.real for number, value in values.items()}, draws) if chance else ()
        return Odds(chance, between or (chance, chance), lasts, actions=values[0].imag / _STEP / chance if chance else 0.0)

    def chances(self, success: Mapping[CallKind, float]) -> dict[int, complex]:
        """Return the chance of the goal from every state: states are taken out of the chain, the last one first, and put in again.

        What leaves a state is summed up, and not taken from 1 (Grassmann, Taksar and Heyman 1985): nothing small is lost.
        """
        rows: list[dict[int, complex]] = []
        for stretch in self.stretches:
            chance = prod(success[call.kind] for call in stretch.calls)
            row = {after: chance * share * (1.0 + 1j * _STEP * len(stretch.calls)) for after, share in stretch.leads.items()}
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
            return times(self.stretches[number].graph, self.stretches[number].calls, draws)

        @cache
        def leads(number: int) -> tuple[tuple[int, ...], list[float]]:
            shares = self.stretches[number].leads
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
