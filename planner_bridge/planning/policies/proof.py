"""The proof that a policy reaches the goal, whatever the outcomes, if every outcome comes up sooner or later.

Three conditions are checked on the entries alone, by the meaning of actions for states of which only those facts are known that an
entry names, and of numbers the ranges that it gives; derived facts are those that follow from these, and unknown otherwise:

1. Where an entry fits, its action can be carried out.
2. Each of its outcomes leads to the goal, or to where some entry fits.
3. One of them leads to the goal, or to an entry with a smaller expected cost.

Entries stand in the order of their expected costs, so that the first one that fits, which counts, has the least. By the third, it has a
way on which that becomes smaller and smaller, and there are finitely many entries; by the second, whatever happens instead, there is such
a way again. How the policy was found does not matter.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, isnan
from typing import Final, Protocol

from planner_bridge.model.grounding import dynamic_names, ground_step, modelled_duration
from planner_bridge.model.problem import Problem
from planner_bridge.planning.policies.numbers import ANY_NUMBER, PartlyKnown, Range
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TOLERANCE, Compare, Computed, Condition, Holds, evaluate, negate, parts_of
from pnm.core.logic.derived_facts import DerivedFacts
from pnm.core.logic.effects import Effects, Set, expanded
from pnm.core.logic.expressions import (
    NOTHING,
    UNKNOWN,
    Arithmetic,
    Constant,
    Environment,
    Expression,
    Fluent,
    Truth,
    Unknown,
    Value,
    ValueOf,
    bind,
    fluent_text,
    is_number,
    value_of,
)

NO_ENDS: Final[Mapping[Fluent, Range]] = {}
_OPERATIONS: Final = {"increase": "+", "decrease": "-", "scale-up": "*", "scale-down": "/"}


class PolicyRule(Protocol):
    """An entry of a policy."""

    @property
    def facts(self) -> Mapping[Fluent, bool]:
        """The facts that have to be so."""

    @property
    def numbers(self) -> Mapping[Fluent, Range]:
        """The ranges in which numbers have to be."""

    @property
    def action(self) -> str:
        """The action."""

    @property
    def arguments(self) -> tuple[str, ...]:
        """Its objects."""

    @property
    def expected(self) -> float:
        """The expected cost until the goal."""


@dataclass(frozen=True, slots=True)
class _Ranges(PartlyKnown):
    """A state of which, besides, the ranges of numbers are known."""

    numbers: Mapping[Fluent, Range]

    def of(self, expression: Expression, env: Environment) -> Range | None:
        """Return the range of an expression; None if nothing is known, or it is no number."""
        if isinstance(expression, ValueOf) and (fluent := bind(expression.fluent, env))[0] in self.changing:
            return self.numbers.get(fluent, ANY_NUMBER)
        if isinstance(expression, Arithmetic):
            return self.computed(expression.operation, [self.of(operand, env) for operand in expression.operands])
        value = value_of(expression, self, env)
        return (value, value) if is_number(value) else None

    def is_within(self, needed: tuple[Fluent, Range]) -> bool:
        """Whether a number is in this range for sure."""
        fluent, (least, greatest) = needed
        low, high = self.numbers.get(fluent, ANY_NUMBER)
        return low >= least - TOLERANCE and high <= greatest + TOLERANCE

    def computed(self, operation: str, ranges: Sequence[Range | None]) -> Range | None:
        """Return the range of what is computed from numbers in these ranges: its least and greatest values are at their ends."""
        known = [one for one in ranges if one is not None]
        if len(known) < len(ranges) or (operation == "/" and any(low <= 0.0 <= high for low, high in known[1:])):
            return None
        corners = [value_of(Arithmetic(operation, tuple(map(Constant, corner))), self) for corner in product(*known)]
        numbers = [corner for corner in corners if is_number(corner) and not isnan(corner)]
        return (min(numbers), max(numbers)) if len(numbers) == len(corners) else None

    def truth(self, condition: Condition, env: Environment = NOTHING) -> Truth:
        """Return whether a condition holds; unknown if it depends on what is not known."""
        if not self.numbers:
            return evaluate(condition, self, env)
        if isinstance(condition, Compare):
            left, right = self.of(condition.left, env), self.of(condition.right, env)
            if left is None or right is None:
                return evaluate(condition, self, env)
            corners = [(Constant(one), Constant(other)) for one, other in product(left, right)]
            found = {way: {evaluate(Compare(way, *pair), self) for pair in corners} for way in (condition.operation, "<", ">")}
            truths = found[condition.operation]
            if condition.operation == "=" and truths == {False} and {True} not in (found["<"], found[">"]):
                return UNKNOWN  # between the ends
            return UNKNOWN if len(truths) > 1 else truths.pop()
        if isinstance(condition, Holds | Computed):
            return evaluate(condition, self, env)
        parts, is_every = parts_of(condition, self, env)
        every = [truth if is_so else negate(truth) for part, inner, is_so in parts for truth in (self.truth(part, inner),)]
        decisive = not is_every
        return decisive if decisive in every else UNKNOWN if UNKNOWN in every else is_every


def unproved(problem: Problem, rules: Sequence[PolicyRule], initial: KnowledgeBase, ends: Mapping[Fluent, Range] = NO_ENDS) -> str:
    """Return what cannot be proved of the policy in the initial state, with the entry; empty if it reaches the goal.

    Args:
        ends: ranges that numbers never leave, which is proved as well.
    """
    changing, index, domain = dynamic_names(problem), _Index(rules), problem.domain
    declared = {**domain.predicates, **domain.functions}
    always = {fluent: value for fluent, value in initial.facts().items() if fluent[0] not in changing}
    for name in changing & domain.rules.below:
        for chosen in product(*(initial.objects(variable.types) for variable in declared[name].parameters)):
            always[name, *chosen] = UNKNOWN

    if unknown := sorted(fluent_text(fluent) for fluent in problem.unknown if fluent[0] not in changing):
        return f"it is unknown whether {unknown[0]}"

    def known(facts: Mapping[Fluent, Value | Unknown], numbers: Mapping[Fluent, Range]) -> _Ranges:
        constant = DerivedFacts(domain.rules, {**always, **facts}, initial.objects) if domain.rules else initial
        return _Ranges(facts, constant, changing, numbers)

    facts = {fluent: UNKNOWN if fluent in problem.unknown else bool(initial.value(fluent)) for fluent in index.mentioned}
    mentioned = {*ends, *(fluent for rule in rules for fluent in rule.numbers)}
    numbers = {fluent: (value, value) for fluent in mentioned if is_number(value := initial.value(fluent))}
    first = known(facts, numbers)
    if evaluate(problem.goal, initial) is not True and (index.least(first) == inf or not all(map(first.is_within, ends.items()))):
        return "there is no entry for the initial state"
    for number, rule in enumerate(rules, 1):
        about = f"entry {number}, {rule.action}({', '.join(rule.arguments)})"
        if rule.expected < rules[max(number - 2, 0)].expected:
            return f"{about}: the entry before it counts first, and costs more"
        duration = modelled_duration(domain.actions[rule.action], rule.arguments, initial)
        action = ground_step(domain, rule.action, rule.arguments, duration, "", problem.members)
        numbers = dict(rule.numbers)
        for fluent, (least, greatest) in ends.items():
            low, high = numbers.get(fluent, ANY_NUMBER)
            numbers[fluent] = max(low, least), min(high, greatest)
        state = known(rule.facts, numbers)
        if state.truth(action.precondition) is not True:
            return f"{about}: {action.precondition} need not hold"
        begun = known(*_after(action.start_effects, state))
        for condition in (action.invariant, action.end_condition):
            if begun.truth(condition) is not True:
                return f"{about}: {condition} need not hold"
        nearest = inf
        for effects in [way.effects for way in action.outcomes] or [action.end_effects]:
            after = known(*_after(effects, begun))
            if not all(map(after.is_within, ends.items())):
                return f"{about}: a number may leave its range"
            least = 0.0 if after.truth(problem.goal) is True else index.least(after)
            if least == inf:
                return f"{about}: there is no entry for what {effects} may lead to"
            nearest = min(nearest, least)
        if nearest >= rule.expected:
            return f"{about}: none of its outcomes comes nearer to the goal"
    return ""


def _after(effects: Effects, state: _Ranges) -> tuple[dict[Fluent, Value | Unknown], dict[Fluent, Range]]:
    """Return what is known after the effects: a change under an unknown condition leaves a fact unknown, unless it was so before."""
    sure: dict[Fluent, set[Value | Unknown]] = defaultdict(set)
    possible: dict[Fluent, set[Value | Unknown]] = defaultdict(set)
    numbers = dict(state.numbers)
    for effect, env, truth in expanded(effects, state, judge=state.truth):
        if not isinstance(effect, Set):
            continue
        fluent, value = bind(effect.fluent, env), value_of(effect.value, state, env)
        if effect.operation == "assign" and not is_number(value):
            (sure if truth is True else possible)[fluent].add(value)
        if isinstance(value, bool | str):
            continue
        before, new = numbers.get(fluent, ANY_NUMBER), state.of(effect.value, env)
        if effect.operation != "assign":
            new = state.computed(_OPERATIONS[effect.operation], (before, new))
        low, high = ANY_NUMBER if new is None else new
        numbers[fluent] = (low, high) if truth is True else (min(low, before[0]), max(high, before[1]))
    numbers = {fluent: one for fluent, one in numbers.items() if one != ANY_NUMBER}
    after = dict(state.facts)
    for fluent in {**sure, **possible}:
        if True in sure[fluent]:
            after[fluent] = True
        elif sure[fluent] | possible[fluent] == {False} and (sure[fluent] or state.value(fluent) is False):
            after[fluent] = False
        elif sure[fluent] or possible[fluent] != {state.value(fluent)}:
            after[fluent] = UNKNOWN
    return after, numbers


class _Index:
    """The entries, each found by the fact that the fewest others name."""

    def __init__(self, rules: Iterable[PolicyRule]) -> None:
        count = Counter(fact for rule in rules for fact in rule.facts.items())
        self.mentioned = dict.fromkeys(fluent for fluent, _ in count)
        self._filed: dict[tuple[Fluent, bool] | None, list[tuple[frozenset[tuple[Fluent, bool]], PolicyRule]]] = defaultdict(list)
        for rule in rules:
            rarest = min(rule.facts.items(), key=lambda fact: count[fact], default=None)
            self._filed[rarest].append((frozenset(rule.facts.items()), rule))

    def least(self, state: _Ranges) -> float:
        """Return the least expected cost of the entries that fit wherever this is known; infinity if none does."""
        known = {(fluent, value) for fluent, value in state.facts.items() if isinstance(value, bool)}
        fitting = (rule for fact in (None, *known) for needed, rule in self._filed.get(fact, ()) if needed <= known)
        return min((rule.expected for rule in fitting if all(map(state.is_within, rule.numbers.items()))), default=inf)
