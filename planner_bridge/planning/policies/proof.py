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
from collections.abc import Mapping, Sequence
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
    proof = _Proof(problem, rules, initial, ends)
    return next(filter(None, (proof.fault, *(fault for fault, _ in map(proof.entry, range(len(rules)))))), "")


def proved_places(
    problem: Problem, rules: Sequence[PolicyRule], initial: KnowledgeBase, ends: Mapping[Fluent, Range] = NO_ENDS
) -> list[int] | None:
    """Return the places of entries that are proved to reach the goal without the others; None if there are none.

    These are all of them, or else those that the initial state leads to: of what was found beside the way, less may be known.
    """
    if not unproved(problem, rules, initial, ends):
        return [*range(len(rules))]
    proof = _Proof(problem, rules, initial, ends)
    waiting = [*proof.first]
    for place in waiting:
        fault, then = proof.entry(place)
        if fault:
            return None
        waiting += [after for after in dict.fromkeys(then) if after not in waiting]
    return None if proof.fault else sorted(waiting)


class _Proof:
    """What is checked of a policy.

    Args:
        rules: its entries.
        ends: ranges that numbers are not to leave.
    """

    def __init__(self, problem: Problem, rules: Sequence[PolicyRule], initial: KnowledgeBase, ends: Mapping[Fluent, Range]) -> None:
        self._problem, self._rules, self._initial, self._ends = problem, rules, initial, ends
        self._changing, self._index, domain = dynamic_names(problem), _Index(rules), problem.domain
        declared = {**domain.predicates, **domain.functions}
        self._always = {fluent: value for fluent, value in initial.facts().items() if fluent[0] not in self._changing}
        for name in self._changing & domain.rules.below:
            for chosen in product(*(initial.objects(variable.types) for variable in declared[name].parameters)):
                self._always[name, *chosen] = UNKNOWN

        facts = {fluent: UNKNOWN if fluent in problem.unknown else bool(initial.value(fluent)) for fluent in self._index.mentioned}
        mentioned = {*ends, *(fluent for rule in rules for fluent in rule.numbers)}
        numbers = {fluent: (value, value) for fluent in mentioned if is_number(value := initial.value(fluent))}
        state, is_over = self._known(facts, numbers), evaluate(problem.goal, initial) is True
        place = None if is_over else self._index.place(state)
        self.first: list[int] = [] if place is None else [place]
        """The place of the entry for the initial state, if it is not the goal."""
        self.fault = ""
        """What cannot be proved of the initial state."""
        if unknown := sorted(fluent_text(fluent) for fluent in problem.unknown if fluent[0] not in self._changing):
            self.fault = f"it is unknown whether {unknown[0]}"
        elif not is_over and (place is None or not all(map(state.is_within, ends.items()))):
            self.fault = "there is no entry for the initial state"

    def _known(self, facts: Mapping[Fluent, Value | Unknown], numbers: Mapping[Fluent, Range]) -> _Ranges:
        rules, always = self._problem.domain.rules, self._initial
        constant = DerivedFacts(rules, {**self._always, **facts}, always.objects) if rules else always
        return _Ranges(facts, constant, self._changing, numbers)

    def entry(self, place: int) -> tuple[str, list[int]]:
        """Return what cannot be proved of an entry, or nothing; and the places of those that its outcomes lead to."""
        problem, rule, then = self._problem, self._rules[place], list[int]()
        about = f"entry {place + 1}, {rule.action}({', '.join(rule.arguments)})"
        if rule.expected < self._rules[max(place - 1, 0)].expected:
            return f"{about}: the entry before it counts first, and costs more", then
        duration = modelled_duration(problem.domain.actions[rule.action], rule.arguments, self._initial)
        action = ground_step(problem.domain, rule.action, rule.arguments, duration, "", problem.members)
        numbers = dict(rule.numbers)
        for fluent, (least, greatest) in self._ends.items():
            low, high = numbers.get(fluent, ANY_NUMBER)
            numbers[fluent] = max(low, least), min(high, greatest)
        state = self._known(rule.facts, numbers)
        if state.truth(action.precondition) is not True:
            return f"{about}: {action.precondition} need not hold", then
        begun = self._known(*_after(action.start_effects, state))
        for condition in (action.invariant, action.end_condition):
            if begun.truth(condition) is not True:
                return f"{about}: {condition} need not hold", then
        nearest = inf
        for effects in [way.effects for way in action.outcomes] or [action.end_effects]:
            after = self._known(*_after(effects, begun))
            if not all(map(after.is_within, self._ends.items())):
                return f"{about}: a number may leave its range", then
            if after.truth(problem.goal) is True:
                nearest = 0.0
            elif (at := self._index.place(after)) is None:
                return f"{about}: there is no entry for what {effects} may lead to", then
            else:
                then.append(at)
                nearest = min(nearest, self._rules[at].expected)
        return ("" if nearest < rule.expected else f"{about}: none of its outcomes comes nearer to the goal"), then


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

    def __init__(self, rules: Sequence[PolicyRule]) -> None:
        count = Counter(fact for rule in rules for fact in rule.facts.items())
        self.mentioned = dict.fromkeys(fluent for fluent, _ in count)
        self._filed: dict[tuple[Fluent, bool] | None, list[tuple[frozenset[tuple[Fluent, bool]], int, PolicyRule]]] = defaultdict(list)
        for place, rule in enumerate(rules):
            rarest = min(rule.facts.items(), key=lambda fact: count[fact], default=None)
            self._filed[rarest].append((frozenset(rule.facts.items()), place, rule))

    def place(self, state: _Ranges) -> int | None:
        """Return the place of the first entry that fits wherever this is known; None if none does."""
        known = {(fluent, value) for fluent, value in state.facts.items() if isinstance(value, bool)}
        fitting = ((place, rule) for fact in (None, *known) for needed, place, rule in self._filed.get(fact, ()) if needed <= known)
        return min((place for place, rule in fitting if all(map(state.is_within, rule.numbers.items()))), default=None)
