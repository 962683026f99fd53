"""Computed values, and operations on knowledge: from YAML to `pnm.core.logic.computed_values`.

A text that begins with ``?`` is a parameter of the action, and ``(battery r1)`` the value of a function or the
truth of a fact; any other text, number, list or mapping stands for itself, and ``{Literal: x}`` does whatever x is.
"""

from __future__ import annotations

from functools import reduce

from pnm.core.logic.computed_values import Compound, Data, KnowledgeOperation, Literal, Operation, Parameter, Query, Update
from pnm.core.logic.expressions import ValueOf
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, is_variable, read_fluent
from pnm.language.formulas.words import ARITHMETIC, OPERATIONS, QUERIES, UPDATES, VALUES, Form, form, needed_form, read_operator


def read_data(node: Node, scope: FormulaScope = ANYTHING) -> Data:
    """Read a value."""
    construct = form(node, (*VALUES, *UPDATES), in_value=True)
    if construct is not None:
        return read_form(construct, scope)
    if node.items is not None:
        return _whole(tuple(read_data(item, scope) for item in node.items), None)
    if node.is_mapping:
        entries = node.mapped().entries()
        return _whole(tuple(read_data(value, scope) for _, _, value in entries), tuple(key for key, _, _ in entries))
    text = node.text
    if text is None:
        return read_literal(node)
    if is_variable(text):
        scope.check_variable(text, node)
        return Parameter(text)
    fluent = fluent_in(text)
    if fluent is not None:
        scope.check_fluent(fluent, node)
        return _truth(ValueOf(fluent)) if fluent[0] in scope.declared.domain.predicates else ValueOf(fluent)
    return Literal.of(text)


def _whole(items: tuple[Data, ...], keys: tuple[str, ...] | None) -> Data:
    """Return a literal if all parts are."""
    values = [item.value for item in items if isinstance(item, Literal)]
    if len(values) < len(items):
        return Compound(items, keys)
    return Literal.of(values if keys is None else dict(zip(keys, values, strict=True)))


def read_literal(node: Node) -> Literal:
    """Read a value as it stands."""
    return Literal.of(node.plain())


def read_form(construct: Form, scope: FormulaScope) -> Data:
    """Read a value that is computed."""
    word = construct.word
    if word in QUERIES:
        return _query(construct, scope)
    match word:
        case "and" | "or":
            return Operation(word, tuple(read_data(operand, scope) for operand in construct.argument.each))
        case "not":
            return Operation("not", (read_data(construct.items(1)[0], scope),))
        case "imply":
            left, right = (read_data(operand, scope) for operand in construct.items(2))
            return Operation("or", (Operation("not", (left,)), right))
        case "exists":  # ``Exists: [Query: v]`` or ``Exists: {Query: v}``
            return Operation("exists", (_query(needed_form(construct.items(1)[0], QUERIES, "a query"), scope),))
        case "comparison":
            operator, first, second = comparison_parts(construct)
            return Operation(read_operator(operator), _compared_values(read_data(first, scope), read_data(second, scope)))
        case "operation":
            return _operation(construct, scope)
        case "booleanAssertion":
            inner, wanted = construct.items(2)
            value = wanted.plain()
            if not isinstance(value, bool):
                raise wanted.wrong("expected true or false")
            return Operation("eq", _compared_values(read_data(inner, scope), Literal.of(value)))
        case "holds":
            return _truth(ValueOf(read_fluent(construct.items(1)[0], scope)))
        case "value":
            return ValueOf(read_fluent(construct.items(1)[0], scope))
        case "literal":
            return read_literal(construct.argument)
        case _:
            raise construct.argument.wrong(f"{construct.written} changes knowledge; it is a step of its own, not a value")


def _query(construct: Form, scope: FormulaScope) -> Query:
    name, *meta = construct.items(1, 2)
    return Query(_name(name, scope), QUERIES[construct.word], *(read_data(option, scope) for option in meta))


def _name(node: Node, scope: FormulaScope) -> Data:
    """Read the name of a variable, which may be computed."""
    data = read_data(node, scope)
    if isinstance(data, Compound) or (isinstance(data, Literal) and not isinstance(data.value, str)):
        hint = f"; write {node.written!r} with quotes" if node.written else ""
        raise node.wrong(f"expected the name of a variable{hint}")
    return data


def _compared_values(left: Data, right: Data) -> tuple[Data, Data]:
    """Return both values; where one is true or false, so is the other."""
    return (_truth(left) if _is_flag(right) else left), (_truth(right) if _is_flag(left) else right)


def _is_flag(data: Data) -> bool:
    return isinstance(data, Literal) and isinstance(data.value, bool)


def _truth(data: Data) -> Data:
    """Return the truth of a fact, which is false when it is not recorded; anything else as it is."""
    return Operation("truth", (data,)) if isinstance(data, ValueOf) else data


def comparison_parts(construct: Form) -> tuple[Node, Node, Node]:
    """Return the operator and both sides of ``Comparison: [operator, [a, b]]``."""
    operator, pair = construct.items(2)
    if pair.items is None or len(pair.items) != 2:
        raise pair.wrong(f"{construct.written} takes a list of the two values it compares")
    return operator, *pair.items


def operation_parts(construct: Form) -> tuple[Node, tuple[Node, ...]]:
    """Return the operator and the operands of ``Operation: [operator, [a, b, ...]]``, or ``[operator, a]``."""
    operator, rest = construct.items(2)
    return operator, rest.each


def _operation(construct: Form, scope: FormulaScope, *, changing: bool = False) -> Operation:
    operator, rest = operation_parts(construct)
    name = read_operator(operator, changing=changing)
    if not rest:
        raise operator.wrong(f"{name} has no operands")
    operands = tuple(read_data(operand, scope) for operand in rest)
    if name == "sub" and len(operands) == 1 and operator.text == ARITHMETIC["sub"]:
        return Operation("neg", operands)
    if name in ARITHMETIC and len(operands) > 2:
        first = Operation(name, operands[:2])
        return reduce(lambda left, right: Operation(name, (left, right)), operands[2:], first)
    return Operation(name, operands)


def read_operation(node: Node, scope: FormulaScope = ANYTHING) -> KnowledgeOperation:
    """Read an operation on knowledge: an update, a query, or an operator that changes it."""
    construct = needed_form(node, OPERATIONS, "an update, a query or an operation")
    if construct.word in UPDATES:
        name, value, *meta = construct.items(2, 3)
        return Update(_name(name, scope), read_data(value, scope), UPDATES[construct.word], *(read_data(option, scope) for option in meta))
    if construct.word in QUERIES:
        return _query(construct, scope)
    operation = _operation(construct, scope, changing=True)
    sizes = {"setitem": 3, "delitem": 2}
    if operation.operator in sizes:
        first = operation_parts(construct)[1][0]
        if len(operation.operands) != sizes[operation.operator]:
            raise first.wrong(f"{operation.operator} takes {sizes[operation.operator]} operands, found {len(operation.operands)}")
        if not isinstance(operation.operands[0], Query):
            raise first.wrong(f"{operation.operator} changes the result of a query; expected a query as its first operand")
    return operation
