"""The proof that a policy reaches the goal, whatever the outcomes, if every outcome comes up sooner or later.

Three conditions are checked on the entries alone, by the meaning of actions for states of which only those facts are known that an
entry names:

1. Where an entry fits, its action can be carried out.
2. Each of its outcomes leads to the goal, or to where some entry fits.
3. One of them leads to the goal, or to an entry with fewer expected actions.

By the third, the first entry that fits has a way on which the expected actions become fewer and fewer, of which there are finitely many;
by the second, whatever happens instead, there is such a way again. How the policy was found does not matter.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol, assert_never

from planner_bridge.model.grounding import dynamic_names, ground_step
from planner_bridge.model.problem import Problem
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, When
from pnm.core.logic.expressions import NOTHING, UNKNOWN, Environment, Fluent, State, Truth, Unknown, Value, bind, choices, value_of


class PolicyRule(Protocol):
    """An entry of a policy."""

    @property
    def facts(self) -> Mapping[Fluent, bool]:
        """The facts that have to be so."""

    @property
    def action(self) -> str:
        """The action."""

    @property
    def arguments(self) -> tuple[str, ...]:
        """Its objects."""

    @property
    def expected(self) -> float:
        """The expected actions until the goal."""


@dataclass(frozen=True, slots=True)
class _Known:
    """A state of which these facts are known, and what never changes."""

    facts: Mapping[Fluent, Value | Unknown]
    constant: State
    changing: frozenset[str]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        if fluent[0] in self.changing:
            return self.facts.get(fluent, UNKNOWN)
        return self.constant.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.constant.objects(types)


def unproved(problem: Problem, rules: Sequence[PolicyRule], initial: State) -> str:
    """Return what cannot be proved of the policy in the initial state, with the entry; empty if it reaches the goal."""
    changing, index = dynamic_names(problem), _Index(rules)
    facts = {fluent: bool(initial.value(fluent)) for fluent in index.mentioned}
    if evaluate(problem.goal, initial) is not True and index.least(facts) == inf:
        return "there is no entry for the initial state"
    for number, rule in enumerate(rules, 1):
        about = f"entry {number}, {rule.action}({', '.join(rule.arguments)})"
        action = ground_step(problem.domain, rule.action, rule.arguments, None, "", problem.members)
        state = _Known(rule.facts, initial, changing)
        if evaluate(action.precondition, state) is not True:
            return f"{about}: {action.precondition} need not hold"
        begun = _Known(_after(action.start_effects, state), initial, changing)
        for condition in (action.invariant, action.end_condition):
            if evaluate(condition, begun) is not True:
                return f"{about}: {condition} need not hold"
        nearest = inf
        for effects in [way.effects for way in action.outcomes] or [action.end_effects]:
            after = _Known(_after(effects, begun), initial, changing)
            least = 0.0 if evaluate(problem.goal, after) is True else index.least(after.facts)
            if least == inf:
                return f"{about}: there is no entry for what {effects} may lead to"
            nearest = min(nearest, least)
        if nearest >= rule.expected:
            return f"{about}: none of its outcomes comes nearer to the goal"
    return ""


def _after(effects: Effects, state: _Known) -> dict[Fluent, Value | Unknown]:
    """Return what is known after the effects: a change under an unknown condition leaves a fact unknown, unless it was so before."""
    sure: dict[Fluent, set[Value | Unknown]] = defaultdict(set)
    possible: dict[Fluent, set[Value | Unknown]] = defaultdict(set)
    for fluent, value, truth in _changes(effects, state, NOTHING, True):
        (sure if truth is True else possible)[fluent].add(value)
    after = dict(state.facts)
    for fluent in {**sure, **possible}:
        if True in sure[fluent]:
            after[fluent] = True
        elif sure[fluent] | possible[fluent] == {False} and (sure[fluent] or state.value(fluent) is False):
            after[fluent] = False
        elif sure[fluent] or possible[fluent] != {state.value(fluent)}:
            after[fluent] = UNKNOWN
    return after


def _changes(effects: Effects, state: State, env: Environment, truth: Truth) -> Iterator[tuple[Fluent, Value | Unknown, Truth]]:
    """Yield every change that may happen, with whether it does."""
    for effect in effects:
        match effect:
            case Set(fluent, value):
                yield bind(fluent, env), value_of(value, state, env), truth
            case When(condition, inner):
                holds = evaluate(condition, state, env)
                if holds is not False:
                    yield from _changes(inner, state, env, truth if holds is True else UNKNOWN)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from _changes(inner, state, chosen, truth)
            case OneOf():
                raise AssertionError("outcomes are looked at one by one")
            case _:
                assert_never(effect)


class _Index:
    """The entries, each found by the fact that the fewest others name."""

    def __init__(self, rules: Iterable[PolicyRule]) -> None:
        count = Counter(fact for rule in rules for fact in rule.facts.items())
        self.mentioned = dict.fromkeys(fluent for fluent, _ in count)
        self._always = min((rule.expected for rule in rules if not rule.facts), default=inf)
        self._filed: dict[tuple[Fluent, bool], list[tuple[frozenset[tuple[Fluent, bool]], float]]] = defaultdict(list)
        for rule in rules:
            if rule.facts:
                rarest = min(rule.facts.items(), key=lambda fact: count[fact])
                self._filed[rarest].append((frozenset(rule.facts.items()), rule.expected))

    def least(self, facts: Mapping[Fluent, Value | Unknown]) -> float:
        """Return the fewest expected actions of the entries that fit whenever these facts are so; infinity if none does."""
        known = {(fluent, value) for fluent, value in facts.items() if isinstance(value, bool)}
        fitting = (expected for fact in known for needed, expected in self._filed.get(fact, ()) if needed <= known)
        return min(fitting, default=self._always)
