"""From YAML text to nodes: no classes, and bounded in size and depth, aliases counted at every use.

A plain scalar is what the core schema of YAML 1.2 says (section 10.3.2): of the words only ``true`` and ``false`` are
truth values, so ``no`` is a text here as it is when a person types it, and ``12:30`` is not 750.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import count
from typing import Any, Final

import yaml

from pnm.errors import InputError, Position, suggestion

MAX_NODES: Final = 200_000
"""Values in a file, those behind an alias counted at every use: an alias bomb is refused."""
MAX_DEPTH: Final = 60
MAX_DOCUMENTS: Final = 100
NO_ANCHORS: Final[Mapping[str, Mapping[str, str]]] = {}

_PDDL: Final = re.compile(r"(?:\s|;.*\n)*\(\s*define\b", re.IGNORECASE)

_HINTS: Final = {
    "expected ':'": "a key has a colon and a space behind it",
    "'?'": "inside braces and brackets a '?' needs quotes",
    "'{'": "inside braces and brackets a text with '{' needs quotes",
    "':'": "inside braces and brackets a text with ':' needs quotes",
    "'\\t'": "indent with spaces, not with tabs",
    "cannot start any token": "a text that begins with it needs quotes",
    "mapping values are not allowed": "a text with ': ' in it needs quotes, unless the line above lacks its colon",
    "<block end>": "it is indented otherwise than what it stands beside",
}
"""What usually is the mistake, by words of the parser's message; the first that fits."""

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


def compose(text: str, file: str, anchors: Mapping[str, Mapping[str, str]] = NO_ANCHORS) -> list[yaml.Node]:
    """Return the documents that are not empty, at least one; raise `InputError` if the text is not plain YAML, or too large.

    `anchors` has the mappings for aliases that the text does not define.
    """
    start = Position(file, 1, 1)
    if _PDDL.match(text):
        raise InputError("this is PDDL; expected YAML", start)
    loader: _Loader | None = None
    try:
        loader = _Loader(text, anchors)
        nodes = list(loader.documents())
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
    _check_bounds(nodes, file)
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
            if node is not None and not (is_null(node) and not node.value):
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


def _check_bounds(roots: list[yaml.Node], file: str) -> None:
    stack = [(root, 0) for root in reversed(roots)]
    seen = 0
    while stack:
        node, depth = stack.pop()
        seen += 1
        if seen > MAX_NODES or depth > MAX_DEPTH:
            what = f"more than {MAX_NODES} values" if seen > MAX_NODES else f"nested deeper than {MAX_DEPTH}"
            raise InputError(what, position(node, file))
        if kind(node) not in _PLAIN:
            raise InputError(f"the tag {node.tag.replace(CORE, '!!')} is not allowed; expected plain data", position(node, file))
        if isinstance(node, yaml.MappingNode):
            stack.extend((part, depth + 1) for pair in reversed(node.value) for part in reversed(pair))
        elif isinstance(node, yaml.SequenceNode):
            stack.extend((part, depth + 1) for part in reversed(node.value))


def position(node: yaml.Node, file: str) -> Position:
    """Return where the node stands."""
    return Position(file, node.start_mark.line + 1, node.start_mark.column + 1)


def kind(node: yaml.Node) -> str:
    """Return the node's tag, without what all plain ones begin with."""
    return str(node.tag).removeprefix(CORE)


def scalar(node: yaml.Node) -> str | float | bool | None:
    """Return the value of a scalar; a float is finite. Raise `ValueError` for a text that its tag does not allow."""
    name, text = kind(node), node.value
    if name in TEXTS:
        return str(text)
    if not _SCALARS[name][0].match(text):
        raise ValueError(f"{text!r} is no {name}")
    match name:
        case "null":
            return None
        case "bool":
            return bool(text.lower() == "true")
        case "int":
            return int(text, 0 if text[:2] in ("0o", "0x") else 10)
        case _:
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


def is_null(node: yaml.Node) -> bool:
    """Return whether the node is ``null``, or no value at all."""
    return isinstance(node, yaml.ScalarNode) and kind(node) == "null"
