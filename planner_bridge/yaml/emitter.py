"""YAML for people: blocks, with brackets and braces for what is short, and comments where they belong.

Words and texts as YAML scalars: plain where every reader takes them for just that text, else in quotes.

YAML 1.1 takes ``on``, ``no``, ``1_000`` or ``12:30`` for something else than a text, YAML 1.2 ``0o17``; both do
so with numbers, and other characters mean something in some places only.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import yaml

from planner_bridge.pddl.comments import NO_NOTE, Line, Note, render_lines

_LETTERS: Final = frozenset("yYnN")
"""YAML 1.1 calls them truth values, too; PyYAML does not."""
_NEWER: Final = re.compile(
    r"0o[0-7]+|0x[0-9a-fA-F]+|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)|[-+]?(?:\.\d+|\d+(?:\.\d*)?)(?:[eE][-+]?\d+)?"
)
_PLAIN: Final = re.compile(
    r"(?![-?:](?:\s|\Z))(?![\s,\[\]{}#&*!|>'\"%@`=]|---|\.\.\.)[\x20-\x7e\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd]*(?<!\s)"
)
_BREAKING: Final = re.compile(r":(?:\s|\Z)|\s#|[\u2028\u2029]")
_IN_FLOW: Final = re.compile(r"[,\[\]{}?:]")
_ESCAPED: Final = re.compile("[\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff\ufffe\uffff]")
_RESOLVERS: Final = yaml.SafeLoader.yaml_implicit_resolvers


def scalar(text: str, *, in_flow: bool = False) -> str:
    """Write a text, which may have several lines.

    >>> scalar("hall"), scalar("on"), scalar("(at ?r hall)"), scalar("(at ?r hall)", in_flow=True)
    ('hall', '"on"', '(at ?r hall)', '"(at ?r hall)"')
    """
    return text if is_plain(text, in_flow=in_flow) else quoted(text)


def quoted(text: str) -> str:
    """Write a text in quotes."""
    return _ESCAPED.sub(lambda match: f"\\u{ord(match[0]):04x}", json.dumps(text, ensure_ascii=False))


def is_plain(text: str, *, in_flow: bool = False) -> bool:
    """Return whether the text needs no quotes, inside brackets and braces or elsewhere."""
    if not any(map(str.isalnum, text)) or _PLAIN.fullmatch(text) is None or _BREAKING.search(text) or (in_flow and _IN_FLOW.search(text)):
        return False
    if text in _LETTERS or _NEWER.fullmatch(text) is not None:
        return False
    # what YAML 1.1 takes for a number, a truth value, a date or the like
    return not any(pattern.match(text) for _, pattern in (*_RESOLVERS.get(text[0], ()), *_RESOLVERS.get(None, ())))


WIDTH: Final = 100
_UNPRINTABLE: Final = re.compile("[^\t\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")
_FOLDED: Final = re.compile(r"[^\n\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd]|\A\s|\s\Z|\A\Z")
_MARK: Final = re.compile(r";+")


@dataclass(frozen=True, slots=True)
class Bare:
    """A scalar that is written as it stands: a number."""

    text: str


@dataclass(frozen=True, slots=True)
class Entry:
    """One item of a list, or one key of a mapping with its value."""

    value: Value
    key: str = ""
    """Of a mapping."""
    note: Note = NO_NOTE
    apart: bool = False
    """Whether an empty line stands before it."""


@dataclass(frozen=True, slots=True)
class YamlList:
    """A list."""

    entries: tuple[Entry, ...] = ()
    short: bool = False
    """Whether it stands in brackets if it fits."""


@dataclass(frozen=True, slots=True)
class YamlMapping:
    """Keys and values."""

    entries: tuple[Entry, ...] = ()
    short: bool = False
    """Whether it stands in braces if it fits."""


Value: TypeAlias = str | Bare | YamlList | YamlMapping
"""A text of several lines is written as a block of them."""


def items(values: Iterable[Value], *, short: bool = False) -> YamlList:
    """Return a list of values without comments."""
    return YamlList(tuple([Entry(value) for value in values]), short)


def single(key: str, value: Value, *, short: bool = False) -> YamlMapping:
    """Return a mapping of one key."""
    return YamlMapping((Entry(value, key),), short)


def document(whole: YamlMapping) -> str:
    """Write a document."""
    return render_lines(_block(whole, 0), commented)


def commented(comment: str) -> str:
    """Write a comment of PDDL as one of YAML, which allows fewer characters."""
    return _MARK.sub(lambda marks: "#" * len(marks[0]), _UNPRINTABLE.sub(" ", comment), count=1).rstrip()


def _comments(texts: Iterable[str], indent: int) -> Iterator[Line]:
    return (Line(indent, commented(text)) for text in texts)


def _block(value: YamlList | YamlMapping, indent: int) -> Iterator[Line]:
    for entry in value.entries:
        if entry.apart:
            yield Line(0, "")
        yield from _comments(entry.note.before, indent)
        first, *others = _entry(entry.value, "-" if isinstance(value, YamlList) else f"{scalar(entry.key)}:", indent)
        yield Line(first.indent, first.text, (*entry.note.beside, *first.beside))
        yield from others
        yield from _comments(entry.note.below, indent)


def _entry(value: Value, head: str, indent: int) -> Iterator[Line]:
    match value:
        case str() if "\n" in value and not _FOLDED.search(value):
            yield Line(indent, f"{head} |-")
            yield from (Line(indent + 2 if text else 0, text) for text in value.split("\n"))
        case str() | Bare():
            yield Line(indent, f"{head} {scalar(value) if isinstance(value, str) else value.text}")
        case YamlList() | YamlMapping():
            is_form = head == "-" and isinstance(value, YamlMapping) and len(value.entries) == 1  # a dash needs no braces behind it
            line = _flow(value) if (value.short and not is_form) or not value.entries else None
            if line is not None and (not value.entries or indent + len(f"{head} {line}") <= WIDTH):
                yield Line(indent, f"{head} {line}")
                return
            lines = _block(value, indent + 2)
            first = next(lines)
            if head == "-" and first.text[:1] != "#":
                yield Line(indent, f"- {first.text}", first.beside)
            else:
                yield from (Line(indent, head), first)
            yield from lines


def _flow(value: Value) -> str | None:
    match value:
        case str(text):
            return scalar(text, in_flow=True)
        case Bare(text):
            return text
        case YamlList(entries) | YamlMapping(entries):
            parts = [_flow(entry.value) for entry in entries]
            if any(part is None for part in parts) or any(entry.note for entry in entries):
                return None
            if isinstance(value, YamlList):
                return f"[{', '.join(map(str, parts))}]"
            return f"{{{', '.join(f'{scalar(entry.key, in_flow=True)}: {part}' for entry, part in zip(entries, parts, strict=True))}}}"


def depth(value: Value) -> int:
    """Return the depth of nested lists and mappings."""
    return 1 + max((depth(entry.value) for entry in value.entries), default=0) if isinstance(value, YamlList | YamlMapping) else 0
