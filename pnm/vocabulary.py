"""The names that files about a domain may use, and a clear refusal of all others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pnm.errors import InputError, Position
from pnm.expressions import UNDEFINED, Fluent, Value
from pnm.nearest import meant


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """What a domain and its problem declare."""

    actions: Mapping[str, tuple[str, ...]]
    """For every action, the names of its parameters, without ``?``."""
    fluents: frozenset[str] = frozenset()
    """Predicates and functions."""
    objects: frozenset[str] = frozenset()
    derived: frozenset[str] = frozenset()
    """Predicates whose facts follow from others by rules."""

    def check_action(self, name: str, position: Position) -> None:
        """Refuse an action that is not there."""
        _check(name, self.actions, "action", position)

    def check_parameter(self, action: str, name: str, position: Position) -> None:
        """Refuse a parameter that the action does not have."""
        known = self.actions[action]
        if name not in known:
            raise InputError(f"{name} is not a parameter of {action} ({', '.join(known) or 'it has none'})", position)

    def check_call(self, what: str, position: Position) -> None:
        """Refuse ``move(r1, hall)`` if there is no such action, or no such object, or not as many parameters."""
        name, _, rest = what.partition("(")
        self.check_action(name, position)
        if rest:
            arguments = [one.strip() for one in rest.rstrip(")").split(",") if one.strip()]
            if len(arguments) != len(self.actions[name]):
                raise InputError(f"{name} takes {len(self.actions[name])} arguments, found {len(arguments)}", position)
            for argument in arguments:
                _check(argument, self.objects, "object", position)

    def check_name(self, name: str, position: Position) -> None:
        """Refuse a predicate or function that is not declared."""
        _check(name, self.fluents, "predicate or function", position)

    def check_set(self, name: str, position: Position) -> None:
        """Refuse a predicate or function that is not declared, or that is neither set nor reported."""
        self.check_name(name, position)
        if name in self.derived:
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported", position)

    def check_change(self, fluent: Fluent, value: Value, position: Position) -> None:
        """Refuse a new value of undeclared names, or of what cannot be set."""
        self.check_set(fluent[0], position)
        for argument in (*fluent[1:], *((value,) if isinstance(value, str) and value != UNDEFINED else ())):
            _check(argument, self.objects, "object", position)


def _check(name: str, known: Iterable[str], what: str, position: Position) -> None:
    names = sorted(known)
    if name not in names:
        hint = meant(name, names) or f"expected one of {', '.join(names[:20])}"
        raise InputError(f"there is no {what} {name!r} in the domain; {hint}", position)
