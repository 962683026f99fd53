"""Bindings as YAML: beside the parts of an action in the language, or as a bindings file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Final

from planner_bridge.pddl.expressions import number_text
from planner_bridge.yaml import emitter
from planner_bridge.yaml.emitter import Bare, Entry, Value, document, items
from pnm.core.machine.bindings import DEFAULT, NO_BINDINGS, Binding, Bindings, Foreign, Table, WhenLost
from pnm.core.message_fields import Comparison, Every, FieldValue, Flag, Negation, Some

LANGUAGE_DEFAULT: Final = Binding(retries=0)
"""The keys of an action in the language without information."""


def binding_entries(binding: Binding, usual: Binding, *, type_key: str) -> Iterator[Entry]:
    """Yield a key for everything that is not as usual."""
    for field in fields(binding):
        value = getattr(binding, field.name)
        if field.compare and value != getattr(usual, field.name):
            yield Entry(_value(value), type_key if field.name == "type" else field.name)


def write_bindings(bindings: Bindings) -> str:
    """Write a bindings file; an empty text if all is as usual."""
    parts = {name: tuple(binding_entries(binding, DEFAULT, type_key="type")) for name, binding in bindings.actions.items()}
    actions = tuple([Entry(emitter.Mapping(entries), name) for name, entries in parts.items() if entries])
    return document(emitter.Mapping((Entry(emitter.Mapping(actions), "actions"),))) if actions else ""


def unwritten(bindings: Bindings) -> tuple[str, ...]:
    """Return the keys of a bindings file that have no place in exported YAML."""
    return tuple(key for key in ("assumed", "lag") if getattr(bindings, key) != getattr(NO_BINDINGS, key))


def _value(value: object) -> Value:
    match value:
        case str():
            return value
        case Foreign() | WhenLost():
            return str(value.value)
        case Table(of, rows):
            return _value({"of": of, "table": rows})
        case FieldValue(field, None):
            return str(field)
        case FieldValue(field, table):
            return _value({"field": str(field), "table": table})
        case Flag(field):
            return _value({"field": str(field)})
        case Comparison(field, operation, constant):
            return _value({"field": str(field), operation: constant})
        case Negation(test):
            return _value({"not": test})
        case Every(tests):
            return _value({"all": tests})
        case Some(tests):
            return _value({"any": tests})
        case Mapping():
            return emitter.Mapping(tuple([Entry(_value(inner), str(key)) for key, inner in value.items()]), short=True)
        case list() | tuple():
            return items(map(_value, value), short=True)
        case float():
            return Bare(number_text(value))
        case _:
            return Bare(json.dumps(value))
