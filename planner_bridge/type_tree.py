"""PDDL's types as a tree, in which everything is of one type and every type has one parent."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Final

from planner_bridge.model import Problem

ROOT: Final = "object"


class TypeTree:
    """What a problem declares, for planners that know no `either`.

    A type with several parents, or an object of several types, is put below what these have in
    common. Where variables of some types would then range over too many objects, `is_exact` says so.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    @cached_property
    def parents(self) -> dict[str, str]:
        """For every type but the root its parent, parents first."""
        found: dict[str, str] = {}
        waiting = dict(self._problem.domain.types)
        while waiting:
            for name, above in tuple(waiting.items()):
                if not any(one in waiting for one in above):
                    found[name] = _common([_path(one, found) for one in above] or [[ROOT]])
                    del waiting[name]
        return found

    @cached_property
    def type_of(self) -> dict[str, str]:
        """For every object its type in the tree."""
        return {name: self._common(types) for name, types in self._problem.objects.items()}

    def cover(self, types: Iterable[str]) -> str:
        """Return the smallest type in the tree to which belongs whatever is of one of the types."""
        kinds = set(types)
        below = [name for name in self._problem.domain.types if kinds & self._problem.domain.supertypes(name)]
        return self._common([*kinds, *below, *{self.type_of[name] for name in self.extent(kinds)}])

    def extent(self, types: Iterable[str]) -> tuple[str, ...]:
        """Return the objects of one of the types."""
        members = {name for kind in types for name in self._problem.objects_by_type.get(kind, ())}
        return tuple(name for name in self._problem.objects if name in members)

    def is_exact(self, types: Iterable[str]) -> bool:
        """Tell whether the cover of the types has no other objects than theirs."""
        kinds = set(types)
        cover = self.cover(kinds)
        return len(self.extent(kinds)) == sum(cover in _path(own, self.parents) for own in self.type_of.values())

    def _common(self, types: Iterable[str]) -> str:
        return _common([_path(one, self.parents) for one in types])


def _path(name: str, parents: dict[str, str]) -> list[str]:
    """Return the type and all above it, the root last."""
    path = [name]
    while path[-1] != ROOT:
        path.append(parents[path[-1]])
    return path


def _common(paths: list[list[str]]) -> str:
    return next(name for name in paths[0] if all(name in path for path in paths))
