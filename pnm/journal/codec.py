"""A codec of frozen values: what a journal holds, as JSON text and back.

Classes are named by their tag, so that a journal says what it holds; only classes that the codec was made with are read back. A
field that has its default is left out, which is why a new field with a default needs no new version of the format. Where the type of
a field says that it has an identity, or the member of an enum, no tag does. JSON has no tuples, sets or mappings by anything but
text: arrays are tuples, which nearly all sequences here are; the others have tags.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING as NO_DEFAULT, Field, fields, is_dataclass
from enum import Enum
from functools import lru_cache
from json.encoder import encode_basestring as _quoted
from math import isfinite
from types import ModuleType
from typing import Any, Final, NamedTuple
from uuid import UUID

from pnm import clock, errors, tasks
from pnm.core import message_fields, resources
from pnm.core.execution import call_data, call_results, events, handover
from pnm.core.logic import computed_values, conditions, effects, expressions, rules
from pnm.core.logic.computed_values import MISSING
from pnm.core.machine import bindings, failure_causes, machine, plan_graph, requests
from pnm.errors import PnmError
from pnm.journal import records

_TAG: Final = "@"
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_PLAIN: Final[frozenset[type]] = frozenset({str, int, float, bool, type(None)})
_PLAIN_NAMES: Final = frozenset(kind.__name__ for kind in _PLAIN)
_ARRAY_OF: Final = re.compile(r"tuple\[(\w+), \.\.\.\]")
"""The type of a field that has an array of values of one class."""


class Undecodable(PnmError):
    """A value cannot be written, or a text is no value that the codec knows."""


def value_classes(*modules: ModuleType) -> tuple[type, ...]:
    """Return the dataclasses, enums and named tuples that the modules define for others."""
    classes = (
        entry
        for module in modules
        for entry in vars(module).values()
        if isinstance(entry, type) and entry.__module__ == module.__name__ and not entry.__name__.startswith("_")
    )
    return tuple(kind for kind in classes if is_dataclass(kind) or issubclass(kind, Enum) or hasattr(kind, "_fields"))


class Codec:
    """Writes and reads values of some dataclasses, enums and named tuples, and of what JSON has besides."""

    def __init__(self, classes: Iterable[type]) -> None:
        self._classes = {kind.__name__: kind for kind in classes}
        self._writers = _Writers(self._writer)
        self._readers: dict[str | None, Callable[[dict[str, Any]], Any]] = {}
        self._decoder = json.JSONDecoder(object_hook=self._object)

    def including(self, classes: Iterable[type]) -> Codec:
        """Return a codec that knows these classes as well."""
        return Codec((*self._classes.values(), *classes))

    def text(self, value: object) -> str:
        """Return the value as JSON text; raise `Undecodable` for one of another class."""
        text = self._written(value)
        # half of a surrogate pair, such as a terminal gives for a byte that is no UTF-8, is a text for Python, but not for a database
        return text if text.isascii() else _SURROGATE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)

    def value(self, text: str) -> Any:
        """Return the value of a text; raise `Undecodable` if it is none that the codec knows."""
        try:
            value, end = self._decoder.raw_decode(text)
            if end < len(text):
                raise ValueError("something follows it")
            return _whole(value)
        except (ValueError, TypeError, KeyError) as error:
            raise Undecodable(f"not a value of this version: {text[:80]}: {error}") from error
        except RecursionError as error:
            raise Undecodable(f"not a value of this version: {text[:80]}: nested too deep") from error

    # --- writing ------------------------------------------------------------------------------

    def _writer(self, kind: type) -> Callable[[Any], str]:
        written = self._written
        if kind is tuple:
            return self._array
        if kind is UUID:
            return lambda value: f'{{"{_TAG}":"id","hex":"{value.hex}"}}'
        if self._classes.get(kind.__name__) is kind:
            return self._class_writer(kind)
        if issubclass(kind, list):
            return lambda value: f'{{"{_TAG}":"list","items":{self._array(value)}}}'
        if issubclass(kind, frozenset | set):
            return lambda value: f'{{"{_TAG}":"set","items":[{",".join(sorted(map(written, value)))}]}}'
        if issubclass(kind, Mapping):
            return self._mapping
        if issubclass(kind, bytes | bytearray):
            return lambda value: f'{{"{_TAG}":"bytes","hex":"{value.hex()}"}}'
        if kind is type(MISSING):
            return lambda value: f'{{"{_TAG}":"missing"}}'
        for base in (bool, int, float, str):  # of a foreign library, such as numpy
            if issubclass(kind, base):
                return lambda value: written(base(value))
        raise Undecodable(f"a journal has no {kind.__module__}.{kind.__qualname__}")

    def _class_writer(self, kind: Any) -> Callable[[Any], str]:
        writers, begin = self._writers, f'{{"{_TAG}":{_quoted(kind.__name__)}'
        if issubclass(kind, Enum):
            return lambda value: f'{begin},"name":{_quoted(value.name)}}}'
        if issubclass(kind, tuple):
            return lambda value: f'{begin},"items":{self._array(value)}}}'
        parts: list[tuple[str, str, object, type | None, _Short | None]] = []
        for field in (field for field in fields(kind) if field.init):
            factory = field.default_factory  # of a default that is not always the same: what is empty by default
            empty = None if factory is NO_DEFAULT else type(factory())
            default = _NONE_SUCH if field.default is NO_DEFAULT else field.default
            parts.append((field.name, f",{_quoted(field.name)}:", default, empty, self._short(field)))

        def write(value: Any) -> str:
            text = begin
            for name, label, default, empty, short in parts:
                held = getattr(value, name)
                if held is not default and (held or type(held) is not empty):
                    text += label + (writers[type(held)](held) if short is None else short.write(held))
            return text + "}"

        return write

    def _short(self, field: Field[Any]) -> _Short | None:
        """Return the writer of a field whose type says its content, so that no tag need say it."""
        match field.type:
            case "UUID":
                return _Short(_hex, _uuid)
            case "tuple[UUID, ...]":
                return _Short(lambda ids: f"[{','.join(map(_hex, ids))}]", lambda texts: tuple(map(_uuid, texts)))
            case "Changes" | "Mapping[Fluent, Value | Unknown]":
                return _Short(self._facts, lambda pairs: {tuple(fluent): value for fluent, value in pairs})
            case str(name) if issubclass(kind := self._classes.get(name, object), Enum):
                return _Short(lambda member: _quoted(member.name), lambda name: kind[name])
            case _:
                return None

    def _array(self, value: Iterable[object]) -> str:
        writers = self._writers
        return f"[{','.join([writers[type(item)](item) for item in value])}]"

    def _facts(self, value: Mapping[tuple[str, ...], object]) -> str:
        writers, array = self._writers, self._array
        return f"[{','.join([f'[{array(fluent)},{writers[type(held)](held)}]' for fluent, held in value.items()])}]"

    def _mapping(self, value: Mapping[object, object]) -> str:
        written = self._written
        if all(type(key) is str for key in value) and _TAG not in value:
            return f"{{{','.join([f'{written(key)}:{written(item)}' for key, item in value.items()])}}}"
        return f'{{"{_TAG}":"map","items":{self._array(value.items())}}}'

    def _written(self, value: object) -> str:
        return self._writers[type(value)](value)

    # --- reading ------------------------------------------------------------------------------

    def _object(self, entry: dict[str, Any]) -> Any:
        """Read an object whose own values have been read; lists in it are tuples from now on."""
        tag = entry.pop(_TAG, None)
        reader = self._readers.get(tag)
        if reader is None:
            kind = self._classes.get(tag or "")
            reader = self._readers[tag] = self._class_reader(kind) if is_dataclass(kind) else self._reader(tag)
        return reader(entry)

    def _class_reader(self, kind: Any) -> Callable[[dict[str, Any]], Any]:
        readers: list[tuple[str, Callable[[Any], Any]]] = []
        for field in fields(kind):
            array = _ARRAY_OF.fullmatch(str(field.type))
            if (short := self._short(field)) is not None:
                readers.append((field.name, short.read))
            elif array is not None and (array[1] in _PLAIN_NAMES or array[1] in self._classes):
                readers.append((field.name, tuple))  # what is in it has been read
            elif field.type not in _PLAIN_NAMES:
                readers.append((field.name, _whole))

        def read(entry: dict[str, Any]) -> Any:
            for name, reader in readers:
                if name in entry:
                    entry[name] = reader(entry[name])
            return kind(**entry)

        return read

    def _reader(self, tag: str | None) -> Callable[[dict[str, Any]], Any]:
        if tag is None:
            return lambda entry: {name: _whole(item) for name, item in entry.items()}
        if tag in _READERS:
            return _READERS[tag]
        kind: Any = self._classes.get(tag)
        if kind is None:
            raise Undecodable(f"there is no {tag} in this version")
        if issubclass(kind, Enum):
            return lambda entry: kind[entry["name"]]
        return lambda entry: kind(*_whole(entry["items"]))


class _Writers(dict[type, Callable[[Any], str]]):
    """The writer of the values of a class as JSON text, made at the first of them, without JSON values in between: they cost as much."""

    def __init__(self, make: Callable[[type], Callable[[Any], str]]) -> None:
        super().__init__(
            {
                str: _quoted,
                int: int.__repr__,
                float: lambda value: float.__repr__(value) if isfinite(value) else json.dumps(value),
                bool: {True: "true", False: "false"}.__getitem__,
                type(None): lambda _: "null",
            }
        )
        self._make = make

    def __missing__(self, kind: type) -> Callable[[Any], str]:
        writer = self[kind] = self._make(kind)
        return writer


class _Short(NamedTuple):
    """The writer and the reader of a field whose type says its content."""

    write: Callable[[Any], str]
    read: Callable[[Any], Any]


class _List:
    """A list that was read, which is no array of what it stands in: arrays are tuples."""

    def __init__(self, items: Iterable[Any]) -> None:
        self.items = items


def _whole(value: Any) -> Any:
    """Return a value that was read with its arrays as tuples, and its lists as lists."""
    array = _ARRAYS.get(type(value))
    return value if array is None else array(value)


_ARRAYS: Final[Mapping[type, Callable[[Any], Any]]] = {
    list: lambda items: tuple([item if type(item) in _PLAIN else _whole(item) for item in items]),
    _List: lambda value: list(value.items),
}


def _hex(identity: UUID) -> str:
    return f'"{identity.hex}"'


@lru_cache(maxsize=10_000)
def _uuid(text: str) -> UUID:
    """Return an identity; that of a request is in several records, and making one takes longer than reading the rest of its field."""
    return UUID(int=int(text, 16))


_READERS: Final[Mapping[str, Callable[[dict[str, Any]], Any]]] = {
    "id": lambda entry: _uuid(entry["hex"]),
    "list": lambda entry: _List(_whole(entry["items"])),
    "set": lambda entry: frozenset(_whole(entry["items"])),
    "map": lambda entry: dict(_whole(entry["items"])),
    "bytes": lambda entry: bytes.fromhex(entry["hex"]),
    "missing": lambda _: MISSING,
}
"""The readers of what has a tag and is no value of a class."""


_NONE_SUCH: Final = object()


# --- the values that records are made of -----------------------------------------------

RECORDS: Final = Codec(
    value_classes(
        *(clock, errors, message_fields, resources, computed_values, conditions, effects, expressions, rules),
        *(bindings, failure_causes, machine, plan_graph, requests, call_data, call_results, events, handover, tasks, records),
    )
)
"""The codec of what reaches runs, and of what they are made from."""
