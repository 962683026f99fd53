"""Reading YAML as data: no classes, bounded, and every value knows where it stands in its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from sys import float_info
from typing import Final, TypeVar

import yaml

from pnm.errors import InputError, Position
from pnm.text_files import read_text

MAX_BYTES: Final = 4_000_000
MAX_NODES: Final = 200_000
"""Values in a file, those behind an alias counted at every use: an alias bomb is refused."""
MAX_DEPTH: Final = 60

T = TypeVar("T")

_CORE: Final = "tag:yaml.org,2002:"
_TEXTS: Final = frozenset({"str", "timestamp", "value"})
"""Kinds of values that stay text; so do dates, which no action server and no JSON has."""
_PLAIN: Final = frozenset({"map", "seq", "int", "float", "bool", "null"}) | _TEXTS


def load_yaml(path: Path) -> Mapped:
    """Read a YAML file whose top level is a mapping.

    Raises:
        InputError: there is no such file, or it is not YAML, not text, too large, or not a mapping.
    """
    text = read_text(path, MAX_BYTES)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = Position(str(path), mark.line + 1, mark.column + 1) if mark else Position(str(path), 1, 1)
        hint = "; inside braces and brackets a '?' needs quotes" if "'?'" in str(error.problem) else ""
        raise InputError(f"not YAML: {error.problem}{hint}", where) from error
    except yaml.YAMLError as error:
        raise InputError(f"not YAML: {str(error).splitlines()[0]}", Position(str(path), 1, 1)) from error
    except RecursionError as error:
        raise InputError(f"nested deeper than {MAX_DEPTH}", Position(str(path), 1, 1)) from error
    if node is None:
        raise InputError("the file is empty; expected a mapping", Position(str(path), 1, 1))
    _bounded(node, str(path))
    return Mapped.of(node, str(path))


def _bounded(root: yaml.Node, file: str) -> None:
    stack = [(root, 0)]
    count = 0
    while stack:
        node, depth = stack.pop()
        count += 1
        if count > MAX_NODES or depth > MAX_DEPTH:
            what = f"more than {MAX_NODES} values" if count > MAX_NODES else f"nested deeper than {MAX_DEPTH}"
            raise InputError(what, _at(node, file))
        if _kind(node) not in _PLAIN:
            raise InputError(f"the tag {node.tag.replace(_CORE, '!!')} is not allowed; expected plain data", _at(node, file))
        if isinstance(node, yaml.MappingNode):
            stack.extend((part, depth + 1) for pair in reversed(node.value) for part in reversed(pair))
        elif isinstance(node, yaml.SequenceNode):
            stack.extend((part, depth + 1) for part in reversed(node.value))


def _at(node: yaml.Node, file: str) -> Position:
    return Position(file, node.start_mark.line + 1, node.start_mark.column + 1)


def _kind(node: yaml.Node) -> str:
    return str(node.tag).removeprefix(_CORE)


def _plain(node: yaml.Node, file: str) -> object:
    if isinstance(node, yaml.MappingNode):
        return {key: _plain(value, file) for key, (_, value) in Mapped.of(node, file).nodes.items()}
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, file) for item in node.value]
    if _kind(node) in _TEXTS:
        return node.value
    constructor = yaml.SafeLoader("")
    try:
        return constructor.construct_object(node)
    except (yaml.YAMLError, ValueError, LookupError) as error:
        raise InputError(f"cannot be read as {_kind(node)}: {node.value[:40]!r}", _at(node, file)) from error
    finally:
        constructor.dispose()


@dataclass(frozen=True, slots=True)
class Mapped:
    """A mapping read from a file; asking for a key checks its kind and knows its position."""

    file: str
    start: Position
    nodes: Mapping[str, tuple[Position, yaml.Node]]
    """For every key, where the key stands and the value."""

    @staticmethod
    def of(node: yaml.Node, file: str) -> Mapped:
        """Wrap a node, which must be a mapping with text keys, each used once."""
        if not isinstance(node, yaml.MappingNode):
            raise InputError("expected a mapping (key: value)", _at(node, file))
        nodes: dict[str, tuple[Position, yaml.Node]] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise InputError("expected a name as the key", _at(key, file))
            if key.value in nodes:
                raise InputError(f"the key {key.value!r} is there twice", _at(key, file))
            nodes[key.value] = (_at(key, file), value)
        return Mapped(file, _at(node, file), nodes)

    def only(self, *known: str) -> None:
        """Refuse every key but the known ones, naming the nearest."""
        for key, (where, _) in self.nodes.items():
            if key not in known:
                near = get_close_matches(key, known, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
                raise InputError(f"unknown key {key!r}; {hint}", where)

    def position(self, key: str) -> Position:
        """Return where the value of the key stands, or the mapping itself."""
        return _at(self.nodes[key][1], self.file) if key in self.nodes else self.start

    def mapping(self, key: str) -> dict[str, Mapped]:
        """Return a mapping of mappings; empty when the key is not there."""
        if self._empty(key):
            return {}
        inner = Mapped.of(self.nodes[key][1], self.file)
        return {
            name: Mapped(self.file, where, {}) if _is_null(node) else Mapped.of(node, self.file)
            for name, (where, node) in inner.nodes.items()
        }

    def sequence(self, key: str) -> list[Mapped]:
        """Return a list of mappings; empty when the key is not there."""
        if self._empty(key):
            return []
        node = self.nodes[key][1]
        if not isinstance(node, yaml.SequenceNode):
            raise InputError(f"expected a list under {key!r}", _at(node, self.file))
        return [Mapped.of(item, self.file) for item in node.value]

    def strings(self, key: str) -> list[str]:
        """Return a list of texts; empty when the key is not there."""
        value = self.plain(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise InputError(f"expected a list of names under {key!r}", self.position(key))
        return value

    def string(self, key: str) -> str | None:
        """Return a text, or None when the key is not there."""
        value = self.plain(key)
        if value is not None and not isinstance(value, str):
            raise InputError(f"expected a text under {key!r}, found {value!r}", self.position(key))
        return value

    def number(self, key: str, default: T) -> float | T:
        """Return a number that is not negative, or the default when the key is not there."""
        value = self.plain(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= float_info.max:
            raise InputError(f"expected a number of at least 0 under {key!r}, found {value!r}", self.position(key))
        return float(value)

    def whole(self, key: str, default: T) -> int | T:
        """Return a whole number that is not negative, or the default when the key is not there."""
        value = self.number(key, default)
        if not isinstance(value, float):
            return value
        if not value.is_integer():
            raise InputError(f"expected a whole number under {key!r}, found {value:g}", self.position(key))
        return int(value)

    def flag(self, key: str) -> bool:
        """Return true or false; false when the key is not there."""
        value = self.plain(key)
        if value is not None and not isinstance(value, bool):
            raise InputError(f"expected true or false under {key!r}, found {value!r}", self.position(key))
        return bool(value)

    def plain(self, key: str) -> object:
        """Return the value as plain data, or None when the key is not there."""
        return None if self._empty(key) else _plain(self.nodes[key][1], self.file)

    def _empty(self, key: str) -> bool:
        return key not in self.nodes or _is_null(self.nodes[key][1])


def _is_null(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and _kind(node) == "null"
