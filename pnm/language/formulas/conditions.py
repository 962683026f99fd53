"""Conditions and expressions: from YAML to `pnm.core.logic.conditions`, every shape of them.

Those over facts, functions and objects alone become PDDL's own kinds of conditions; those over variables are `Computed`.
"""

from __future__ import annotations

import re
import sys
from typing import Final

from pnm.core.logic.computed_values import Parameter
from pnm.core.logic.conditions import TRUE, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, choices_in, conjunction
from pnm.core.logic.domain import check_choices
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, ValueOf, Variable
from pnm.errors import InputError
from pnm.files.yaml_keys import Keys, needed, ref
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, is_variable, read_fluent, read_typed, shown
from pnm.language.formulas.values import comparison_parts, operation_parts, read_form
from pnm.language.formulas.words import (
    ARITHMETIC,
    ARITHMETIC_WORDS,
    COMPARISONS,
    CONDITION,
    QUERIES,
    TESTS,
    Form,
    form,
    needed_form,
    read_operator,
)

FALSE: Final = Any(())
_NAME: Final = re.compile(r"\??[^\s()?]+\Z")
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\Z")
_OPERANDS: Final = {"-": range(1, 3), "/": range(2, 3)}
"""The number of operands of arithmetic; the others take any number from 2."""


class Quantified(Keys):
    """A condition on all objects of some types, or on some of them."""

    variables = needed(ref("typed"), "variables and their types: ?x ?y - block")
    body = needed(CONDITION, "the condition on them").named("condition")


def read_condition(node: Node, scope: FormulaScope = ANYTHING) -> Condition:
    """Read a condition."""
    if node.items is not None:
        return conjunction(read_condition(item, scope) for item in node.items)
    if node.is_mapping:
        return TRUE if not node.mapped().nodes else _condition(needed_form(node, TESTS, "a condition"), scope)
    if node.text is not None and is_variable(node.text) and not scope.strict:
        scope.check_variable(node.text, node)
        return Computed(Parameter(node.text))
    if node.text is None and isinstance(node.plain(), bool):
        return TRUE if node.plain() else FALSE
    if node.text is None or fluent_in(node.text) is None:
        raise node.wrong(f"expected a condition, such as (at ?r kitchen) or {{Exists: [Query: name]}}, found {shown(node)}")
    return Holds(read_fluent(node, scope, "predicate"))


def _condition(construct: Form, scope: FormulaScope) -> Condition:
    match construct.word:
        case "and":
            return conjunction(read_condition(operand, scope) for operand in construct.operands())
        case "or":
            return Any(tuple(read_condition(operand, scope) for operand in construct.operands()))
        case "not":
            return Not(read_condition(construct.items(1)[0], scope))
        case "imply":
            left, right = construct.items(2)
            return Implies(read_condition(left, scope), read_condition(right, scope))
        case "holds":
            return Holds(read_fluent(construct.items(1)[0], scope, "predicate"))
        case "forall":
            return _quantified(ForAll, construct, scope)
        case "exists" if construct.argument.is_mapping and form(construct.argument, QUERIES) is None:
            return _quantified(Exists, construct, scope)
        case "comparison":
            return _comparison(construct, *comparison_parts(construct), scope)
        case "operation" if len(operation_parts(construct)[1]) == 2:
            operator, (left, right) = operation_parts(construct)
            return _comparison(construct, operator, left, right, scope)
        case _ if scope.strict:
            raise InputError(f"PDDL has no {construct.written!r}: it knows facts and functions, not variables", construct.position)
        case _:
            return Computed(read_form(construct, scope))


def _quantified(kind: type[ForAll | Exists], construct: Form, scope: FormulaScope) -> ForAll | Exists:
    variables, body = read_quantified(Quantified(construct.argument.mapped()), scope)
    condition = kind(variables, read_condition(body, scope.inside(variables)))
    check_choices(choices_in(condition, scope.declared.count), construct.position)
    return condition


def read_quantified(keys: Quantified, scope: FormulaScope) -> tuple[tuple[Variable, ...], Node]:
    """Return the variables of a quantifier, and its body."""
    return read_typed(keys.variables, scope), keys.body


# --- comparisons ---------------------------------------------------------------------------


def _comparison(construct: Form, operator: Node, left: Node, right: Node, scope: FormulaScope) -> Condition:
    """Compare numbers or objects as PDDL does if both sides are of its kinds, and any values else."""
    name = read_operator(operator)
    if scope.strict:  # two numbers, or two objects for equality, as planners do
        if name not in COMPARISONS:
            raise operator.wrong(f"PDDL does not compare with {shown(operator)}; expected one of {', '.join(COMPARISONS.values())}")
        left_value, right_value = read_expression(left, scope), read_expression(right, scope)
        if scope.is_object(left_value) != scope.is_object(right_value):
            raise right.wrong(f"a number and an object cannot be compared: {left_value}, {right_value}")
        if scope.is_object(left_value) and name not in ("eq", "ne"):
            raise operator.wrong(f"objects are equal or they are not; expected = or !=, found {shown(operator)}")
        return _compared(name, left_value, right_value)
    first, second = _expression(left), _expression(right)
    if name not in COMPARISONS or first is None or second is None or not _comparable(name, (first, second)):
        return Computed(read_form(construct, scope))
    for side, expression in ((left, first), (right, second)):
        _check(side, expression, scope, objects=isinstance(first, ValueOf) or isinstance(second, ValueOf))
    return _compared(name, first, second)


def _compared(name: str, left: Expression, right: Expression) -> Condition:
    return Not(Compare("=", left, right)) if name == "ne" else Compare(COMPARISONS[name], left, right)


def _comparable(name: str, sides: tuple[Expression, Expression]) -> bool:
    """Whether PDDL compares the two: numbers, or objects for equality. It does not count with parameters."""
    if any(_counts_with_names(side) for side in sides):
        return False
    objects = any(map(_is_name, sides))
    numbers = any(not isinstance(side, ValueOf) and not _is_name(side) for side in sides)
    return not objects or (name in ("eq", "ne") and not numbers)


def _is_name(expression: Expression) -> bool:
    return isinstance(expression, Constant) and isinstance(expression.value, str)


def _counts_with_names(expression: Expression) -> bool:
    match expression:
        case Arithmetic(_, operands):
            return any(_is_name(operand) or _counts_with_names(operand) for operand in operands)
        case _:
            return False


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
        construct = form(node, ARITHMETIC_WORDS)
        if construct is None:
            return None
        return ValueOf(read_fluent(construct.items(1)[0])) if construct.word == "value" else _arithmetic(construct)
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


def _arithmetic(construct: Form) -> Expression | None:
    operator, operands = operation_parts(construct)
    symbol = ARITHMETIC.get(read_operator(operator))
    parts = [_expression(operand) for operand in operands]
    known = [part for part in parts if part is not None and not (_is_name(part) and not is_variable(str(part)))]
    if symbol is None or len(known) < len(parts):
        return None
    if len(known) not in _OPERANDS.get(symbol, range(2, sys.maxsize)):
        raise construct.argument.wrong(f"{symbol} does not take {len(known)} operands")
    return Arithmetic(symbol, tuple(known))
