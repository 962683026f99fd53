"""PDDL conditions: from lists of words to pnm's, checked against the names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from planner_bridge.pddl.nesting import unnested
from planner_bridge.pddl.scope import Scope
from planner_bridge.pddl.sexpr import Group, Node, tolerate, wrong
from planner_bridge.pddl.words import operands
from pnm.conditions import TRUE, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction

FALSE: Final = Any(())
_COMPOUND: Final = ("and", "or", "not", "imply", "forall", "exists")


def condition(node: Node, scope: Scope) -> Condition:
    """Read a condition; ``()`` is true."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected a condition in parentheses, found {node}")
    if not node.items:
        return TRUE
    match node.head:
        case "and":
            return conjunction([condition(part, scope) for part in node.rest])
        case "or":
            scope.names.requirements.need(node, ":disjunctive-preconditions")
            return Any(tuple([condition(part, scope) for part in node.rest]))
        case "not":
            return _negation(node, scope)
        case "imply":
            scope.names.requirements.need(node, ":disjunctive-preconditions")
            left, right = operands(node, 2)
            return Implies(condition(left, scope), condition(right, scope))
        case "forall":
            scope.names.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            return ForAll(variables, condition(body, scope.inside(variables)))
        case "exists":
            scope.names.requirements.need(node, ":existential-preconditions")
            variables, body = scope.quantified(node)
            return Exists(variables, condition(body, scope.inside(variables)))
        case "=":
            return _flat(node, scope, _equality)
        case "<" | "<=" | ">" | ">=":
            return _flat(node, scope, _comparison)
        case _:
            return _flat(node, scope, _fact)


def _negation(node: Group, scope: Scope) -> Not:
    (operand,) = operands(node, 1)
    if isinstance(operand, Group) and operand.head in _COMPOUND:
        scope.names.requirements.need(node, ":disjunctive-preconditions")
    else:
        scope.names.requirements.need(node, ":negative-preconditions", ":disjunctive-preconditions")
    return Not(condition(operand, scope))


def _flat(node: Group, scope: Scope, read: Callable[[Group, Scope], Condition]) -> Condition:
    flat = unnested(node, scope)
    if flat is None:
        return read(node, scope)
    return Exists(tuple(flat.variables.values()), conjunction([*flat.values, read(flat.node, flat.scope)]))


def _fact(node: Group, scope: Scope) -> Condition:
    if scope.names.lenient and scope.names.is_stray(node):
        tolerate(node.items[0], f"the predicate {node.items[0]} is not declared; it is read as false")
        return FALSE
    return Holds(scope.fact(node))


def _equality(node: Group, scope: Scope) -> Compare:
    left, right = operands(node, 2)
    if not scope.is_object(left) and not scope.is_object(right):
        return _comparison(node, scope)
    scope.names.requirements.need(node, ":equality", *([":object-fluents"] if scope.names.has_object_functions else []))
    return Compare("=", scope.value(left), scope.value(right))


def _comparison(node: Group, scope: Scope) -> Compare:
    left, right = operands(node, 2)
    scope.names.requirements.need(node, ":numeric-fluents")
    return Compare(node.head, scope.expression(left), scope.expression(right))
