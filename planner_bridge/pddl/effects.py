"""PDDL effects: from lists of words to pnm's, checked against the names."""

from __future__ import annotations

from planner_bridge.pddl.conditions import condition
from planner_bridge.pddl.names import TOTAL_COST
from planner_bridge.pddl.nesting import unnested
from planner_bridge.pddl.scope import OPERANDS, Scope
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from planner_bridge.pddl.words import operands, show_types
from pnm.conditions import conjunction
from pnm.effects import OPERATIONS, Effects, ForEach, Set, When
from pnm.expressions import UNDEFINED, Constant, Expression, Fluent


def effects(node: Node, scope: Scope) -> Effects:
    """Read an effect; ``and`` and ``()`` disappear in the tuple."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected an effect in parentheses, found {node}")
    if not node.items:
        return ()
    match node.head:
        case "and":
            return tuple([effect for part in node.rest for effect in effects(part, scope)])
        case "forall":
            scope.names.requirements.need(node, ":conditional-effects")
            variables, body = scope.quantified(node)
            return (ForEach(variables, effects(body, scope.inside(variables))),)
        case "when":
            scope.names.requirements.need(node, ":conditional-effects")
            first, second = operands(node, 2)
            return (When(condition(first, scope), effects(second, scope)),)
        case "=":
            raise wrong(node, "'=' cannot stand in an effect; expected (assign FUNCTION VALUE)")
        case "or" | "imply" | "exists" as word:
            raise wrong(node, f"'{word}' cannot stand in an effect; expected a fact, not, forall, when or assign")
        case _:
            return _flat(node, scope)


def _flat(node: Group, scope: Scope) -> Effects:
    flat = unnested(node, scope)
    if flat is None:
        return (_change(node, scope),)
    return (ForEach(tuple(flat.variables.values()), (When(conjunction(flat.values), (_change(flat.node, flat.scope),)),)),)


def _change(node: Group, scope: Scope) -> Set:
    match node.head:
        case "not":
            return Set(_fact(operands(node, 1)[0], scope), Constant(False))
        case operation if operation in OPERATIONS:
            target, value = operands(node, 2)
            return Set(scope.function(target), _value(node, target, value, scope), operation)
        case _:
            return Set(_fact(node, scope), Constant(True))


def _fact(node: Node, scope: Scope) -> Fluent:
    fluent = scope.fact(node)
    if fluent[0] in scope.names.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; no effect can change it")
    return fluent


def _value(node: Group, target: Node, value: Node, scope: Scope) -> Expression:
    declared = scope.names.function(target)
    if not declared.values:
        cost = node.head == "increase" and declared.name.lower() == TOTAL_COST and not (isinstance(value, Group) and value.head in OPERANDS)
        scope.names.requirements.need(node, *((":action-costs",) if cost else ()), ":numeric-fluents")
        return scope.expression(value)
    if node.head != "assign":
        raise wrong(node, f"the values of {declared.name!r} are objects ({show_types(declared.values)}); expected (assign ...)")
    if isinstance(value, Atom) and value.key == UNDEFINED and scope.names.find_object(value.text) is None:
        return Constant(UNDEFINED)
    return scope.value(value, declared.values)
