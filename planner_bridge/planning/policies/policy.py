"""Policies: entries that say for partial states what to do, and the stretches of a plan that follow from them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import NamedTuple

from planner_bridge.model.grounding import ground_step, initial_knowledge, modelled_duration
from planner_bridge.model.plan import GAP, CancelToken, Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.planning.policies.encoding import Determinization
from planner_bridge.planning.policies.proof import unproved
from planner_bridge.planning.policies.search import Interrupted, Search
from planner_bridge.planning.policies.task import Task, policy_task
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import changes
from pnm.core.logic.expressions import Fluent, State, Unknown, Value


class Entry(NamedTuple):
    """What to do in every state in which these facts are so."""

    facts: Mapping[Fluent, bool]
    action: str
    arguments: tuple[str, ...]
    distance: int
    """Actions until the goal, with luck."""
    expected: float
    """Actions until the goal, on average."""

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


@dataclass(frozen=True, eq=False)
class Policy:
    """What to do wherever the outcomes of actions may lead: of the entries that fit a state, the first one counts."""

    problem: Problem
    entries: tuple[Entry, ...]
    """Those with the fewest expected actions first."""
    chance: float = 1.0
    """Of the goal, from the initial state."""
    is_proved: bool = False
    """Whether a check of the policy alone has shown that it reaches the goal if every outcome comes up sooner or later."""

    def __repr__(self) -> str:
        claim = "reaches the goal for certain" if self.is_proved else f"reaches the goal with a chance of {self.chance:.0%}"
        return f"<Policy for {self.problem.name}: {len(self.entries)} entries, {claim}>"

    def entry(self, state: State) -> Entry | None:
        """Return the entry for the state; None if there is none."""
        true = false = 0
        for fluent, bit in self._bits.items():
            match state.value(fluent):
                case True:
                    true |= bit
                case False | None:
                    false |= bit
        number = next((place for place, part in enumerate(self._parts) if not (part[0] & ~true or part[1] & ~false)), None)
        return None if number is None else self.entries[number]

    def stretch(self, state: State) -> Plan | None:
        """Return what to do from a state up to the next action with several outcomes, or to the goal; None if there is no entry for it."""
        return self._plan(state, is_whole=False)

    def plan(self, state: State) -> Plan | None:
        """Return what to do from a state up to the goal with luck: of several outcomes, that which is nearest to it comes about."""
        return self._plan(state, is_whole=True)

    def _plan(self, state: State, is_whole: bool) -> Plan | None:
        steps: list[PlanStep] = []
        domain, is_timed, now = self.problem.domain, self.problem.is_timed, 0.0
        while evaluate(self.problem.goal, state) is not True:
            entry = self.entry(state)
            if entry is None:
                return None
            duration = modelled_duration(domain.actions[entry.action], entry.arguments, state)
            action = ground_step(domain, entry.action, entry.arguments, duration, "", self.problem.members)
            begun = _After(state, changes(action.start_effects, state))
            ways = [(way.name, _After(begun, changes(way.effects, begun))) for way in action.outcomes]
            outcome, state = (
                min(ways, key=lambda way: self._distance(way[1])) if ways else ("", _After(begun, changes(action.end_effects, begun)))
            )
            steps.append(PlanStep(entry.action, entry.arguments, now, duration or 0.0, outcome))
            now += GAP + (duration or 0.0) if is_timed else 1.0
            if ways and not is_whole:
                break
        return Plan(tuple(steps), is_timed)

    def _distance(self, state: State) -> float:
        if evaluate(self.problem.goal, state) is True:
            return 0
        entry = self.entry(state)
        return inf if entry is None else entry.distance

    @cached_property
    def _bits(self) -> dict[Fluent, int]:
        mentioned = dict.fromkeys(fluent for entry in self.entries for fluent in entry.facts)
        return {fluent: 1 << place for place, fluent in enumerate(mentioned)}

    @cached_property
    def _parts(self) -> list[tuple[int, int]]:
        bits = self._bits
        return [
            (
                sum(bits[fluent] for fluent, value in entry.facts.items() if value),
                sum(bits[fluent] for fluent, value in entry.facts.items() if not value),
            )
            for entry in self.entries
        ]


@dataclass(frozen=True, slots=True)
class _After:
    """A state after changes."""

    before: State
    changed: Mapping[Fluent, Value | Unknown]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.changed[fluent] if fluent in self.changed else self.before.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.before.objects(types)


def find_policy(problem: Problem, timeout: float, cancel: CancelToken | None = None) -> Policy | None:
    """Search for a policy that reaches the goal for certain; None if there is none, or none was found in time.

    Raises `Unsuitable` if the problem has more than facts that only actions change.
    """
    task = policy_task(problem)
    search = Search(task, Determinization(problem, task), time.monotonic() + timeout, cancel)
    try:
        found = search.run(task.initial)
    except Interrupted:
        found = False
    if not found:
        return None
    entries = _reached(task, search)
    policy = Policy(problem, entries)
    return Policy(problem, entries, is_proved=not unproved(problem, policy.entries, initial_knowledge(problem)))


def _reached(task: Task, search: Search) -> tuple[Entry, ...]:
    """Return the entries that are needed from the initial state on, and all that these may lead to."""
    return tuple(
        Entry(
            {**dict.fromkeys(task.named(need.true), True), **dict.fromkeys(task.named(need.false), False)},
            action.name,
            action.arguments,
            distance,
            expected,
        )
        for expected, distance, need, _, action in search.entries
        if action is not None
    )
