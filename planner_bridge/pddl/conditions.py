"""PDDL conditions, expressions and effects: from lists of words to pnm's, checked against the names."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from planner_bridge.model import Declaration
from planner_bridge.pddl.names import Names, is_number, number, show_types, unknown, unsupported
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from pnm.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.effects import OPERATIONS, Effects, ForEach, Set, When
from pnm.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, ValueOf, Variable

_MANY: Final = (range(2, sys.maxsize), "at least 2")
_OPERANDS: Final[Mapping[str, tuple[range, str]]] = {"+": _MANY, "*": _MANY, "-": (range(1, 3), "1 or 2"), "/": (range(2, 3), "2")}
"""How many operands arithmetic takes."""


def conjunction(parts: Iterable[Condition]) -> Condition:
    """Join conditions by ``and``: nested ones flattened, a single one left alone."""
    flat = conjuncts(All(tuple(parts)))
    return flat[0] if len(flat) == 1 else All(flat)


def operands(node: Group, count: int) -> tuple[Node, ...]:
    """Return what follows the first word, which must be so many parts."""
    if len(node.rest) != count:
        raise wrong(node, f"'{node.head}' takes {_counted(count, 'operand')}, found {len(node.rest)}")
    return node.rest


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


@dataclass(frozen=True, slots=True)
class Reader:
    """Reads what stands inside an action or a goal; knows which variables may be used there."""

    names: Names
    variables: Mapping[str, Variable] = field(default_factory=dict)
    """By name in lower case."""
    duration: bool = False
    """Whether ``?duration`` may be used."""

    def inside(self, variables: Iterable[Variable]) -> Reader:
        """Return a reader for the part in which these variables are bound."""
        return replace(self, variables={**self.variables, **{variable.name.lower(): variable for variable in variables}})

    def timed(self) -> Reader:
        """Return a reader for the conditions and effects of a durative action."""
        return replace(self, duration=True)

    # --- conditions ---

    def condition(self, node: Node) -> Condition:
        """Read a condition; ``()`` is true."""
        if not isinstance(node, Group):
            raise wrong(node, f"expected a condition in parentheses, found {node}")
        if not node.items:
            return TRUE
        match node.head:
            case "and":
                return conjunction([self.condition(part) for part in node.rest])
            case "or":
                return Any(tuple([self.condition(part) for part in node.rest]))
            case "not":
                return Not(self.condition(operands(node, 1)[0]))
            case "imply":
                left, right = operands(node, 2)
                return Implies(self.condition(left), self.condition(right))
            case "forall" | "exists" as quantifier:
                variables, body = self.quantified(node)
                inner = self.inside(variables).condition(body)
                return ForAll(variables, inner) if quantifier == "forall" else Exists(variables, inner)
            case "=":
                return self._equality(node)
            case "<" | "<=" | ">" | ">=" as operation:
                left, right = operands(node, 2)
                return Compare(operation, self.expression(left), self.expression(right))
            case _:
                return Holds(self.fact(node))

    def quantified(self, node: Group) -> tuple[tuple[Variable, ...], Node]:
        """Return the variables and the body of ``(forall (?x - t) body)``, or of ``exists``."""
        variables, body = operands(node, 2)
        if not isinstance(variables, Group):
            raise wrong(variables, f"expected variables in parentheses, found {variables}")
        return self.names.variables(variables.items), body

    def _equality(self, node: Group) -> Compare:
        left, right = operands(node, 2)
        if self._is_term(left) or self._is_term(right):
            return Compare("=", Constant(self._term(left)[0]), Constant(self._term(right)[0]))
        return Compare("=", self.expression(left), self.expression(right))

    def _is_term(self, node: Node) -> bool:
        if not isinstance(node, Atom) or is_number(node):
            return False
        if node.text[0] == "?":
            return node.key in self.variables or node.key != DURATION[0]
        return self.names.find_object(node.text) is not None or not self.names.is_function(node)

    # --- expressions ---

    def expression(self, node: Node) -> Expression:
        """Read a number, ``?duration``, the value of a function, or arithmetic over these."""
        match node:
            case Group() if node.head in _OPERANDS:
                return self._arithmetic(node)
            case Group():
                return ValueOf(self.function(node))
            case Atom() if is_number(node):
                return Constant(number(node))
            case Atom() if node.key == DURATION[0] and node.key not in self.variables:
                if not self.duration:
                    raise wrong(node, "'?duration' can only be used in the conditions and effects of a durative action")
                return ValueOf(DURATION)
            case Atom("#t"):
                raise unsupported(node, "continuous effects (#t)", "a simulation of change over time")
            case Atom() if self.names.is_function(node):
                return ValueOf(self.function(node))
            case _:
                raise wrong(node, f"expected a number or a function in parentheses, found {node}")

    def _arithmetic(self, node: Group) -> Arithmetic:
        counts, said = _OPERANDS[node.head]
        if len(node.rest) not in counts:
            raise wrong(node, f"'{node.head}' takes {said} operands, found {len(node.rest)}")
        return Arithmetic(node.head, tuple([self.expression(part) for part in node.rest]))

    # --- effects ---

    def effects(self, node: Node) -> Effects:
        """Read an effect; ``and`` and ``()`` disappear in the tuple."""
        if not isinstance(node, Group):
            raise wrong(node, f"expected an effect in parentheses, found {node}")
        if not node.items:
            return ()
        match node.head:
            case "and":
                return tuple([effect for part in node.rest for effect in self.effects(part)])
            case "not":
                return (Set(self.fact(operands(node, 1)[0]), Constant(False)),)
            case "forall":
                variables, body = self.quantified(node)
                return (ForEach(variables, self.inside(variables).effects(body)),)
            case "when":
                condition, effect = operands(node, 2)
                return (When(self.condition(condition), self.effects(effect)),)
            case operation if operation in OPERATIONS:
                target, value = operands(node, 2)
                return (Set(self.function(target), self.expression(value), operation),)
            case "=":
                raise wrong(node, "'=' cannot stand in an effect; expected (assign FUNCTION VALUE)")
            case "or" | "imply" | "exists" as word:
                raise wrong(node, f"'{word}' cannot stand in an effect; expected a fact, not, forall, when or assign")
            case _:
                return (Set(self.fact(node), Constant(True)),)

    # --- facts and functions ---

    def fact(self, node: Node) -> Fluent:
        """Read a predicate with its arguments."""
        if not isinstance(node, Group):
            raise wrong(node, f"expected a fact in parentheses, found {node}")
        return self._fluent(node, self.names.predicate(node))

    def function(self, node: Node) -> Fluent:
        """Read a function with its arguments."""
        declared = self.names.function(node)
        return self._fluent(node, declared)

    def _fluent(self, node: Node, declared: Declaration) -> Fluent:
        given = node.rest if isinstance(node, Group) else ()
        if len(given) != len(declared.parameters):
            form = f"({' '.join((declared.name, *map(str, declared.parameters)))})"
            raise wrong(node, f"{form} takes {_counted(len(declared.parameters), 'argument')}, found {len(given)}")
        return declared.name, *[self._argument(one, needed) for one, needed in zip(given, declared.parameters, strict=True)]

    def _argument(self, node: Node, needed: Variable) -> str:
        name, types, fixed = self._term(node)
        fits = self.names.matches if fixed else self.names.may_match
        if not fits(types, needed.types):
            raise wrong(node, f"{name!r} is of type {show_types(types)}; expected {show_types(needed.types)}")
        return name

    def _term(self, node: Node) -> tuple[str, tuple[str, ...], bool]:
        match node:
            case Atom(text) if text[0] != "?":
                return *self.names.object(node), True
            case Atom() if node.key in self.variables:
                variable = self.variables[node.key]
                return variable.name, variable.types, False
            case Atom():
                raise unknown("variable", node, [variable.name for variable in self.variables.values()])
            case Group():
                raise wrong(node, f"expected an object or a variable, found {node}")
