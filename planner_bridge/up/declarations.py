"""What a problem talks about, in unified-planning: types, objects and fluents, each with a name of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeAlias

import unified_planning.shortcuts as up

from planner_bridge.model import Declaration, Problem
from planner_bridge.type_tree import ROOT, TypeTree
from pnm.errors import InputError
from pnm.expressions import Fluent, Variable, show

Terms: TypeAlias = Mapping[str, Any]
"""What the variables in scope have become."""


class Declarations:
    """Types, objects and fluents. The mutable state is the names that are taken, and what guards types that the tree lacks."""

    def __init__(self, problem: Problem, translated: up.Problem, functions: frozenset[str], whole: bool) -> None:
        self.tree = TypeTree(problem)
        self.translated = translated
        self._taken: set[str] = set()
        self._guards: dict[frozenset[str], Any] = {}
        self.types = {ROOT: up.UserType(self.named(ROOT))}
        for name, parent in self.tree.parents.items():
            self.types[name] = up.UserType(self.named(name), self.types[parent])
        self.objects = {name: up.Object(self.named(name), self.types[kind]) for name, kind in self.tree.type_of.items()}
        translated.add_objects(self.objects.values())
        self._fluents: dict[tuple[str, int], Any] = {}  # a predicate and a function may differ in nothing but their arity
        for declared in problem.domain.predicates.values():
            self._declare(declared, up.BoolType(), default_initial_value=False)
        for declared in problem.domain.functions.values():
            if declared.name in functions:
                number = up.IntType() if whole else up.RealType()
                self._declare(declared, self.type_of(declared.values) if declared.values else number)

    def named(self, name: str) -> str:
        """Return the name, changed if something else has it already: in unified-planning one name has one meaning."""
        while name in self._taken:
            name += "-"
        self._taken.add(name)
        return name

    def knows(self, fluent: Fluent) -> bool:
        """Tell whether the fluent is one of those that matter."""
        return (fluent[0], len(fluent) - 1) in self._fluents

    def fluent(self, fluent: Fluent) -> Any:
        """Return the fluent in unified-planning, without its arguments.

        Raises:
            InputError: it is none of the domain's, such as the ``total-time`` of a metric.
        """
        if not self.knows(fluent):
            raise InputError(f"the use of {show(fluent)}")
        return self._fluents[fluent[0], len(fluent) - 1]

    def type_of(self, types: Iterable[str]) -> Any:
        """Return the type of what is of one of the types."""
        return self.types[self.tree.cover(types)]

    def variables(self, variables: Iterable[Variable], terms: Terms) -> tuple[tuple[Any, ...], tuple[Any, ...], Terms]:
        """Return the variables of a quantifier, what must hold of them, and the terms in its scope."""
        chosen = {variable: up.Variable(variable.name[1:], self.type_of(variable.types)) for variable in variables}
        inner = {**terms, **{variable.name: up.VariableExp(one) for variable, one in chosen.items()}}
        return tuple(chosen.values()), tuple(self.guards(chosen, inner)), inner

    def guards(self, variables: Iterable[Variable], terms: Terms) -> Iterator[Any]:
        """Yield what says that the variables are of their types, where the tree cannot say it."""
        for variable in variables:
            types = frozenset(variable.types)
            if not self.tree.is_exact(types):
                yield self._guard(types)(terms[variable.name])

    def _guard(self, types: frozenset[str]) -> Any:
        if types not in self._guards:
            guard = up.Fluent(self.named(f"is-{'-or-'.join(sorted(types))}"), up.BoolType(), it=self.type_of(types))
            self.translated.add_fluent(guard, default_initial_value=False)
            for name in self.tree.extent(types):
                self.translated.set_initial_value(guard(self.objects[name]), True)
            self._guards[types] = guard
        return self._guards[types]

    def _declare(self, declared: Declaration, kind: Any, **default: bool) -> None:
        parameters = {f"{variable.name[1:]}-{place}": self.type_of(variable.types) for place, variable in enumerate(declared.parameters)}
        there = self._fluents[declared.name, len(parameters)] = up.Fluent(self.named(declared.name), kind, **parameters)
        self.translated.add_fluent(there, **default)
