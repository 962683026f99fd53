"""Reading YAML as data: no classes, bounded, and every value knows where it stands in its file.

A plain scalar is what the core schema of YAML 1.2 says (section 10.3.2): of the words only ``true`` and ``false`` are
truth values, so ``no`` is a text here as it is when a person types it, and ``12:30`` is not 750. Anchors, aliases and merge
keys (``<<: *base``) mean what YAML 1.1 says: own keys count before merged ones, and what is merged first before what is merged later.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import chain, count
from math import isfinite
from pathlib import Path
from sys import float_info
from typing import Any, Final, TypeVar

import yaml

from pnm.errors import InputError, Position, suggestion
from pnm.files.text import read_text

NO_ANCHORS: Final[Mapping[str, Mapping[str, str]]] = {}
MAX_BYTES: Final = 4_000_000
_LISTED: Final = 14
"""Keys that an error names, at most."""

T = TypeVar("T")
E = TypeVar("E", bound=Enum)


def load_yaml(path: Path | str) -> Mapped:
    """Read a YAML file whose top level is a mapping; raise `InputError` for anything else."""
    documents = parse_yaml(read_text(path, MAX_BYTES), str(path))
    if len(documents) > 1:
        raise InputError("a second document begins here; expected one", documents[1].start)
    return documents[0]


def parse_yaml(text: str, file: str, anchors: Mapping[str, Mapping[str, str]] = NO_ANCHORS) -> tuple[Mapped, ...]:
    """Read YAML documents, at least one and each a mapping; `anchors` has the mappings for aliases that the text does not define."""
    return tuple([node.mapped() for node in compose(text, file, anchors)])


def parse_value(text: str, origin: str) -> object:
    """Read a single value, such as one from a command line; nothing is an empty text. Errors name its `origin`."""
    if not text.strip():
        return ""
    first, *others = compose(text, origin)
    if others:
        raise others[0].wrong("a second document begins here; expected one")
    return first.plain()


def texts_in(value: object) -> Iterator[str]:
    """Yield every text in plain data, at any depth; keys are none."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from texts_in(part)


@dataclass(frozen=True, slots=True)
class Mapped:
    """A mapping read from a file. Whatever is asked of it raises InputError, with the position, when it is something else."""

    file: str
    start: Position
    nodes: Mapping[str, tuple[Position, Node]]
    """For every key, where the key stands and the value."""

    def without(self, key: str) -> Mapped:
        """Return the other keys."""
        return Mapped(self.file, self.start, {name: value for name, value in self.nodes.items() if name != key})

    def only(self, *known: str) -> None:
        """Refuse every key but the known ones, naming the nearest."""
        for key, (where, _) in self.nodes.items():
            if key not in known:
                names = [*dict.fromkeys(known)]
                listed = ", ".join((*names[:_LISTED], *(["…"] if names[_LISTED:] else ())))
                hint = suggestion(key, known) or f"expected one of {listed}"
                raise InputError(f"unknown key {key!r}; {hint}", where)

    def position(self, key: str) -> Position:
        """Return where the value of the key stands, or the mapping itself."""
        return self.nodes[key][1].position if key in self.nodes else self.start

    def mappings(self) -> dict[str, Mapped]:
        """Return the mappings that all values must be."""
        return {name: Mapped(self.file, where, {}) if node.is_null else node.mapped() for name, where, node in self.entries()}

    def sequence(self, key: str) -> list[Mapped]:
        """Return a list of mappings; empty when the key is not there."""
        node = self.filled(key)
        if node is None:
            return []
        if node.items is None:
            raise node.wrong(f"expected a list under {key!r}")
        return [item.mapped() for item in node.items]

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
        return self._of_kind(key, str, "a text")

    def flag(self, key: str) -> bool:
        """Return true or false; false when the key is not there."""
        return bool(self._of_kind(key, bool, "true or false"))

    def _of_kind(self, key: str, kind: type[T], expected: str) -> T | None:
        value = self.plain(key)
        if value is not None and not isinstance(value, kind):
            raise InputError(f"expected {expected} under {key!r}, found {value!r}", self.position(key))
        return value

    def number(self, key: str, default: T) -> float | T:
        """Return a number that is not negative, or the default when the key is not there."""
        value = self.plain(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= float_info.max:
            is_quoted = isinstance(value, str) and value.replace(".", "", 1).isdecimal()
            hint = "; a number has no quotes" if is_quoted else ""
            raise InputError(f"expected a number of at least 0 under {key!r}, found {value!r}{hint}", self.position(key))
        return float(value)

    def whole(self, key: str, default: T) -> int | T:
        """Return a whole number that is not negative, or the default when the key is not there."""
        value = self.number(key, default)
        if not isinstance(value, float):
            return value
        if not value.is_integer():
            raise InputError(f"expected a whole number under {key!r}, found {value:g}", self.position(key))
        return int(value)

    def choice(self, key: str, kinds: type[E]) -> E | None:
        """Return one of the values of an enumeration, or None when the key is not there."""
        value, words = self.plain(key), [str(kind.value) for kind in kinds]
        if value is not None and value not in words:
            raise InputError(f"expected one of {', '.join(words)} under {key!r}, found {value!r}", self.position(key))
        return None if value is None else kinds(value)

    def plain(self, key: str) -> object:
        """Return the value as plain data, or None when the key is not there."""
        node = self.filled(key)
        return None if node is None else node.plain()

    def node(self, key: str) -> Node | None:
        """Return the value as it stands, or None when the key is not there."""
        return self.nodes[key][1] if key in self.nodes else None

    def filled(self, key: str) -> Node | None:
        """Return the value; None when the key is not there, or has none."""
        node = self.node(key)
        return None if node is None or node.is_null else node

    def listed(self, key: str) -> tuple[Node, ...]:
        """Return the items of a list, or the one value that stands for itself; nothing when the key is not there, or has none."""
        node = self.filled(key)
        return () if node is None else node.listed

    def section(self, key: str) -> Mapped:
        """Return the mapping under a key; an empty one when the key is not there, or has none."""
        node = self.filled(key)
        return Mapped(self.file, self.start, {}) if node is None else node.mapped()

    def needed(self, key: str) -> Node:
        """Return the value of a key that must be there."""
        if key not in self.nodes:
            raise InputError(f"the key {key!r} is missing", self.start)
        return self.nodes[key][1]

    def entries(self) -> tuple[tuple[str, Position, Node], ...]:
        """Return every key with where it stands and its value, merged ones first."""
        return tuple((key, where, node) for key, (where, node) in self.nodes.items())


@dataclass(frozen=True, slots=True)
class Node:
    """Any value read from a file, to be looked at by its kind."""

    file: str
    raw: yaml.Node

    @property
    def position(self) -> Position:
        """The position of the value."""
        return Position(self.file, self.raw.start_mark.line + 1, self.raw.start_mark.column + 1)

    @property
    def kind(self) -> str:
        """Its tag, without what all plain ones begin with."""
        return str(self.raw.tag).removeprefix(CORE)

    def position_of(self, word: str) -> Position:
        """Return where a word stands in the value, or where the value does if the file spells it in another way."""
        start, end = self.raw.start_mark, self.raw.end_mark
        written = (start.buffer or "")[start.pointer : start.pointer + end.index - start.index]
        match = re.search(rf"(?<![^\s()\[\]{{}},'\"]){re.escape(word)}(?![^\s()\[\]{{}},:'\"])", written)
        if match is None or word == self.text:
            return self.position
        before = written[: match.start()]
        lines = before.count("\n")
        column = len(before) - before.rfind("\n") if lines else start.column + len(before) + 1
        return Position(self.file, start.line + 1 + lines, column)

    @property
    def is_null(self) -> bool:
        """Whether there is nothing: ``null``, or no value at all."""
        return isinstance(self.raw, yaml.ScalarNode) and self.kind == "null"

    @property
    def is_mapping(self) -> bool:
        """Whether it has keys and values."""
        return isinstance(self.raw, yaml.MappingNode)

    @property
    def is_in_braces(self) -> bool:
        """Whether it is a mapping in braces, or a list in brackets, and so may have no lines of its own."""
        return isinstance(self.raw, yaml.CollectionNode) and bool(self.raw.flow_style)

    @property
    def items(self) -> tuple[Node, ...] | None:
        """The items of a list; None for anything else."""
        return tuple(Node(self.file, item) for item in self.raw.value) if isinstance(self.raw, yaml.SequenceNode) else None

    @property
    def each(self) -> tuple[Node, ...]:
        """The items of a list, or the value itself."""
        return (self,) if self.items is None else self.items

    @property
    def listed(self) -> tuple[Node, ...]:
        """The items of a list, or the value itself; nothing for nothing."""
        return () if self.is_null else self.each

    @property
    def text(self) -> str | None:
        """A text; None for anything else, numbers and truth values included."""
        return self.raw.value if isinstance(self.raw, yaml.ScalarNode) and self.kind in TEXTS else None

    @property
    def written(self) -> str:
        """The text of a scalar in the file, without quotes; empty for lists and mappings."""
        return self.raw.value if isinstance(self.raw, yaml.ScalarNode) else ""

    def texts(self, *left_out: str) -> Iterator[Node]:
        """Yield every text in it, at any depth; not what stands under the keys that are left out."""
        if self.text is not None:
            yield self
        parts = [node for key, _, node in self.mapped().entries() if key not in left_out] if self.is_mapping else self.items or ()
        for part in parts:
            yield from part.texts(*left_out)

    def mapped(self) -> Mapped:
        """Return the mapping that it must be, with text keys, each used once."""
        if not self.is_mapping:
            raise self.wrong("expected a mapping (key: value)")
        nodes: dict[str, tuple[Position, Node]] = {}
        merged: dict[str, tuple[Position, Node]] = {}
        for key, value in ((Node(self.file, key), Node(self.file, value)) for key, value in self.raw.value):
            if key.is_mapping or key.items is not None:
                raise key.wrong("expected a name as the key")
            if key.kind == "merge":
                for source in value.each:
                    merged = {**source.mapped().nodes, **merged}
                continue
            if key.written in nodes:
                raise key.wrong(f"the key {key.written!r} is there twice")
            nodes[key.written] = (key.position, value)
        return Mapped(self.file, self.position, {**merged, **nodes})

    def plain(self) -> object:
        """Return it as plain data."""
        if self.is_mapping:
            return {key: value.plain() for key, _, value in self.mapped().entries()}
        if self.items is not None:
            return [item.plain() for item in self.items]
        try:
            value = self._scalar()
            str(value)  # no message and no JSON could name a number of more than 4300 digits, which hexadecimal ones may have
        except ValueError as error:
            raise self.wrong(f"cannot be read as {self.kind}: {self.written[:40]!r}") from error
        if isinstance(value, float) and not isfinite(value):
            raise self.wrong(f"expected a finite number, found {self.written}")
        return value

    def _scalar(self) -> str | float | bool | None:
        """Return the value of a scalar; raise `ValueError` for a text that its tag does not allow."""
        name, text = self.kind, self.written
        if name in TEXTS:
            return text
        if not _SCALARS[name][0].match(text):
            raise ValueError(f"{text!r} is no {name}")
        match name:
            case "null":
                return None
            case "bool":
                return text.lower() == "true"
            case "int":
                return int(text, 0 if text[:2] in ("0o", "0x") else 10)
            case _:
                return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))

    def wrong(self, message: str) -> InputError:
        """Return the error to raise about it."""
        return InputError(message, self.position)


# --- from text to nodes, bounded in size and depth, aliases counted at every use -----------


MAX_NODES: Final = 200_000
"""Values in a file, those behind an alias counted at every use: an alias bomb is refused."""
MAX_DEPTH: Final = 60
MAX_DOCUMENTS: Final = 100

_PDDL: Final = re.compile(r"(?:\s|;.*\n)*\(\s*define\b", re.IGNORECASE)

_HINTS: Final = {
    "expected ':'": "a key has a colon and a space behind it",
    "'?'": "inside braces and brackets a '?' needs quotes",
    "'{'": "inside braces and brackets a text with '{' needs quotes",
    "':'": "inside braces and brackets a text with ':' needs quotes",
    "'\\t'": "indent with spaces, not with tabs",
    "cannot start any token": "a text that begins with it needs quotes",
    "mapping values are not allowed": "a text with ': ' in it needs quotes, unless the line above lacks its colon",
    "<block end>": "its indentation differs from that of its neighbours",
}
"""The usual mistakes, by words of the parser's message; the first that fits."""

CORE: Final = "tag:yaml.org,2002:"
TEXTS: Final = frozenset({"str", "timestamp", "value", "merge"})
"""Kinds of values that stay text; so do dates, which no action server and no JSON has."""
_PLAIN: Final = frozenset({"map", "seq", "int", "float", "bool", "null"}) | TEXTS

_SCALARS: Final = {
    "null": (re.compile(r"(?:~|null|Null|NULL|)\Z"), ("~", "n", "N", "")),
    "bool": (re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"), tuple("tTfF")),
    "int": (re.compile(r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)\Z"), tuple("-+0123456789")),
    "float": (
        re.compile(r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"),
        tuple("-+.0123456789"),
    ),
    "merge": (re.compile(r"<<\Z"), ("<",)),
}
"""Kinds of plain scalars, in the order in which they are tried: their texts, and how these may begin."""


def compose(text: str, file: str, anchors: Mapping[str, Mapping[str, str]] = NO_ANCHORS) -> list[Node]:
    """Return the documents that are not empty, at least one; raise `InputError` if the text is not plain YAML, or too large.

    `anchors` has the mappings for aliases that the text does not define.
    """
    start = Position(file, 1, 1)
    if _PDDL.match(text):
        raise InputError("this is PDDL; expected YAML", start)
    loader: _Loader | None = None
    try:
        loader = _Loader(text, anchors)
        nodes = [Node(file, root) for root in loader.documents()]
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = Position(file, mark.line + 1, mark.column + 1) if mark else start
        hint = next((hint for words, hint in _HINTS.items() if words in str(error.problem)), "")
        raise InputError(f"not YAML: {error.problem}{hint and f'; {hint}'}", where) from error
    except yaml.YAMLError as error:
        raise InputError(f"not YAML: {str(error).splitlines()[0]}", start) from error
    except RecursionError as error:
        raise InputError(f"nested deeper than {MAX_DEPTH}", start) from error
    finally:
        if loader is not None:
            loader.dispose()
    if not nodes:
        raise InputError("the file is empty; expected a mapping", start)
    _check_bounds(nodes)
    return nodes


class _Loader(yaml.SafeLoader):
    """A loader to which some anchors are known beforehand, as mappings of texts."""

    yaml_implicit_resolvers = {  # noqa: RUF012  (PyYAML's own way)
        first: [(f"{CORE}{kind}", pattern) for kind, (pattern, firsts) in _SCALARS.items() if first in firsts]
        for first in {first for _, firsts in _SCALARS.values() for first in firsts}
    }

    def __init__(self, text: str, known: Mapping[str, Mapping[str, str]]) -> None:
        super().__init__(text)
        self._known = known
        self._composed = 0

    def documents(self) -> Iterator[yaml.Node]:
        """Yield the documents that are not empty."""
        for number in count(1):
            if not self.check_node():
                return
            if number > MAX_DOCUMENTS:
                raise yaml.MarkedYAMLError(problem=f"more than {MAX_DOCUMENTS} documents", problem_mark=self.get_mark())
            node = self.get_node()
            if node is not None and not (Node("", node).is_null and not node.value):
                yield node

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            if event.anchor not in self.anchors:
                if event.anchor not in self._known:
                    hint = suggestion(event.anchor, [*self.anchors, *self._known])
                    problem = f"found undefined alias {event.anchor!r}{f'; {hint}' if hint else ''}"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
                self.get_event()  # type: ignore[no-untyped-call]
                entries, marks = self._known[event.anchor], (event.start_mark, event.end_mark)
                texts = (yaml.ScalarNode(f"{CORE}str", text, *marks) for entry in entries.items() for text in entry)
                return yaml.MappingNode(f"{CORE}map", list(zip(texts, texts, strict=True)), *marks)
        self._composed += 1
        if self._composed > MAX_NODES:  # the bounds are checked once all is there, which may take minutes
            raise yaml.MarkedYAMLError(problem=f"more than {MAX_NODES} values", problem_mark=self.get_mark())
        return super().compose_node(parent, index)


def _check_bounds(roots: list[Node]) -> None:
    stack = [(root, 0) for root in reversed(roots)]
    seen = 0
    while stack:
        node, depth = stack.pop()
        seen += 1
        if seen > MAX_NODES or depth > MAX_DEPTH:
            raise node.wrong(f"more than {MAX_NODES} values" if seen > MAX_NODES else f"nested deeper than {MAX_DEPTH}")
        if node.kind not in _PLAIN:
            raise node.wrong(f"the tag {node.raw.tag.replace(CORE, '!!')} is not allowed; expected plain data")
        if not isinstance(node.raw, yaml.ScalarNode):
            parts = chain.from_iterable(node.raw.value) if node.is_mapping else node.raw.value
            stack.extend((Node(node.file, part), depth + 1) for part in reversed([*parts]))
