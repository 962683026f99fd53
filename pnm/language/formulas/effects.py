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
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.conditions import read_condition, read_expression, read_quantified
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, read_fluent, shown
from pnm.language.formulas.words import TESTS, Form, form, needed_form

_CHANGES: Final = dict(zip((*OPERATIONS, "scale_up", "scale_down"), (*OPERATIONS, *OPERATIONS[-2:]), strict=True))
_WORDS: Final = (*TESTS, *_CHANGES, "when")
_PLANNED: Final = ("and", "holds", "not", "forall", *_CHANGES, "when")
"""The words of effects that planners know: they have no tests."""
MOMENTS: Final = ("at_start", "over_all", "at_end")


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
    construct = needed_form(node, _PLANNED if scope.strict else _WORDS, "an effect")
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
            variables, body = read_quantified(construct, "effects", scope)
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
    entry = construct.argument.mapped()
    entry.only("condition", "at_start", "effects")
    late, early, body = entry.node("condition"), entry.node("at_start"), entry.node("effects")
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
    entry = node.mapped()
    entry.only(*MOMENTS)
    conditions = [entry.filled(moment) for moment in MOMENTS]
    start, always, end = (TRUE if condition is None else read_condition(condition, scope) for condition in conditions)
    if any(isinstance(part, Query) and part.layer is not Layer.LOCAL for data in data_in(always) for part in parts(data)):
        message = "what must hold over all is watched, and nobody is asked all the time; expected LocalQuery, facts or functions"
        raise InputError(message, entry.position("over_all"))
    return TimedConditions(start, always, end)


def read_timed_effects(node: Node | None, scope: FormulaScope = ANYTHING) -> tuple[Effects, WrittenEffects]:
    """Read effects: at the end, or by moment: ``{at_start: [...], at_end: [...]}``; return those at the start and the others."""
    if node is None:
        return (), WrittenEffects()
    if not _has_moments(node):
        return (), read_effects(node, scope)
    entry = node.mapped()
    entry.only("at_start", "at_end")
    start, end = entry.filled("at_start"), entry.filled("at_end")
    return (
        () if start is None else _only_effects(start, scope),
        WrittenEffects() if end is None else read_effects(end, scope),
    )


def _has_moments(node: Node) -> bool:
    return node.is_mapping and not node.mapped().nodes.keys().isdisjoint(MOMENTS)


_BOUNDS: Final[Mapping[str, Literal["=", "<=", ">="]]] = {"=": "=", "<=": "<=", ">=": ">="}


def read_duration(node: Node, scope: FormulaScope = ANYTHING) -> tuple[DurationConstraint, ...]:
    """Read a duration: an expression, or a list of bounds ``{"<=": expression}``; an empty list for any duration."""
    if node.items is None and form(node, _BOUNDS) is None:
        return (DurationConstraint("=", _bound(node, scope)),)
    bounds = [needed_form(item, _BOUNDS, "a bound") for item in ((node,) if node.items is None else node.items)]
    return tuple([DurationConstraint(_BOUNDS[form.word], _bound(form.argument, scope)) for form in bounds])


def _bound(node: Node, scope: FormulaScope) -> Expression:
    bound = read_expression(node, scope)
    if scope.strict:
        scope.check_value(bound, (), node)
    return bound
