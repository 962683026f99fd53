"""The declared names of a domain and problem, and the refusal of all others in files about them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite

from pnm.core.logic.expressions import UNDEFINED, Fluent, Unknown, Value, fluent_text
from pnm.errors import InputError, Position, suggestion


class FluentKind(Enum):
    """The kind of a fluent's values."""

    FACT = "predicate"
    NUMBER = "function with numbers for values"
    OBJECT = "function with objects for values"


@dataclass(frozen=True, slots=True)
class Signature:
    """How a predicate or function is used."""

    kind: FluentKind
    parameters: tuple[tuple[str, ...], ...] = ()
    """For every parameter, the types of its objects."""
    values: tuple[str, ...] = ()
    """The types of the objects that are its values."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The declared names of a domain and its problem. Checks raise InputError, with the position and the nearest name."""

    actions: Mapping[str, Mapping[str, tuple[str, ...]]]
    """For every action, its parameters without ``?``, and their types."""
    fluents: frozenset[str] = frozenset()
    """Predicates and functions."""
    objects: frozenset[str] = frozenset()
    derived: frozenset[str] = frozenset()
    """Predicates whose facts follow from others by rules."""
    signatures: Mapping[str, Signature] = field(default_factory=dict)
    """How predicates and functions are used."""
    types: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """For every type, the type itself and its supertypes."""
    types_of: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """For every object, its types and their supertypes."""
    open: frozenset[str] = frozenset()
    """The predicates and functions whose facts may also be about objects that are not declared."""
    is_complete: bool = True
    """Whether there are no other predicates and functions than those declared."""

    def spelled(self, name: str) -> str:
        """Return the declared name that is the same but for capitals, which PDDL does not tell apart; else the name as it is."""
        every = (self.actions, self.fluents, self.objects)
        if any(name in declared for declared in every):
            return name
        return next((one for declared in every for one in declared if one.casefold() == name.casefold()), name)

    def check_action(self, name: str, position: Position) -> None:
        """Refuse an action that is not declared."""
        _check(name, self.actions, "action", position)

    def check_parameter(self, action: str, name: str, position: Position) -> None:
        """Refuse a parameter that the action does not have."""
        known = self.actions[action]
        if name not in known:
            raise InputError(f"{name} is not a parameter of {action} ({', '.join(known) or 'it has none'})", position)

    def arguments(self, action: str, parameter: str) -> tuple[str, ...]:
        """Return the objects that a parameter of an action may stand for, in the order of the alphabet."""
        return self._objects_of(self.actions[action][parameter])

    def values(self, function: str) -> tuple[str, ...]:
        """Return the objects that may be values of a function, in the order of the alphabet; none if its values are numbers."""
        return self._objects_of(self.signatures[function].values) if function in self.signatures else ()

    def _objects_of(self, types: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted(name for name, kinds in self.types_of.items() if not kinds.isdisjoint(types)))

    def check_call(self, what: str, position: Position) -> None:
        """Refuse ``move(r1, hall)`` if the action or an object is not declared, or the number of arguments is wrong."""
        name, _, rest = what.partition("(")
        self.check_action(name, position)
        if rest:
            arguments = [argument.strip() for argument in rest.rstrip(")").split(",") if argument.strip()]
            if len(arguments) != len(self.actions[name]):
                raise InputError(f"{name} takes {len(self.actions[name])} arguments, found {len(arguments)}", position)
            for argument in arguments:
                _check(argument, self.objects, "object", position)

    def check_set(self, name: str, position: Position | None) -> None:
        """Refuse a predicate or function that is not declared, or that is neither set nor reported."""
        _check(name, self.fluents, "predicate or function", position)
        if name in self.derived:
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported", position)

    def check_change(self, fluent: Fluent, value: Value, position: Position) -> None:
        """Refuse a new value of undeclared names, or of what cannot be set."""
        self.check_set(fluent[0], position)
        for argument in (*fluent[1:], *((value,) if isinstance(value, str) and value != UNDEFINED else ())):
            _check(argument, self.objects, "object", position)

    def check_report(self, fluent: Fluent, value: Value | Unknown) -> None:
        """Refuse a reported value of undeclared names, of another kind, or with other arguments than declared."""
        name, text = fluent[0], fluent_text(fluent)
        if not self.may_be_reported(name) or name in self.fluents:
            self.check_set(name, None)
        signature = self.signatures.get(name)
        if signature is None:
            return
        kind = FluentKind.FACT if isinstance(value, bool) else FluentKind.OBJECT if isinstance(value, str) else FluentKind.NUMBER
        if kind is not signature.kind and not isinstance(value, Unknown):
            raise InputError(f"{text} is reported as a {kind.value}; {name} is a {signature.kind.value}")
        if len(fluent) - 1 != len(signature.parameters):
            raise InputError(f"{text} has {len(fluent) - 1} arguments; expected {len(signature.parameters)}")
        for argument, types in zip(fluent[1:], signature.parameters, strict=True):
            self._check_reported(name, argument, types)
        if isinstance(value, str) and value != UNDEFINED:
            self._check_reported(name, value, signature.values)
        if isinstance(value, float) and not isfinite(value):
            raise InputError(f"{text} is reported as {value}; expected a finite number")

    def may_be_reported(self, name: str) -> bool:
        """Return whether there may be facts of this name."""
        return name in self.fluents or not self.is_complete

    def _check_reported(self, name: str, reported: str, types: Iterable[str]) -> None:
        if reported in self.objects or name not in self.open:
            self.check_object(reported, types, None)

    def check_type(self, name: str, position: Position) -> None:
        """Refuse a type that is not declared."""
        _check(name, self.types, "type", position)

    def check_object(self, name: str, types: Iterable[str], position: Position | None) -> None:
        """Refuse an object that is not declared, or that is of none of the types."""
        _check(name, self.objects, "object", position)
        if self.types_of[name].isdisjoint(types):
            raise InputError(f"{name} is a {alternatives(self.types_of[name])}; expected a {alternatives(types)}", position)

    def check_kind(self, name: str, kind: FluentKind, position: Position) -> Signature:
        """Return the signature of a predicate or function, which must be of this kind and not derived."""
        known = [declared for declared, signature in self.signatures.items() if signature.kind is kind]
        if name in self.signatures and name not in known:
            raise InputError(f"{name} is a {self.signatures[name].kind.value}; expected a {kind.value}", position)
        _check(name, known, kind.value, position)
        self.check_set(name, position)
        return self.signatures[name]


def alternatives(types: Iterable[str]) -> str:
    """Return the names of types, any of which would do."""
    return " or ".join(sorted(set(types) - {"object"})) or "object"


def _check(name: str, known: Collection[str], what: str, position: Position | None) -> None:
    if name not in known:
        names = sorted(known)
        hint = suggestion(name, names) or f"expected one of {', '.join(names[:20])}"
        raise InputError(f"there is no {what} {name!r} in the domain; {hint}", position)
