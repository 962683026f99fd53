"""Functions as arguments, ``(dirty (room-of ?r))``: replaced by variables that stand for their values (PDDL 3.1, object fluents).

The variable is bound around the fact, the comparison or the effect in which it stands; where
the function has no value there is no choice for it, so that a fact about it does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from planner_bridge.pddl.read.terms import OPERANDS, TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node
from pnm.core.logic.conditions import Compare
from pnm.core.logic.effects import OPERATIONS
from pnm.core.logic.expressions import Constant, Fluent, ValueOf, Variable

_OVER_NUMBERS: Final = frozenset((*OPERANDS, *OPERATIONS, "=", "<", "<=", ">", ">=", "not"))
"""What is inside these is looked into; it is no argument itself."""


@dataclass(slots=True)
class FlattenedFormula:
    """A list without functions among its arguments. The mutable state grows while it is made."""

    scope: TermScope
    """With the variables that stand for values."""
    variables: dict[Fluent, Variable] = field(default_factory=dict)
    """For every function that was an argument, outermost last."""
    node: Group = field(init=False)

    @property
    def values(self) -> list[Compare]:
        """Say of every variable which value it stands for."""
        return [Compare("=", ValueOf(fluent), Constant(variable.name)) for fluent, variable in self.variables.items()]

    def flat(self, node: Group) -> Group:
        """Return the list with variables for the functions among its arguments."""
        inner = self._looked_into if node.head in _OVER_NUMBERS else self._argument
        return Group((node.items[0], *[inner(part) for part in node.rest]), node.offset, node.source)

    def _looked_into(self, node: Node) -> Node:
        return self.flat(node) if isinstance(node, Group) and node.items else node

    def _argument(self, node: Node) -> Node:
        declared = self.scope.symbols.find_function(node) if isinstance(node, Group) else None
        if not isinstance(node, Group) or declared is None or not declared.values:
            return node
        flat = self.flat(node)  # first, because it may bind variables
        fluent = self.scope.function(flat)
        if fluent not in self.variables:
            self.variables[fluent] = Variable(self._fresh(f"?{declared.name}"), declared.values)
            self.scope = self.scope.inside((self.variables[fluent],))
        return Atom(self.variables[fluent].name, node.offset, node.source)

    def _fresh(self, name: str) -> str:
        found, count = name, 1
        while found.lower() in self.scope.variables:
            count += 1
            found = f"{name}{count}"
        return found


def without_object_fluents(node: Group, scope: TermScope) -> FlattenedFormula | None:
    """Return the fact, comparison or effect without functions among its arguments; None when there are none."""
    if not scope.symbols.has_object_functions:
        return None
    found = FlattenedFormula(scope)
    found.node = found.flat(node)
    return found if found.variables else None
