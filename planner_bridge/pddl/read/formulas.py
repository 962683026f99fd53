"""PDDL conditions: from lists of words to pnm's, checked against the names.

PDDL effects: from lists of words to pnm's, checked against the names.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from planner_bridge.pddl.read.object_fluents import without_object_fluents
from planner_bridge.pddl.read.symbols import TOTAL_COST
from planner_bridge.pddl.read.terms import OPERANDS, TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import operands, show_types
from pnm.core.logic.conditions import TRUE, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction
from pnm.core.logic.effects import OPERATIONS, Effects, ForEach, Set, When
from pnm.core.logic.expressions import UNDEFINED, Constant, Expression, Fluent

FALSE: Final = Any(())
_COMPOUND: Final = ("and", "or", "not", "imply", "forall", "exists")


def condition(node: Node, scope: TermScope) -> Condition:
    """Read a condition; ``()`` is true."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected a condition in parentheses, found {node}")
    if not node.items:
        return TRUE
    match node.head:
        case "and":
            return conjunction([condition(part, scope) for part in node.rest])
        case "or":
            scope.symbols.requirements.need(node, ":disjunctive-preconditions")
            return Any(tuple([condition(part, scope) for part in node.rest]))
        case "not":
            return _negation(node, scope)
        case "imply":
            scope.symbols.requirements.need(node, ":disjunctive-preconditions")
            left, right = operands(node, 2)
            return Implies(condition(left, scope), condition(right, scope))
        case "forall":
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            return ForAll(variables, condition(body, scope.inside(variables)))
        case "exists":
            scope.symbols.requirements.need(node, ":existential-preconditions")
            variables, body = scope.quantified(node)
            return Exists(variables, condition(body, scope.inside(variables)))
        case "=":
            return _flat(node, scope, _equality)
        case "<" | "<=" | ">" | ">=":
            return _flat(node, scope, _comparison)
        case _:
            return _flat(node, scope, _fact)


def _negation(node: Group, scope: TermScope) -> Not:
    (operand,) = operands(node, 1)
    if isinstance(operand, Group) and operand.head in _COMPOUND:
        scope.symbols.requirements.need(node, ":disjunctive-preconditions")
    else:
        scope.symbols.requirements.need(node, ":negative-preconditions", ":disjunctive-preconditions")
    return Not(condition(operand, scope))


def _flat(node: Group, scope: TermScope, read: Callable[[Group, TermScope], Condition]) -> Condition:
    flat = without_object_fluents(node, scope)
    if flat is None:
        return read(node, scope)
    return Exists(tuple(flat.variables.values()), conjunction([*flat.values, read(flat.node, flat.scope)]))


def _fact(node: Group, scope: TermScope) -> Condition:
    if scope.symbols.lenient and scope.symbols.is_undeclared(node):
        tolerate(node.items[0], f"the predicate {node.items[0]} is not declared; it is read as false")
        return FALSE
    return Holds(scope.fact(node))


def _equality(node: Group, scope: TermScope) -> Compare:
    left, right = operands(node, 2)
    if not scope.is_object(left) and not scope.is_object(right):
        return _comparison(node, scope)
    scope.symbols.requirements.need(node, ":equality", *([":object-fluents"] if scope.symbols.has_object_functions else []))
    return Compare("=", scope.value(left), scope.value(right))


def _comparison(node: Group, scope: TermScope) -> Compare:
    left, right = operands(node, 2)
    scope.symbols.requirements.need(node, ":numeric-fluents")
    return Compare(node.head, scope.expression(left), scope.expression(right))


def effects(node: Node, scope: TermScope) -> Effects:
    """Read an effect; ``and`` and ``()`` disappear in the tuple."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected an effect in parentheses, found {node}")
    if not node.items:
        return ()
    match node.head:
        case "and":
            return tuple([effect for part in node.rest for effect in effects(part, scope)])
        case "forall":
            scope.symbols.requirements.need(node, ":conditional-effects")
            variables, body = scope.quantified(node)
            return (ForEach(variables, effects(body, scope.inside(variables))),)
        case "when":
            scope.symbols.requirements.need(node, ":conditional-effects")
            first, second = operands(node, 2)
            return (When(condition(first, scope), effects(second, scope)),)
        case "=":
            raise wrong(node, "'=' cannot stand in an effect; expected (assign FUNCTION VALUE)")
        case "or" | "imply" | "exists" as word:
            raise wrong(node, f"'{word}' cannot stand in an effect; expected a fact, not, forall, when or assign")
        case _:
            return _flat_effect(node, scope)


def _flat_effect(node: Group, scope: TermScope) -> Effects:
    flat = without_object_fluents(node, scope)
    if flat is None:
        return (_change(node, scope),)
    return (ForEach(tuple(flat.variables.values()), (When(conjunction(flat.values), (_change(flat.node, flat.scope),)),)),)


def _change(node: Group, scope: TermScope) -> Set:
    match node.head:
        case "not":
            return Set(_changed_fact(operands(node, 1)[0], scope), Constant(False))
        case operation if operation in OPERATIONS:
            target, value = operands(node, 2)
            return Set(scope.function(target), _value(node, target, value, scope), operation)
        case _:
            return Set(_changed_fact(node, scope), Constant(True))


def _changed_fact(node: Node, scope: TermScope) -> Fluent:
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; no effect can change it")
    return fluent


def _value(node: Group, target: Node, value: Node, scope: TermScope) -> Expression:
    declared = scope.symbols.function(target)
    if not declared.values:
        cost = node.head == "increase" and declared.name.lower() == TOTAL_COST and not (isinstance(value, Group) and value.head in OPERANDS)
        scope.symbols.requirements.need(node, *((":action-costs",) if cost else ()), ":numeric-fluents")
        return scope.expression(value)
    if node.head != "assign":
        raise wrong(node, f"the values of {declared.name!r} are objects ({show_types(declared.values)}); expected (assign ...)")
    if isinstance(value, Atom) and value.key == UNDEFINED and scope.symbols.find_object(value.text) is None:
        return Constant(UNDEFINED)
    return scope.value(value, declared.values)
