"""The types, objects and fluents of a problem in unified-planning, each with a name of its own.

There types are a tree: every object has one type and every type one parent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import Any, Final, TypeAlias

import unified_planning.shortcuts as up

from planner_bridge.model.problem import Problem
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Fluent, Variable, fluent_text
from pnm.errors import InputError

ROOT: Final = "object"


class TypeTree:
    """The types of a problem as a tree, for planners without `either`.

    A type with several parents, or an object of several types, is put below what these have in
    common. Where variables of some types would then range over too many objects, `is_exact` is False.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    @cached_property
    def parents(self) -> dict[str, str]:
        """For every type but the root its parent, parents first."""
        parents: dict[str, str] = {}
        waiting = dict(self._problem.domain.types)
        while waiting:
            for name, above in tuple(waiting.items()):
                if waiting.keys().isdisjoint(above):
                    parents[name] = _common([_path(parent, parents) for parent in above] or [[ROOT]])
                    del waiting[name]
        return parents

    @cached_property
    def type_of(self) -> dict[str, str]:
        """For every object its type in the tree."""
        return {name: self._common(types) for name, types in self._problem.objects.items()}

    def cover(self, types: Iterable[str]) -> str:
        """Return the smallest type in the tree that has all objects of the given types."""
        kinds = set(types)
        below = [name for name in self._problem.domain.types if kinds & self._problem.domain.supertypes(name)]
        return self._common([*kinds, *below, *{self.type_of[name] for name in self.extent(kinds)}])

    def extent(self, types: Iterable[str]) -> tuple[str, ...]:
        """Return the objects of one of the types."""
        members = {name for kind in types for name in self._problem.objects_by_type.get(kind, ())}
        return tuple(name for name in self._problem.objects if name in members)

    def is_exact(self, types: Iterable[str]) -> bool:
        """Whether the cover of the types has no other objects than theirs."""
        kinds = set(types)
        cover = self.cover(kinds)
        return len(self.extent(kinds)) == sum(cover in _path(own, self.parents) for own in self.type_of.values())

    def _common(self, types: Iterable[str]) -> str:
        return _common([_path(name, self.parents) for name in types])


def _path(name: str, parents: dict[str, str]) -> list[str]:
    """Return the type and all above it, the root last."""
    path = [name]
    while path[-1] != ROOT:
        path.append(parents[path[-1]])
    return path


def _common(paths: list[list[str]]) -> str:
    return next(name for name in paths[0] if all(name in path for path in paths))


Terms: TypeAlias = Mapping[str, Any]
"""The terms that stand for the variables in scope."""


class Declarations:
    """Types, objects and fluents. The mutable state is the names taken, and the guard predicates for types that the tree lacks."""

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
        """Whether the fluent is declared here: predicates are, and functions that matter."""
        return (fluent[0], len(fluent) - 1) in self._fluents

    def fluent(self, fluent: Fluent) -> Any:
        """Return the fluent in unified-planning, without its arguments; refuse one like ``total-time``, which the domain does not have."""
        if not self.knows(fluent):
            raise InputError(f"the use of {fluent_text(fluent)}")
        return self._fluents[fluent[0], len(fluent) - 1]

    def type_of(self, types: Iterable[str]) -> Any:
        """Return the type there that covers the given types."""
        return self.types[self.tree.cover(types)]

    def variables(self, variables: Iterable[Variable], terms: Terms) -> tuple[tuple[Any, ...], tuple[Any, ...], Terms]:
        """Return the variables of a quantifier, their guards, and the terms in its scope."""
        chosen = {variable: up.Variable(variable.name[1:], self.type_of(variable.types)) for variable in variables}
        inner = {**terms, **{variable.name: up.VariableExp(symbol) for variable, symbol in chosen.items()}}
        return tuple(chosen.values()), tuple(self.guards(chosen, inner)), inner

    def guards(self, variables: Iterable[Variable], terms: Terms) -> Iterator[Any]:
        """Yield the conditions that the variables are of their types, where the tree cannot express it."""
        for variable in variables:
            types = frozenset(variable.types)
            if self.tree.is_exact(types):
                continue
            if types not in self._guards:
                name = self.named(f"is-{'-or-'.join(sorted(types))}")
                guard = self._guards[types] = up.Fluent(name, up.BoolType(), it=self.type_of(types))
                self.translated.add_fluent(guard, default_initial_value=False)
                for member in self.tree.extent(types):
                    self.translated.set_initial_value(guard(self.objects[member]), True)
            yield self._guards[types](terms[variable.name])

    def _declare(self, declared: Declaration, kind: Any, **default: bool) -> None:
        parameters = {f"{variable.name[1:]}-{place}": self.type_of(variable.types) for place, variable in enumerate(declared.parameters)}
        there = self._fluents[declared.name, len(parameters)] = up.Fluent(self.named(declared.name), kind, **parameters)
        self.translated.add_fluent(there, **default)
