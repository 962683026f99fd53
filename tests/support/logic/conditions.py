"""A state that is known in part, as conditions are evaluated in it."""

from __future__ import annotations

from dataclasses import dataclass, field

from pnm.core.logic.expressions import Fluent, Unknown, Value

Facts = dict[Fluent, Value | Unknown]
OBJECTS = ("a", "b")


@dataclass
class GivenState:
    """A state given by its facts; absent fluents are not recorded."""

    facts: Facts = field(default_factory=dict)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.facts.get(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return OBJECTS if types == ("object",) else ()

    def because(self, fluent: Fluent, /) -> str:
        return "because it is 3" if self.facts.get(fluent) == 3.0 else ""
