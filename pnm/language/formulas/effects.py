"""Effects, durations and moments of actions: from YAML to `pnm.core.logic.effects`.

An effect on facts and functions is applied. A test of variables, which action servers write, is an expected condition:
it should hold once the action is done.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from pnm.core.logic.computed_values import Layer, Query, parts
from pnm.core.logic.conditions import TRUE, Condition, conjunction, data_in
from pnm.core.logic.domain import DurationConstraint, check_choices
from pnm.core.logic.effects import OPERATIONS, Effect, Effects, ForEach, Set, When, choices_in_effects
from pnm.core.logic.expressions import UNDEFINED, Constant, Expression, ValueOf
from pnm.errors import InputError
from pnm.files.yaml_keys import Keys, needed, node, pair, ref, written
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.conditions import Quantified, read_condition, read_expression, read_quantified
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, read_fluent, shown
from pnm.language.formulas.words import CONDITION, FLUENT, TESTS, Form, Words, form, needed_form

EFFECTS: Final = ref("effects")
_CHANGES: Final = {operation.replace("-", "_"): operation for operation in OPERATIONS}
_NEW: Final = pair(FLUENT, ref("expression"))
EFFECT_WORDS: Final[Words] = {
    **TESTS,
    "and": ("all of them", EFFECTS),
    "or": ("a test of variables: at least one of them", CONDITION),
    "not": ("a fact becomes false; of anything else, a test that it is not so", EFFECTS),
    "forall": ("for all objects of some types: effects, or a test of variables", ref("quantifiedEffects")),
    "assign": ("gives a function a value", _NEW),
    "increase": ("adds to the value of a function", _NEW),
    "decrease": ("takes from the value of a function", _NEW),
    "scale_up": ("multiplies the value of a function", _NEW),
    "scale_down": ("divides the value of a function", _NEW),
    "when": ("effects under a condition", ref("when")),
}
"""The words that an effect begins with."""
_PLANNED: Final = ("and", "holds", "not", "forall", *_CHANGES, "when")
"""The words of effects that planners know: they have no tests."""


class QuantifiedEffects(Quantified):
    """Effects on all objects of some types."""

    body = needed(EFFECTS, "the effects on each of them").named("effects")


class Conditional(Keys):
    """Effects under a condition."""

    condition = written(CONDITION, "tested when the effects would happen")
    at_start = written(CONDITION, "tested when the action starts")
    effects = written(EFFECTS, "effects if the condition holds")


class ConditionsByMoment(Keys):
    """Conditions by the moment they must hold."""

    at_start = node(CONDITION, "must hold when the action starts")
    over_all = node(CONDITION, "must hold from start to end; the action is cancelled when it no longer does")
    at_end = node(CONDITION, "must hold when the action ends")


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
    effects = tuple(part for part in parts if isinstance(part, Set | When | ForEach))
    tests = [part for part in parts if not isinstance(part, Set | When | ForEach)]
    return WrittenEffects(effects, conjunction(tests))


def _parts(node: Node, scope: FormulaScope) -> tuple[Effect | Condition, ...]:
    if node.items is not None:
        return tuple(part for item in node.items for part in _parts(item, scope))
    if node.is_mapping and not node.mapped().nodes:
        return ()
    if not node.is_mapping:
        return (_becomes(node, True, scope),)
    construct = needed_form(node, _PLANNED if scope.strict else EFFECT_WORDS, "an effect")
    match construct.word:
        case "and":
            return tuple(part for item in construct.operands() for part in _parts(item, scope))
        case "holds":
            return (_becomes(construct.items(1)[0], True, scope),)
        case "not":
            (negated,) = construct.items(1)
            inner = form(negated, ("holds",))
            fact = inner.items(1)[0] if inner else negated
            if inner or (fact.text is not None and fluent_in(fact.text) is not None):
                return (_becomes(fact, False, scope),)
        case "when":
            return (_when(construct, scope),)
        case "forall" if "effects" in construct.argument.mapped().nodes:
            variables, body = read_quantified(QuantifiedEffects(construct.argument.mapped()), scope)
            effects = (ForEach(variables, _only_effects(body, scope.inside(variables))),)
            check_choices(choices_in_effects(effects, scope.declared.count), construct.position)
            return effects
        case word if word in _CHANGES:
            return (_change(construct, scope),)
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


def _change(construct: Form, scope: FormulaScope) -> Set:
    target, value = construct.items(2)
    new = Constant(UNDEFINED) if value.text == UNDEFINED else read_expression(value, scope)
    effect = Set(read_fluent(target), new, _CHANGES[construct.word])
    scope.check_change(effect.fluent, target, effect.value, value)
    if scope.strict and effect.operation != "assign" and scope.is_object(ValueOf(effect.fluent)):
        raise target.wrong(f"the values of {effect.fluent[0]!r} are objects; expected assign, found {construct.written}")
    return effect


def _when(construct: Form, scope: FormulaScope) -> When:
    keys = Conditional(construct.argument.mapped())
    late, early, body = keys.condition, keys.at_start, keys.effects
    condition = late or early
    if condition is None or body is None or (late and early):
        raise construct.argument.wrong("'when' takes effects, and either a condition or, for one that is tested early, at_start")
    return When(read_condition(condition, scope), _only_effects(body, scope), early=late is None)


def _only_effects(node: Node, scope: FormulaScope) -> Effects:
    written = read_effects(node, scope)
    if written.expected != TRUE:
        raise node.wrong("expected effects on facts and functions alone; tests of variables stand at the top of the effects")
    return written.effects


# --- moments and durations -----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TimedConditions:
    """Conditions of an action by the moment they must hold."""

    start: Condition = TRUE
    always: Condition = TRUE
    end: Condition = TRUE


def read_conditions(node: Node | None, scope: FormulaScope = ANYTHING) -> TimedConditions:
    """Read preconditions: a condition, or conditions by moment: ``{at_start: c, over_all: c, at_end: c}``."""
    if node is None:
        return TimedConditions()
    if not _has_moments(node):
        return TimedConditions(read_condition(node, scope))
    keys = ConditionsByMoment(node.mapped())
    conditions = keys.at_start, keys.over_all, keys.at_end
    start, always, end = (TRUE if condition is None else read_condition(condition, scope) for condition in conditions)
    if any(isinstance(part, Query) and part.layer is not Layer.LOCAL for data in data_in(always) for part in parts(data)):
        message = "a condition over all is watched all the time, and cannot ask people; expected LocalQuery, facts or functions"
        raise InputError(message, keys.entry.position("over_all"))
    return TimedConditions(start, always, end)


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


BOUND_WORDS: Final[Words] = {
    "=": ("exactly so many seconds", ref("expression")),
    "<=": ("at most so many seconds", ref("expression")),
    ">=": ("at least so many seconds", ref("expression")),
}
_BOUNDS: Final[Mapping[str, Literal["=", "<=", ">="]]] = {"=": "=", "<=": "<=", ">=": ">="}


def read_duration(node: Node, scope: FormulaScope = ANYTHING) -> tuple[DurationConstraint, ...]:
    """Read a duration: an expression, or a list of bounds ``{"<=": expression}``; an empty list for any duration."""
    if node.items is None and form(node, BOUND_WORDS) is None:
        return (DurationConstraint("=", _bound(node, scope)),)
    bounds = [needed_form(item, BOUND_WORDS, "a bound") for item in ((node,) if node.items is None else node.items)]
    return tuple([DurationConstraint(_BOUNDS[form.word], _bound(form.argument, scope)) for form in bounds])


def _bound(node: Node, scope: FormulaScope) -> Expression:
    bound = read_expression(node, scope)
    if scope.strict:
        scope.check_value(bound, (), node)
    if isinstance(bound, Constant) and (isinstance(bound.value, str) and bound.value[:1] != "?"):
        raise node.wrong(f"expected seconds as a number or something like (distance ?from ?to), found {shown(node)}")
    return bound
