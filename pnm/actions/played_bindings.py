"""Bindings read backwards, for simulated servers: the arguments that a goal means, and the result that says how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from math import isclose
from typing import assert_never

from pnm.core.machine.bindings import Binding, Table
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import Comparison, Every, Field, Flag, Negation, Some, Test
from pnm.files.yaml_nodes import parse_value

_CLOSE = 1e-6
"""How much numbers may differ: a float32 keeps seven digits."""


def arguments_of(goal: Mapping[str, object], message: Mapping[str, object]) -> dict[str, str] | None:
    """Return the arguments by parameter that a message means which was filled by these goal fields; None if it was not.

    What variables and functions have filled says nothing.
    """
    arguments: dict[str, str] = {}
    return arguments if _fits(goal, message, arguments) else None


def _fits(source: object, value: object, arguments: dict[str, str]) -> bool:
    match source:
        case Table(of, rows):
            fitting = [key for key, row in rows.items() if _fits(row, value, {})]
            return bool(fitting) and _fits(of, fitting[0], arguments)
        case Mapping():
            parts = [(part, value[name]) for name, part in source.items() if name in value] if isinstance(value, Mapping) else []
            return len(parts) == len(source) and all(_fits(part, its, arguments) for part, its in parts)
        case list() | tuple():
            items = value if isinstance(value, list) else []
            return len(items) == len(source) and all(_fits(part, its, arguments) for part, its in zip(source, items, strict=True))
        case str() if source.startswith("?"):
            return arguments.setdefault(source[1:], str(value)) == str(value)
        case str() if source.startswith(("$", "(")):
            return True
        case bool() | str():
            return source == value
        case int() | float():
            return isinstance(value, int | float) and isclose(source, value, rel_tol=_CLOSE, abs_tol=_CLOSE)
        case _:
            return source == value


def result_of(binding: Binding, outcome: Outcome) -> dict[str, object]:
    """Return the result fields by which the binding finds that an action has succeeded, or why it has failed.

    Fields of items in lists are left alone, and so are negations: their defaults have to do. Where numbers stand for reasons, it is the
    one that has the outcome's message for a word, or the first.
    """
    result: dict[str, object] = {}
    if outcome.kind is OutcomeKind.SUCCEEDED:
        if binding.success is not None:
            _satisfy(binding.success, result)
    elif binding.reason is not None and binding.reason.table is None:
        _put(result, binding.reason.field, outcome.message)
    elif binding.reason is not None and binding.reason.table and outcome.kind is OutcomeKind.ABORTED:
        words = {str(word): key for key, word in binding.reason.table.items()}
        _put(result, binding.reason.field, parse_value(words.get(outcome.message, next(iter(words.values()))), "reason"))
    return result


def _satisfy(test: Test, result: dict[str, object]) -> None:
    match test:
        case Flag(where):
            _put(result, where, True)
        case Comparison(where, "eq", constant):
            _put(result, where, constant)
        case Every(tests) | Some(tests):
            for part in tests:
                _satisfy(part, result)
        case Comparison() | Negation():
            pass
        case _:
            assert_never(test)


def _put(result: dict[str, object], where: Field, value: object) -> None:
    *path, last = where.steps
    for step in path:
        inner = result.setdefault(step, {}) if isinstance(step, str) else None
        if not isinstance(inner, dict):
            return
        result = inner
    if isinstance(last, str):
        result[last] = value
