"""Effects: the changes that an action makes to a state.

Effects are simultaneous: every condition and every right-hand side is evaluated in the
state before, and a fact both deleted and added is added (PDDL 2.1, section 8).

An action may turn out in several ways: `OneOf`. What happens is then one of its `outcomes`, and only that has `changes`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import isclose, prod
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.conditions import Condition, Count, choices_in, evaluate, fluents, ground
from pnm.core.logic.expressions import (
    NOTHING,
    UNKNOWN,
    Constant,
    Environment,
    Expression,
    Fluent,
    State,
    Truth,
    Unknown,
    Value,
    Variable,
    absent_value,
    bind,
    choices,
    expression_fluents,
    fluent_text,
    ground_expression,
    hidden,
    is_number,
    same_value,
    value_of,
)
from pnm.errors import InputError

_ARITHMETIC: Final[dict[str, Callable[[float, float], float]]] = {
    "increase": operator.add,
    "decrease": operator.sub,
    "scale-up": operator.mul,
    "scale-down": operator.truediv,
}
OPERATIONS: Final = ("assign", *_ARITHMETIC)


@dataclass(frozen=True, slots=True)
class Set:
    """A fact becomes true or false (`assign` of a truth value), or a fluent gets a new value."""

    fluent: Fluent
    value: Expression
    operation: str = "assign"

    def __str__(self) -> str:
        if self.value == Constant(True):
            return fluent_text(self.fluent)
        if self.value == Constant(False):
            return f"(not {fluent_text(self.fluent)})"
        return f"({self.operation} {fluent_text(self.fluent)} {self.value})"


@dataclass(frozen=True, slots=True)
class When:
    """The effects happen if the condition holds in the state before."""

    condition: Condition
    effects: Effects
    early: bool = False
    """Of an effect at the end of an action: its condition is decided in the state the action starts in."""

    def __str__(self) -> str:
        return f"(when {self.condition} {effects_text(self.effects)})"


@dataclass(frozen=True, slots=True)
class ForEach:
    """The effects happen for every choice of objects for the variables."""

    variables: tuple[Variable, ...]
    effects: Effects

    def __str__(self) -> str:
        return f"(forall ({' '.join(map(str, self.variables))}) {effects_text(self.effects)})"


@dataclass(frozen=True, slots=True)
class Alternative:
    """A way in which effects may turn out."""

    effects: Effects = ()
    chance: float | None = None
    """From 0 to 1; None where nothing is known, and then each is taken to be as likely as the others."""
    name: str = ""


@dataclass(frozen=True, slots=True)
class OneOf:
    """The effects of one of the alternatives happen, and nobody decides which (`oneof` and `probabilistic` of PDDL).

    Either all of them have a chance, and these sum to 1, or none has.
    """

    alternatives: tuple[Alternative, ...]

    @property
    def effects(self) -> Effects:
        """The effects of all alternatives."""
        return tuple([effect for way in self.alternatives for effect in way.effects])

    def __str__(self) -> str:
        parts = (f"{'' if way.chance is None else f'{way.chance:g} '}{effects_text(way.effects)}" for way in self.alternatives)
        return f"({' '.join((self.word, *parts))})"

    @property
    def word(self) -> str:
        """The word of PDDL for it."""
        return "oneof" if any(way.chance is None for way in self.alternatives) else "probabilistic"


Effect: TypeAlias = Set | When | ForEach | OneOf
Effects: TypeAlias = tuple[Effect, ...]
Changes: TypeAlias = dict[Fluent, Value | Unknown]
Judge: TypeAlias = Callable[[Condition, Environment], Truth]
"""Returns whether a condition holds."""


@dataclass(frozen=True, slots=True)
class TimedChange:
    """Facts and numbers that change by themselves at a time, in seconds: timed initial literals and fluents (PDDL 2.2)."""

    time: float
    changes: Mapping[Fluent, Value]


def effects_text(effects: Effects) -> str:
    """Return the PDDL text of effects, as one effect."""
    return str(effects[0]) if len(effects) == 1 else f"({' '.join(('and', *map(str, effects)))})"


def changes(effects: Effects, state: State, env: Environment = NOTHING) -> Changes:
    """Return the new value of every fluent the effects set, computed in the state before."""
    if not env and (constant := constants(effects)) is not None:
        return constant
    result: Changes = {}
    for fluent, effect, inner in assignments(effects, state, env):
        value = value_of(effect.value, state, inner)
        if value is False and fluent in result:
            continue  # delete-then-add of the same fact adds, whichever is written first
        if effect.operation == "assign":
            result[fluent] = value
        else:
            before = result.get(fluent, state.value(fluent))
            result[fluent] = UNKNOWN
            if is_number(before) and is_number(value) and (value or effect.operation != "scale-down"):
                result[fluent] = _ARITHMETIC[effect.operation](before, value)
    return result


def constants(effects: Effects) -> Changes | None:
    """Return the result of `changes` in every state, if the effects only assign constants; None if there are others."""
    result: Changes = {}
    for effect in effects:
        if not isinstance(effect, Set) or effect.operation != "assign" or not isinstance(effect.value, Constant):
            return None
        if effect.value.value is not False or effect.fluent not in result:
            result[effect.fluent] = effect.value.value
    return result


def every_effect(effects: Effects) -> Iterator[Effect]:
    """Yield the effects and all effects in them, outer ones first."""
    for effect in effects:
        yield effect
        if not isinstance(effect, Set):
            yield from every_effect(effect.effects)


def choices_in_effects(effects: Effects, count: Count, around: int = 0) -> int:
    """Return the number of facts, comparisons and changes when quantifiers are written out; see `choices_in`."""
    total = 0
    for effect in effects:
        match effect:
            case Set():
                total += around
            case When(condition, inner):
                total += choices_in(condition, count, around) + choices_in_effects(inner, count, around)
            case ForEach(variables, inner):
                total += choices_in_effects(inner, count, max(1, around) * prod(count(variable.types) for variable in variables))
            case OneOf():
                total += choices_in_effects(effect.effects, count, around)
            case _:
                assert_never(effect)
    return total


def expanded(
    effects: Effects, state: State, env: Environment = NOTHING, judge: Judge | None = None, truth: Truth = True
) -> Iterator[tuple[Set | When, Environment, Truth]]:
    """Yield every `Set` and `When` at any depth, once for every choice of objects, with its environment and whether it happens.

    Args:
        judge: says of conditions whether they hold: what is under others is left out, and which alternative it is must be decided
            before. By default all hold.
    """
    for effect in effects:
        match effect:
            case Set():
                yield effect, env, truth
            case When(condition, inner):
                yield effect, env, truth
                holds = judge is None or judge(condition, env)
                if holds is not False:
                    yield from expanded(inner, state, env, judge, truth if holds is True else UNKNOWN)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from expanded(inner, state, chosen, judge, truth)
            case OneOf():
                assert judge is None, f"one of the outcomes happens, and none was chosen: {effect}"
                yield from expanded(effect.effects, state, env)
            case _:
                assert_never(effect)


def decided(effects: Effects, state: State, is_due: Callable[[When], bool] = operator.attrgetter("early")) -> Effects:
    """Return the effects with those conditions decided that are due: of the end of an action that starts in the state, the early ones."""
    if not any(is_due(part) for part in every_effect(effects) if isinstance(part, When)):
        return effects
    return tuple(_decided(effects, state, is_due, NOTHING))


def _decided(effects: Effects, state: State, is_due: Callable[[When], bool], env: Environment) -> Iterator[Effect]:
    for effect in effects:
        match effect:
            case Set():
                yield from ground_effects((effect,), env)
            case When(condition, inner, early):
                if not is_due(effect):
                    yield When(ground(condition, env), tuple(_decided(inner, state, is_due, env)), early)
                elif evaluate(condition, state, env) is True:
                    yield from _decided(inner, state, is_due, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from _decided(inner, state, is_due, chosen)
            case OneOf(alternatives):
                yield OneOf(tuple([replace(way, effects=tuple(_decided(way.effects, state, is_due, env))) for way in alternatives]))
            case _:
                assert_never(effect)


def is_early(effect: Effect) -> bool:
    """Return whether some condition in the effect is decided before it happens."""
    return not isinstance(effect, Set) and any(isinstance(part, When) and part.early for part in every_effect((effect,)))


def assignments(effects: Effects, state: State, env: Environment = NOTHING) -> Iterator[tuple[Fluent, Set, Environment]]:
    """Yield each `Set` that happens in the state, with its ground fluent and its environment."""
    return _sets(expanded(effects, state, env, lambda condition, inner: evaluate(condition, state, inner) is True))


def possible_assignments(effects: Effects, state: State) -> Iterator[tuple[Fluent, Set, Environment]]:
    """Yield the assignments as if every condition of the effects held."""
    return _sets(expanded(effects, state))


def _sets(effects: Iterable[tuple[Set | When, Environment, Truth]]) -> Iterator[tuple[Fluent, Set, Environment]]:
    return ((bind(effect.fluent, env), effect, env) for effect, env, _ in effects if isinstance(effect, Set))


def written(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent the effects may set, whether or not their conditions hold."""
    if (constant := constants(effects)) is not None:
        return frozenset(constant)
    return frozenset([fluent for fluent, _, _ in possible_assignments(effects, state)])


def names_written(effects: Effects) -> frozenset[str]:
    """Return the predicates and functions the effects may change."""
    return frozenset(effect.fluent[0] for effect in every_effect(effects) if isinstance(effect, Set))


def read(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that the effects read when they happen: in their conditions and right-hand sides."""
    if constants(effects) is not None:
        return frozenset()
    reads: set[Fluent] = set()
    for effect, env, _ in expanded(effects, state):
        match effect:
            case Set(fluent, value, operation):
                reads.update(expression_fluents(value, env))
                if operation != "assign":
                    reads.add(bind(fluent, env))
            case When(condition, _, early):
                if not early:
                    reads |= fluents(condition, state, env)
            case _:
                assert_never(effect)
    return frozenset(reads)


def read_early(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that end effects read when the action starts: in their early conditions."""
    if all(isinstance(effect, Set) for effect in effects):
        return frozenset()
    early = ((effect.condition, env) for effect, env, _ in expanded(effects, state) if isinstance(effect, When) and effect.early)
    return frozenset(fluent for condition, env in early for fluent in fluents(condition, state, env))


def ground_effects(effects: Effects, env: Environment) -> Effects:
    """Substitute the environment's values for the variables; quantified variables stay."""
    result: list[Effect] = []
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                result.append(Set(bind(fluent, env), ground_expression(value, env), operation))
            case When(condition, inner, early):
                result.append(When(ground(condition, env), ground_effects(inner, env), early))
            case ForEach(variables, inner):
                result.append(ForEach(variables, ground_effects(inner, hidden(env, variables))))
            case OneOf(alternatives):
                result.append(OneOf(tuple([replace(way, effects=ground_effects(way.effects, env)) for way in alternatives])))
            case _:
                assert_never(effect)
    return tuple(result)


def values_before(after: Changes, state: State) -> Changes:
    """Return the old values of fluents that are about to change; an absent one is false, undefined, or an unknown number."""
    before: Changes = {}
    for fluent, new in after.items():
        old = state.value(fluent)
        before[fluent] = absent_value(new) if old is None else old
    return before


def undo(before: Changes, after: Changes, now: State) -> Changes:
    """Return the changes that roll `after` back: to the old values of fluents that were not written again since.

    A number that has changed since is moved back by the difference the effect made.
    """
    result: Changes = {}
    for fluent, value in after.items():
        current, old = now.value(fluent), before[fluent]
        if same_value(current, value):
            result[fluent] = old
        elif is_number(current) and is_number(old) and is_number(value):
            result[fluent] = current - (value - old)
    return result


def is_fixed(effect: Effect) -> bool:
    """Return whether the effect assigns the same values in every state: it has no condition and reads nothing."""
    if isinstance(effect, ForEach):
        return all(map(is_fixed, effect.effects))
    return isinstance(effect, Set) and effect.operation == "assign" and isinstance(effect.value, Constant)


def facts(effects: Iterable[Effect], state: State) -> Changes | None:
    """Return the truth values and objects that the effects assign in any state; None if they depend on it, or assign numbers."""
    flat = tuple(effects)
    if not all(map(is_fixed, flat)):
        return None
    assigned = changes(flat, state)
    return None if any(map(is_number, assigned.values())) else assigned


# --- outcomes -------------------------------------------------------------------------------------

CHANCES_MISS: Final = 1e-6
"""The amount by which chances may miss 1 in sum: people write 0.333333 for a third."""
MAX_OUTCOMES: Final = 64
"""Outcomes of one action at most."""


def has_outcomes(effects: Effects) -> bool:
    """Return whether the effects may turn out in several ways."""
    return any(not isinstance(effect, Set) and (isinstance(effect, OneOf) or has_outcomes(effect.effects)) for effect in effects)


def outcomes(effects: Effects, state: State) -> tuple[Alternative, ...]:
    """Return every way in which the effects may turn out, none of them with a `OneOf` in it; one for effects without any.

    Those of several `OneOf` are combined; one inside a `ForEach` is there for every choice of objects, one inside a `When` happens under
    its condition. Equal ones are one, as likely as they are together, and those that cannot come about are left out. Their chances
    are None if none is declared and all are as likely. An alternative without a name is called by its number, from 1 on; combined
    ones by both names, such as ``slipped+2``.

    Raises an `InputError` for more than `MAX_OUTCOMES`.
    """
    if not has_outcomes(effects):
        return (Alternative(effects),)
    ways = _ways(effects, state)
    parts = (effect for effect in every_effect(effects) if isinstance(effect, OneOf))
    is_told = any(way.chance is not None for part in parts for way in part.alternatives)
    if is_told or not all(isclose(chance, ways[0][1]) for _, chance, _ in ways):
        return tuple([Alternative(*way) for way in ways])
    return tuple([Alternative(happening, None, name) for happening, _, name in ways])


def _ways(effects: Effects, state: State) -> list[tuple[Effects, float, str]]:
    """Return the outcomes: what happens, how likely it is, its name."""
    found: list[tuple[Effects, float, str]] = [((), 1.0, "")]
    for effect in effects:
        match effect:
            case OneOf(alternatives):
                even = 1.0 / len(alternatives)
                ways = [
                    (inner, (even if way.chance is None else way.chance) * chance, "+".join(filter(None, (way.name or str(number), name))))
                    for number, way in enumerate(alternatives, 1)
                    for inner, chance, name in _ways(way.effects, state)
                ]
            case When(condition, inner, early) if has_outcomes(inner):
                ways = [((When(condition, then, early),) if then else (), chance, name) for then, chance, name in _ways(inner, state)]
            case ForEach(variables, inner) if has_outcomes(inner):
                every = [ground_effects(inner, chosen) for chosen in choices(variables, state, NOTHING)]
                ways = _ways(tuple([one for body in every for one in body]), state)
            case _:
                ways = [((effect,), 1.0, "")]
        merged: dict[object, tuple[Effects, float, str]] = {}
        for (before, likely, first), (after, chance, second) in product(found, ways):
            both, name = (*before, *after), "+".join(filter(None, (first, second)))
            if is_plain := constants(both) is not None:
                both = tuple(dict.fromkeys(both))
            # those that only their numbers tell apart are one
            same = frozenset(both) if is_plain else both, tuple([part for part in name.split("+") if not part.isdigit()])
            known = merged.get(same, (both, 0.0, name))
            merged[same] = known[0], known[1] + likely * chance, known[2]
        found = [way for way in merged.values() if way[1]]
        if len(found) > MAX_OUTCOMES:
            raise InputError(f"an action may turn out in more than {MAX_OUTCOMES} ways; expected {MAX_OUTCOMES} at most")
    return found
