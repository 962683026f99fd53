"""PDDL conditions and effects: from lists of words to pnm's, checked against the symbol table.

Object fluents as arguments, ``(dirty (room-of ?r))``, are flattened: a variable stands for the value of the function
(PDDL 3.1). It is bound around the fact, the comparison or the effect in which it stands; where the function has no
value there is no choice for it, so that a fact about it does not hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from planner_bridge.pddl.read.requirements import Leniency
from planner_bridge.pddl.read.symbols import TOTAL_COST
from planner_bridge.pddl.read.terms import OPERANDS, TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, wrong
from planner_bridge.pddl.syntax.words import operands, show_types
from pnm.core.logic.conditions import TRUE, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction
from pnm.core.logic.effects import OPERATIONS, Effects, ForEach, Set, When
from pnm.core.logic.expressions import UNDEFINED, Constant, Expression, Fluent, ValueOf, Variable

_COMPOUND: Final = ("and", "or", "not", "imply", "forall", "exists")
_OVER_NUMBERS: Final = frozenset((*OPERANDS, *OPERATIONS, "=", "<", "<=", ">", ">=", "not"))
"""Heads whose operands are no arguments themselves but may have some."""


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
            (operand,) = operands(node, 1)
            is_plain = not isinstance(operand, Group) or operand.head not in _COMPOUND
            scope.symbols.requirements.need(node, *([":negative-preconditions"] if is_plain else []), ":disjunctive-preconditions")
            return Not(condition(operand, scope))
        case "imply":
            scope.symbols.requirements.need(node, ":disjunctive-preconditions")
            left, right = operands(node, 2)
            return Implies(condition(left, scope), condition(right, scope))
        case "forall" | "exists" as word:
            scope.symbols.requirements.need(node, ":universal-preconditions" if word == "forall" else ":existential-preconditions")
            variables, body = scope.quantified(node)
            return (ForAll if word == "forall" else Exists)(variables, condition(body, scope.inside(variables)))
        case "=":
            return _flattened_condition(node, scope, _equality)
        case "<" | "<=" | ">" | ">=":
            return _flattened_condition(node, scope, _comparison)
        case _:
            return _flattened_condition(node, scope, _fact)


def _flattened_condition(node: Group, scope: TermScope, read: Callable[[Group, TermScope], Condition]) -> Condition:
    flat = _flattened(node, scope)
    if flat is None:
        return read(node, scope)
    return Exists(tuple(flat.variables.values()), conjunction([*flat.values, read(flat.node, flat.scope)]))


def _fact(node: Group, scope: TermScope) -> Condition:
    if scope.symbols.lenient and scope.symbols.is_undeclared(node):
        Leniency.PREDICATE_UNDECLARED.note(node.items[0], node.items[0])
        return Any(())  # false
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
            flat = _flattened(node, scope)
            if flat is None:
                return (_change(node, scope),)
            change = _change(flat.node, flat.scope)
            return (ForEach(tuple(flat.variables.values()), (When(conjunction(flat.values), (change,)),)),)


def _change(node: Group, scope: TermScope) -> Set:
    match node.head:
        case "not":
            return Set(_changed_fact(operands(node, 1)[0], scope), Constant(False))
        case operation if operation in OPERATIONS:
            target, value = operands(node, 2)
            return Set(scope.function(target), _new_value(node, target, value, scope), operation)
        case _:
            return Set(_changed_fact(node, scope), Constant(True))


def _changed_fact(node: Node, scope: TermScope) -> Fluent:
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; no effect can change it")
    return fluent


def _new_value(node: Group, target: Node, value: Node, scope: TermScope) -> Expression:
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


def _flattened(node: Group, scope: TermScope) -> _Flattened | None:
    """Return the fact, comparison or effect without functions among its arguments; None when there are none."""
    if not scope.symbols.has_object_functions:
        return None
    flat = _Flattened(scope)
    flat.node = flat.flatten(node)
    return flat if flat.variables else None


@dataclass(slots=True)
class _Flattened:
    """A list without functions among its arguments. The mutable state grows while it is made."""

    scope: TermScope
    """With the variables that stand for values."""
    variables: dict[Fluent, Variable] = field(default_factory=dict)
    """For every function that was an argument, outermost last."""
    node: Group = field(init=False)

    @property
    def values(self) -> list[Compare]:
        """For every variable, that it equals its function."""
        return [Compare("=", ValueOf(fluent), Constant(variable.name)) for fluent, variable in self.variables.items()]

    def flatten(self, node: Group) -> Group:
        """Return the list with variables for the functions among its arguments."""
        if node.head in _OVER_NUMBERS:
            parts = [self.flatten(part) if isinstance(part, Group) and part.items else part for part in node.rest]
        else:
            parts = [self._argument(part) for part in node.rest]
        return Group((node.items[0], *parts), node.offset, node.source)

    def _argument(self, node: Node) -> Node:
        declared = self.scope.symbols.find_function(node) if isinstance(node, Group) else None
        if not isinstance(node, Group) or declared is None or not declared.values:
            return node
        flat = self.flatten(node)  # first, because it may bind variables
        fluent = self.scope.function(flat)
        if fluent not in self.variables:
            name, count = f"?{declared.name}", 1
            while name.lower() in self.scope.variables:
                count += 1
                name = f"?{declared.name}{count}"
            self.variables[fluent] = Variable(name, declared.values)
            self.scope = self.scope.inside((self.variables[fluent],))
        return Atom(self.variables[fluent].name, node.offset, node.source)
