"""Bindings fitted to the type of their action server, and the refusal of those that can never work with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pnm.core.machine.bindings import Binding, Table
from pnm.core.message_fields import parse_field
from pnm.errors import InputError
from pnm.ros.node.messages import FieldError, import_type, to_value
from pnm.ros.node.typed_fields import ANY, find_field, fitted_source, fitted_test, item_kind


def fitted_binding(binding: Binding, action_type: Any) -> Binding:
    """Return the binding with the values of the type's constants in the place of their names.

    Raises:
        InputError: the goal has no such field, a constant is of another kind than its field, or the result has no such field.
    """
    for name, source in (binding.goal or {}).items():
        _check(source, find_field(action_type.Goal, parse_field(name)).kind, name)
    for name in binding.store:
        find_field(action_type.Result, parse_field(name))
    success = binding.success and fitted_test(binding.success, action_type.Result)
    reason = binding.reason and fitted_source(binding.reason, action_type.Result, ANY, "a value")
    return replace(binding, success=success, reason=reason)


def _check(source: object, kind: str, path: str) -> None:
    """Refuse what can never be the value of a field of this kind; what only a call knows is looked at when its goal is sent."""
    inner, package = item_kind(kind), kind.rpartition("/")
    match source:
        case Table(_, rows):
            for name, row in rows.items():
                _check(row, kind, f"{path} of {name}")
        case str() if source[:1] in ("?", "$", "("):
            pass
        case Mapping() if inner is None and package[1]:
            message_type = import_type(f"{package[0]}/msg/{package[2]}")
            for name, part in source.items():
                _check(part, find_field(message_type, parse_field(name)).kind, f"{path}.{name}")
        case list() if inner is not None:
            for number, part in enumerate(source):
                _check(part, inner, f"{path}[{number}]")
        case _:
            try:
                to_value(kind, source, path)
            except FieldError as error:
                raise InputError(str(error)) from error
