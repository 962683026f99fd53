"""PDDL terms, facts, functions and numbers: from lists of words to fluents and expressions, checked against the symbol table."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from planner_bridge.pddl.read.requirements import Refused
from planner_bridge.pddl.read.symbols import SymbolTable
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, wrong
from planner_bridge.pddl.syntax.words import Types, is_number, number, operands, show_types, unknown
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, ValueOf, Variable
from pnm.errors import InputError, counted

_MANY: Final = (range(2, sys.maxsize), "at least 2")
OPERANDS: Final[Mapping[str, tuple[range, str]]] = {"+": _MANY, "*": _MANY, "-": (range(1, 3), "1 or 2"), "/": (range(2, 3), "2")}
"""How many operands each operator of arithmetic takes."""
TOTAL_TIME: Final = "total-time"
IS_VIOLATED: Final = "is-violated"
_ANY: Final = ("object",)


@dataclass(frozen=True, slots=True)
class TermScope:
    """The terms that may stand at a place of a file: the symbol table, and the variables bound around it."""

    symbols: SymbolTable
    variables: Mapping[str, Variable] = field(default_factory=dict)
    """By name in lower case."""
    duration: bool = False
    """Whether ``?duration`` may be used."""
    metric: bool = False
    """Whether ``total-time`` and ``(is-violated PREFERENCE)`` may be used."""

    def inside(self, variables: Iterable[Variable]) -> TermScope:
        """Return the scope in which these variables are bound, too."""
        return replace(self, variables={**self.variables, **{variable.name.lower(): variable for variable in variables}})

    def quantified(self, node: Group) -> tuple[tuple[Variable, ...], Node]:
        """Return the variables and the body of ``(forall (?x - t) body)``, or of ``exists``."""
        variables, body = operands(node, 2)
        if not isinstance(variables, Group):
            raise wrong(variables, f"expected variables in parentheses, found {variables}")
        return self.symbols.variables(variables.items), body

    def fact(self, node: Node) -> Fluent:
        """Read a predicate with its arguments."""
        if not isinstance(node, Group):
            raise wrong(node, f"expected a fact in parentheses, found {node}")
        return self._fluent(node, self.symbols.predicate(node))

    def function(self, node: Node) -> Fluent:
        """Read a function with its arguments."""
        return self._fluent(node, self.symbols.function(node))

    def _fluent(self, node: Node, declared: Declaration) -> Fluent:
        given = node.rest if isinstance(node, Group) else ()
        if len(given) != len(declared.parameters):
            raise wrong(node, f"{declared} takes {counted(len(declared.parameters), 'argument')}, found {len(given)}")
        return declared.name, *[self._argument(term, variable.types) for term, variable in zip(given, declared.parameters, strict=True)]

    def _argument(self, node: Node, needed: Types) -> str:
        match node:
            case Atom(text) if text[0] != "?":
                name, types = self.symbols.object(node, needed)
                fits = self.symbols.domain.matches(types, needed)
            case Atom() if node.key in self.variables:
                name, types = self.variables[node.key].name, self.variables[node.key].types
                fits = self.symbols.domain.may_match(types, needed)
            case Atom():
                raise unknown("variable", node, [variable.name for variable in self.variables.values()])
            case Group() if (declared := self.symbols.find_function(node)) and declared.values:
                raise wrong(node, f"{node} cannot be an argument here; expected an object or a variable")
            case Group():
                raise wrong(node, f"expected an object or a variable, found {node}")
        if not fits:
            raise _ill_typed(node, name, types, needed)
        return name

    def is_object(self, node: Node) -> bool:
        """Whether the part stands for an object rather than a number."""
        declared = self.symbols.find_function(node)
        if isinstance(node, Group):
            return declared is not None and bool(declared.values)
        if is_number(node):
            return False
        if node.text[0] == "?":
            return node.key in self.variables or node.key != DURATION[0]
        return self.symbols.find_object(node.text) is not None or declared is None or bool(declared.values)

    def value(self, node: Node, needed: Types = _ANY) -> Expression:
        """Read an object, a variable, or a function with objects for values, of these types."""
        declared = self.symbols.find_function(node)
        if declared is None or not declared.values or (isinstance(node, Atom) and self.symbols.find_object(node.text)):
            return Constant(self._argument(node, needed))
        fluent = self.function(node)
        if not self.symbols.domain.may_match(declared.values, needed):
            raise _ill_typed(node, declared.name, declared.values, needed)
        return ValueOf(fluent)

    def expression(self, node: Node) -> Expression:
        """Read a number, ``?duration``, the value of a function, or arithmetic over these."""
        match node:
            case Group() if node.head in OPERANDS:
                counts, expected = OPERANDS[node.head]
                if len(node.rest) not in counts:
                    raise wrong(node, f"'{node.head}' takes {expected} operands, found {len(node.rest)}")
                return Arithmetic(node.head, tuple([self.expression(part) for part in node.rest]))
            case Group() if self.metric and node.head == IS_VIOLATED:
                (name,) = operands(node, 1)
                if not isinstance(name, Atom):
                    raise wrong(name, f"expected the name of a preference, found {name}")
                if name.key not in self.symbols.preference_names:
                    raise unknown("preference", name, self.symbols.preference_names.values())
                return ValueOf((IS_VIOLATED, self.symbols.preference_names[name.key]))
            case Group():
                return self._number(node)
            case Atom() if is_number(node):
                return Constant(number(node))
            case Atom() if node.key == DURATION[0] and node.key not in self.variables:
                if not self.duration:
                    raise wrong(node, "'?duration' can only be used in the conditions and effects of a durative action")
                return ValueOf(DURATION)
            case Atom("#t"):
                raise Refused.CONTINUOUS_EFFECT.at(node)
            case Atom() if self.symbols.find_function(node) or (self.metric and node.key == TOTAL_TIME):
                return self._number(node)
            case _:
                raise wrong(node, f"expected a number or a function in parentheses, found {node}")

    def _number(self, node: Node) -> Expression:
        declared = self.symbols.find_function(node)
        if self.metric and declared is None and (node.head if isinstance(node, Group) else node.key) == TOTAL_TIME:
            return ValueOf((TOTAL_TIME,))
        if declared is not None and declared.values:
            raise wrong(node, f"the values of {declared.name!r} are objects ({show_types(declared.values)}); expected a number")
        if self.metric:
            self.symbols.requirements.need(node, ":action-costs", ":numeric-fluents")
        return ValueOf(self.function(node))


def _ill_typed(node: Node, name: str, types: Types, needed: Types) -> InputError:
    return wrong(node, f"{name!r} is of type {show_types(types)}; expected {show_types(needed)}")
