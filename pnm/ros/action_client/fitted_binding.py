"""Bindings fitted to the type of their action server, and the refusal of those that can never work with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from pnm.core.logic.computed_values import MISSING
from pnm.core.machine.bindings import Binding, Table
from pnm.core.message_fields import parse_field
from pnm.errors import InputError
from pnm.ros.node.messages import FieldError, import_type, to_value
from pnm.ros.node.typed_fields import ANY, find_field, fitted_source, fitted_test, item_kind

Example = Callable[[str], object]
"""Returns a value that a parameter, a variable or a fluent may have; `MISSING` if its kind is not known."""


def fitted_binding(binding: Binding, action_type: Any, example: Example = lambda source: MISSING) -> Binding:
    """Return the binding with the values of the type's constants in the place of their names.

    Args:
        binding: of the action.
        action_type: of its server.
        example: says which kinds of values goal fields are filled with.

    Raises:
        InputError: the goal has no such field, a constant is of another kind than its field, or the result has no such field.
    """
    for name, source in (binding.goal or {}).items():
        _check(source, find_field(action_type.Goal, parse_field(name)).kind, name, example)
    for name in binding.store:
        find_field(action_type.Result, parse_field(name))
    success = binding.success and fitted_test(binding.success, action_type.Result)
    reason = binding.reason and fitted_source(binding.reason, action_type.Result, ANY, "a value")
    final = binding.final and fitted_test(binding.final, action_type.Result)
    return replace(binding, success=success, reason=reason, final=final)


def _check(source: object, kind: str, path: str, example: Example) -> None:
    """Refuse what can never be the value of a field of this kind; what only a call knows is looked at when its goal is sent."""
    inner, package = item_kind(kind), kind.rpartition("/")
    match source:
        case Table(_, rows):
            for name, row in rows.items():
                _check(row, kind, f"{path} of {name}", example)
        case str() if source[:1] in ("?", "$", "("):
            value = example(source)
            if value is not MISSING:
                _check_value(kind, value, f"{path}, which is filled from {source},")
        case Mapping() if inner is None and package[1]:
            message_type = import_type(f"{package[0]}/msg/{package[2]}")
            for name, part in source.items():
                _check(part, find_field(message_type, parse_field(name)).kind, f"{path}.{name}", example)
        case list() if inner is not None:
            for number, part in enumerate(source):
                _check(part, inner, f"{path}[{number}]", example)
        case _:
            _check_value(kind, source, path)


def _check_value(kind: str, value: object, path: str) -> None:
    try:
        to_value(kind, value, path)
    except FieldError as error:
        raise InputError(f"field {error.path} needs {error.needs}, got {error.got}") from error
