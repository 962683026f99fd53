"""Readers of conditions, expressions, effects and durations: from YAML to `pnm.core.logic`, every shape of them.

Conditions over facts, functions and objects alone become PDDL's own kinds; those over variables are `Computed`. An effect on facts and
functions is applied. A test of variables, which action servers write, is an expected condition: it should hold once the action is done.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from pnm.core.logic.computed_values import Layer, Parameter, Query, parts
from pnm.core.logic.conditions import (
    TRUE,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    ForAll,
    Holds,
    Implies,
    Not,
    choices_in,
    conjunction,
    data_in,
)
from pnm.core.logic.domain import DurationConstraint, check_choices
from pnm.core.logic.effects import CHANCES_MISS, OPERATIONS, Alternative, Effect, Effects, ForEach, OneOf, Set, When, choices_in_effects
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Expression, ValueOf, Variable, leaves
from pnm.errors import InputError
from pnm.files.yaml_keys import Keys, needed, node, number, pair, ref, text, written
from pnm.files.yaml_nodes import Node
from pnm.language.formulas import words
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, is_variable, read_fluent, read_typed, shown
from pnm.language.formulas.words import comparison_parts, operation_parts, read_form

FALSE: Final = Any(())
_NAME: Final = re.compile(r"\??[^\s()?]+\Z")
_OUTCOME: Final = re.compile(r"[A-Za-z_][\w-]*")
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\Z")
_OPERANDS: Final = {"-": range(1, 3), "/": range(2, 3)}
"""The number of operands of arithmetic; the others take any number from 2."""


class Quantified(Keys):
    """A condition on all objects of some types, or on some of them."""

    variables = needed(ref("typed"), "variables and their types: ?x ?y - block")
    body = needed(words.CONDITION, "the condition on them").named("condition")


def read_condition(node: Node, scope: FormulaScope = ANYTHING) -> Condition:
    """Read a condition."""
    if node.items is not None:
        return conjunction(read_condition(item, scope) for item in node.items)
    if node.is_mapping:
        return TRUE if not node.mapped().nodes else _condition(words.needed_form(node, words.TESTS, "a condition"), scope)
    if node.text is not None and is_variable(node.text) and not scope.strict:
        scope.check_variable(node.text, node)
        return Computed(Parameter(node.text))
    if node.text is None and isinstance(node.plain(), bool):
        return TRUE if node.plain() else FALSE
    if node.text is None or fluent_in(node.text) is None:
        raise node.wrong(f"expected a condition, such as (at ?r kitchen) or {{Exists: [Query: name]}}, found {shown(node)}")
    return Holds(read_fluent(node, scope, "predicate"))


def _condition(construct: words.Form, scope: FormulaScope) -> Condition:
    argument = construct.argument
    match construct.word:
        case "and":
            return conjunction(read_condition(operand, scope) for operand in construct.argument.each)
        case "or":
            return Any(tuple(read_condition(operand, scope) for operand in construct.argument.each))
        case "not":
            return Not(read_condition(construct.items(1)[0], scope))
        case "imply":
            left, right = construct.items(2)
            return Implies(read_condition(left, scope), read_condition(right, scope))
        case "holds":
            return Holds(read_fluent(construct.items(1)[0], scope, "predicate"))
        case "forall" | "exists" as word if word == "forall" or (argument.is_mapping and words.form(argument, words.QUERIES) is None):
            variables, body = read_quantified(Quantified(argument.mapped()), scope)
            condition = (ForAll if word == "forall" else Exists)(variables, read_condition(body, scope.inside(variables)))
            check_choices(choices_in(condition, scope.declared.count), construct.position)
            return condition
        case "comparison":
            return _comparison(construct, *comparison_parts(construct), scope)
        case "operation" if len(operation_parts(construct)[1]) == 2:
            operator, (left, right) = operation_parts(construct)
            return _comparison(construct, operator, left, right, scope)
        case _ if scope.strict:
            raise InputError(f"PDDL has no {construct.written!r}: it knows facts and functions, not variables", construct.position)
        case _:
            return Computed(read_form(construct, scope))


def read_quantified(keys: Quantified, scope: FormulaScope) -> tuple[tuple[Variable, ...], Node]:
    """Return the variables of a quantifier, and its body."""
    return read_typed(keys.variables, scope), keys.body


# --- comparisons ---------------------------------------------------------------------------


def _comparison(construct: words.Form, operator: Node, left: Node, right: Node, scope: FormulaScope) -> Condition:
    """Compare numbers or objects as PDDL does if both sides are of its kinds, and any values else."""
    name = words.read_operator(operator)
    if scope.strict:  # two numbers, or two objects for equality, as planners do
        if name not in words.COMPARISONS:
            raise operator.wrong(f"PDDL does not compare with {shown(operator)}; expected one of {', '.join(words.COMPARISONS.values())}")
        left_value, right_value = read_expression(left, scope), read_expression(right, scope)
        if scope.is_object(left_value) != scope.is_object(right_value):
            raise right.wrong(f"a number and an object cannot be compared: {left_value}, {right_value}")
        if scope.is_object(left_value) and name not in ("eq", "ne"):
            raise operator.wrong(f"objects are equal or they are not; expected = or !=, found {shown(operator)}")
        return _compared(name, left_value, right_value)
    first, second = _expression(left), _expression(right)
    if name not in words.COMPARISONS or first is None or second is None or not _comparable(name, (first, second)):
        return Computed(read_form(construct, scope))
    for side, expression in ((left, first), (right, second)):
        _check(side, expression, scope, objects=isinstance(first, ValueOf) or isinstance(second, ValueOf))
    return _compared(name, first, second)


def _compared(name: str, left: Expression, right: Expression) -> Condition:
    return Not(Compare("=", left, right)) if name == "ne" else Compare(words.COMPARISONS[name], left, right)


def _comparable(name: str, sides: tuple[Expression, Expression]) -> bool:
    """Whether PDDL compares the two: numbers, or objects for equality. It does not count with parameters."""
    if any(isinstance(side, Arithmetic) and any(map(_is_name, leaves(side))) for side in sides):
        return False
    objects = any(map(_is_name, sides))
    numbers = any(not isinstance(side, ValueOf) and not _is_name(side) for side in sides)
    return not objects or (name in ("eq", "ne") and not numbers)


def _is_name(expression: Expression) -> bool:
    return isinstance(expression, Constant) and isinstance(expression.value, str)


def _check(node: Node, expression: Expression, scope: FormulaScope, *, objects: bool = True) -> None:
    """Refuse names that are not there."""
    match expression:
        case ValueOf(fluent) if fluent == DURATION:
            scope.check_variable(DURATION[0], node)
        case ValueOf(fluent):
            scope.check_fluent(fluent, node, "function")
        case Constant(str() as name) if objects or name.startswith("?"):
            scope.check_object(name, node)
        case Arithmetic(_, operands):
            for operand in operands:
                _check(node, operand, scope)
                if scope.strict:
                    scope.check_value(operand, (), node)


def read_expression(node: Node, scope: FormulaScope = ANYTHING) -> Expression:
    """Read a number, an object, a parameter, ``?duration``, the value of a function, or arithmetic over these."""
    expression = _expression(node)
    if expression is None:
        raise node.wrong(f"expected a number, a name or something like (battery ?r), found {shown(node)}")
    _check(node, expression, scope)
    return expression


def _expression(node: Node) -> Expression | None:
    """Return None for what PDDL does not have."""
    if node.is_mapping:
        construct = words.form(node, words.ARITHMETIC_WORDS)
        if construct is None:
            return None
        if construct.word == "value":
            return ValueOf(read_fluent(construct.items(1)[0]))
        operator, operands = operation_parts(construct)
        symbol = words.ARITHMETIC.get(words.read_operator(operator))
        parts = [_expression(operand) for operand in operands]
        known = [part for part in parts if part is not None and not (_is_name(part) and not is_variable(str(part)))]
        if symbol is None or len(known) < len(parts):
            return None
        if len(known) not in _OPERANDS.get(symbol, range(2, sys.maxsize)):
            raise construct.argument.wrong(f"{symbol} does not take {len(known)} operands")
        return Arithmetic(symbol, tuple(known))
    if node.text is not None:
        fluent = fluent_in(node.text)
        if fluent is not None:
            return ValueOf(fluent)
        if node.text == DURATION[0]:
            return ValueOf(DURATION)
        if _NUMBER.match(node.text):  # in quotes
            return Constant(float(node.text)) if abs(float(node.text)) <= sys.float_info.max else None
        return Constant(node.text) if _NAME.match(node.text) else None
    value = None if node.items is not None else node.plain()
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if not abs(value) <= sys.float_info.max:
        raise node.wrong(f"expected a finite number, found {shown(node)}")
    return Constant(float(value))


# --- effects -------------------------------------------------------------------------------


EFFECTS: Final = ref("effects")
_CHANGES: Final = {operation.replace("-", "_"): operation for operation in OPERATIONS}
_NEW: Final = pair(words.FLUENT, ref("expression"))
EFFECT_WORDS: Final[words.Words] = {
    **words.TESTS,
    "and": ("all of them", EFFECTS),
    "or": ("a test of variables: at least one of them", words.CONDITION),
    "not": ("a fact becomes false; of anything else, a test that it is not so", EFFECTS),
    "forall": ("for all objects of some types: effects, or a test of variables", ref("quantifiedEffects")),
    "assign": ("gives a function a value", _NEW),
    "increase": ("adds to the value of a function", _NEW),
    "decrease": ("takes from the value of a function", _NEW),
    "scale_up": ("multiplies the value of a function", _NEW),
    "scale_down": ("divides the value of a function", _NEW),
    "when": ("effects under a condition", ref("when")),
    "one_of": ("one of several outcomes", ref("outcomes")),
}
"""The words that an effect begins with."""
_PLANNED: Final = ("and", "holds", "not", "forall", *_CHANGES, "when", "one_of")
"""The words of effects that planners know: they have no tests."""


class QuantifiedEffects(Quantified):
    """Effects on all objects of some types."""

    body = needed(EFFECTS, "the effects on each of them").named("effects")


class Conditional(Keys):
    """Effects under a condition."""

    condition = written(words.CONDITION, "tested when the effects would happen")
    at_start = written(words.CONDITION, "tested when the action starts")
    effects = written(EFFECTS, "effects if the condition holds")


class OutcomeKeys(Keys):
    """A way in which effects may turn out."""

    name = text("a name", "its number, from 1 on")
    chance = number("from 0 to 1; all outcomes have one, and these sum to 1, or none has", None, "as likely as the others")
    effects = node(EFFECTS, "what happens then", "nothing")


class ConditionsByMoment(Keys):
    """Conditions by the moment they must hold."""

    at_start = node(words.CONDITION, "must hold when the action starts")
    over_all = node(words.CONDITION, "must hold from start to end; the action is cancelled when it no longer does")
    at_end = node(words.CONDITION, "must hold when the action ends")


class EffectsByMoment(Keys):
    """Effects by the moment they happen."""

    at_start = node(EFFECTS, "effects of the start")
    at_end = node(EFFECTS, "effects of the end")


@dataclass(frozen=True, slots=True)
class WrittenEffects:
    """The effects of an action, and the condition that is expected besides."""

    effects: Effects = ()
    expected: Condition = TRUE


def read_effects(node: Node, scope: FormulaScope = ANYTHING) -> WrittenEffects:
    """Read effects: a list, or one of them."""
    parts = _parts(node, scope)
    effects = tuple(part for part in parts if isinstance(part, Effect))
    tests = [part for part in parts if not isinstance(part, Effect)]
    return WrittenEffects(effects, conjunction(tests))


def _parts(node: Node, scope: FormulaScope) -> tuple[Effect | Condition, ...]:
    if node.items is not None:
        return tuple(part for item in node.items for part in _parts(item, scope))
    if node.is_mapping and not node.mapped().nodes:
        return ()
    if not node.is_mapping:
        return (_becomes(node, True, scope),)
    construct = words.needed_form(node, _PLANNED if scope.strict else EFFECT_WORDS, "an effect")
    match construct.word:
        case "and":
            return tuple(part for item in construct.argument.each for part in _parts(item, scope))
        case "holds":
            return (_becomes(construct.items(1)[0], True, scope),)
        case "not":
            (negated,) = construct.items(1)
            inner = words.form(negated, ("holds",))
            fact = inner.items(1)[0] if inner else negated
            if inner or (fact.text is not None and fluent_in(fact.text) is not None):
                return (_becomes(fact, False, scope),)
        case "when":
            keys = Conditional(construct.argument.mapped())
            late, early, then = keys.condition, keys.at_start, keys.effects
            condition = late or early
            if condition is None or then is None or (late and early):
                raise construct.argument.wrong("'when' takes effects, and either a condition or, for one that is tested early, at_start")
            return (When(read_condition(condition, scope), _only_effects(then, scope), early=late is None),)
        case "one_of":
            return (read_outcomes(construct.argument, scope),)
        case "forall" if "effects" in construct.argument.mapped().nodes:
            variables, body = read_quantified(QuantifiedEffects(construct.argument.mapped()), scope)
            effects = (ForEach(variables, _only_effects(body, scope.inside(variables))),)
            check_choices(choices_in_effects(effects, scope.declared.count), construct.position)
            return effects
        case word if word in _CHANGES:
            target, value = construct.items(2)
            new = Constant(UNDEFINED) if value.text == UNDEFINED else read_expression(value, scope)
            effect = Set(read_fluent(target), new, _CHANGES[word])
            scope.check_change(effect.fluent, target, effect.value, value)
            if scope.strict and effect.operation != "assign" and scope.is_object(ValueOf(effect.fluent)):
                raise target.wrong(f"the values of {effect.fluent[0]!r} are objects; expected assign, found {construct.written}")
            return (effect,)
    if scope.strict:
        raise node.wrong("expected an effect, such as (at ?r kitchen), or not of a fact")
    return (read_condition(node, scope),)


def _becomes(node: Node, truth: bool, scope: FormulaScope) -> Set:
    if node.text is None:
        hint = f"; write {node.written!r} with quotes" if node.written else ""
        raise node.wrong(f"expected an effect, such as (at ?r kitchen), found {shown(node)}{hint}")
    effect = Set(read_fluent(node), Constant(truth))
    scope.check_change(effect.fluent, node, effect.value)
    return effect


def read_outcomes(node: Node, scope: FormulaScope = ANYTHING) -> OneOf:
    """Read the ways in which effects may turn out: a list of them."""
    alternatives: list[Alternative] = []
    for keys in (OutcomeKeys(item.mapped()) for item in node.listed):
        name, chance, happening = keys.name or "", keys.chance, keys.effects
        if name and (_OUTCOME.fullmatch(name) is None or name in {way.name for way in alternatives}):
            message = f"{name!r} is there twice" if _OUTCOME.fullmatch(name) else f"expected a name such as slipped, found {name!r}"
            raise InputError(message, keys.entry.position("name"))
        if chance is not None and chance > 1.0:
            raise InputError(f"expected a chance from 0 to 1, found {chance:g}", keys.entry.position("chance"))
        alternatives.append(Alternative(() if happening is None else _only_effects(happening, scope), chance, name))
    chances = [way.chance for way in alternatives if way.chance is not None]
    if not alternatives or len(chances) not in (0, len(alternatives)):
        raise node.wrong("expected outcomes, all of them with a chance or none")
    if chances and abs(sum(chances) - 1.0) > CHANCES_MISS:
        raise node.wrong(f"the chances sum to {sum(chances):g}; expected 1")
    return OneOf(tuple(alternatives))


def _only_effects(node: Node, scope: FormulaScope) -> Effects:
    written = read_effects(node, scope)
    if written.expected != TRUE:
        raise node.wrong("expected effects on facts and functions alone; tests of variables stand at the top of the effects")
    return written.effects


# --- moments and durations -----------------------------------------------------------------


def read_conditions(node: Node | None, scope: FormulaScope = ANYTHING) -> tuple[Condition, Condition, Condition]:
    """Read preconditions, those at the start, over all and at the end: ``{at_start: c, over_all: c, at_end: c}``, or that at the start."""
    if node is None or not _has_moments(node):
        return TRUE if node is None else read_condition(node, scope), TRUE, TRUE
    keys = ConditionsByMoment(node.mapped())
    conditions = keys.at_start, keys.over_all, keys.at_end
    start, always, end = (TRUE if condition is None else read_condition(condition, scope) for condition in conditions)
    if any(isinstance(part, Query) and part.layer is not Layer.LOCAL for data in data_in(always) for part in parts(data)):
        message = "a condition over all is watched all the time, and cannot ask people; expected LocalQuery, facts or functions"
        raise InputError(message, keys.entry.position("over_all"))
    return start, always, end


def read_timed_effects(node: Node | None, scope: FormulaScope = ANYTHING) -> tuple[Effects, WrittenEffects]:
    """Read effects: at the end, or by moment: ``{at_start: [...], at_end: [...]}``; return those at the start and the others."""
    if node is None:
        return (), WrittenEffects()
    if not _has_moments(node):
        return (), read_effects(node, scope)
    keys = EffectsByMoment(node.mapped())
    start, end = keys.at_start, keys.at_end
    return (() if start is None else _only_effects(start, scope), WrittenEffects() if end is None else read_effects(end, scope))


def _has_moments(node: Node) -> bool:
    return node.is_mapping and not node.mapped().nodes.keys().isdisjoint(ConditionsByMoment.known)


BOUND_WORDS: Final[words.Words] = {
    "=": ("exactly so many seconds", ref("expression")),
    "<=": ("at most so many seconds", ref("expression")),
    ">=": ("at least so many seconds", ref("expression")),
}
_BOUNDS: Final[Mapping[str, Literal["=", "<=", ">="]]] = {"=": "=", "<=": "<=", ">=": ">="}


def read_duration(node: Node, scope: FormulaScope = ANYTHING) -> tuple[DurationConstraint, ...]:
    """Read a duration: an expression, or a list of bounds ``{"<=": expression}``; an empty list for any duration."""
    if node.items is None and words.form(node, BOUND_WORDS) is None:
        return (DurationConstraint("=", _bound(node, scope)),)
    bounds = [words.needed_form(item, BOUND_WORDS, "a bound") for item in node.each]
    return tuple([DurationConstraint(_BOUNDS[bound.word], _bound(bound.argument, scope)) for bound in bounds])


def _bound(node: Node, scope: FormulaScope) -> Expression:
    bound = read_expression(node, scope)
    if scope.strict:
        scope.check_value(bound, (), node)
    if isinstance(bound, Constant) and (isinstance(bound.value, str) and bound.value[:1] != "?"):
        raise node.wrong(f"expected seconds as a number or something like (distance ?from ?to), found {shown(node)}")
    return bound
