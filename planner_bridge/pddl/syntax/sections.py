"""A PDDL file cut into its sections, before anything in them is interpreted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Final, Literal

from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, normalized, parse, tolerate, where, wrong
from planner_bridge.pddl.syntax.words import CONTINGENT, new_name, unsupported
from pnm.errors import InputError, Position

_UNSUPPORTED: Final[Mapping[str, tuple[str, str]]] = {
    ":process": ("processes (:process)", "a simulation of change over time"),
    ":event": ("events (:event)", "changes that happen without an action"),
    ":observe": ("sensing actions (:observe)", CONTINGENT),
}
_SEVERAL: Final = (":action", ":durative-action", ":derived", ":task", ":method")
"""Sections of which a file has as many as it likes."""


@dataclass(frozen=True, slots=True)
class Definition:
    """``(define (domain NAME) SECTION ...)``, or a problem, cut into its sections."""

    name: str
    whole: Group
    sections: tuple[Group, ...]
    texts: Mapping[int, str] = field(default_factory=dict)
    """For offsets of sections that are kept as they stand, their texts, where these are not those of the source."""

    def every(self, *keys: str) -> list[Group]:
        """Return the sections of these names in the order of the file."""
        return [section for section in self.sections if section.head in keys]

    def lists(self, key: str) -> list[tuple[Node, ...]]:
        """Return what stands in each section of the name."""
        return [section.rest for section in self.every(key)]

    def parts(self, key: str) -> tuple[Node, ...]:
        """Return what stands in the sections of the name, joined."""
        return tuple([part for parts in self.lists(key) for part in parts])

    def one(self, key: str) -> Group | None:
        """Return the section; another one may only say the same again."""
        found = self.every(key)
        for other in found[1:]:
            if normalized(other) != normalized(found[0]):
                raise wrong(other, f"a second {key} section; the first is in line {where(found[0]).line}")
        return found[0] if found else None


def define(text: str, file: str, kind: Literal["domain", "problem"], known: tuple[str, ...]) -> Definition:
    """Read a definition, all sections of which must be known ones."""
    form = f"(define ({kind} NAME) ...)"
    whole = _single(parse(text, file), file, form)
    match whole.rest:
        case (Group(items=(_, name)) as head, *sections) if head.head == kind:
            return Definition(new_name(name, kind), whole, _sections(sections, known))
        case (found, *_):
            other = isinstance(found, Group) and found.head in {"domain", "problem"} - {kind}
            raise wrong(found, f"expected ({kind} NAME), found {found}{f'; this file is not a {kind}' if other else ''}")
        case _:
            raise wrong(whole, f"expected {form}, found {whole}")


def _single(nodes: tuple[Node, ...], file: str, form: str) -> Group:
    match nodes:
        case ():
            raise InputError(f"the file is empty; expected {form}", Position(file, 1, 1))
        case (Group() as whole,) if whole.head == "define":
            return whole
        case (Group() as whole, extra, *_) if whole.head == "define":
            raise wrong(extra, f"expected the end of the file after {form}, found {extra}")
        case (Group(items=(Atom() as word, *_)), *_):
            raise wrong(word, f"expected 'define', found {word}")
    raise wrong(nodes[0], f"expected {form}, found {nodes[0]}")


def _sections(nodes: list[Node], known: tuple[str, ...]) -> tuple[Group, ...]:
    found: dict[str, Group] = {}
    sections = tuple([_section(node, known) for node in nodes])
    for section in sections:
        first = found.setdefault(section.head, section)
        if first is not section and section.head not in _SEVERAL:
            tolerate(section, f"a second {section.head} section, read as part of the first in line {where(first).line}")
    return sections


def _section(node: Node, known: tuple[str, ...]) -> Group:
    if not isinstance(node, Group) or not node.head.startswith(":"):
        raise wrong(node, f"expected a section such as ({known[1]} ...), found {node}")
    if node.head not in known:
        raise _unknown(node.items[0], "section", known)
    return node


def keyed(items: tuple[Node, ...], place: str, known: tuple[str, ...]) -> dict[str, Node]:
    """Read ``:key value :key value``, each key a known one and there once."""
    found: dict[str, Node] = {}
    rest = iter(items)
    for key in rest:
        if not isinstance(key, Atom) or key.text[0] != ":":
            raise wrong(key, f"expected one of {', '.join(known)}; found {key}")
        if key.key not in known:
            raise _unknown(key, "key", known, f" in {place}")
        if key.key in found:
            raise wrong(key, f"a second {key.key}; expected one")
        value = next(rest, None)
        if value is None or (isinstance(value, Atom) and value.text[0] == ":"):
            raise wrong(key, f"expected a value after {key}, found {value or 'nothing'}")
        found[key.key] = value
    return found


def _unknown(key: Node, kind: str, known: Iterable[str], place: str = "") -> InputError:
    word = key.key if isinstance(key, Atom) else ""
    if word in _UNSUPPORTED:
        return unsupported(key, *_UNSUPPORTED[word])
    near = get_close_matches(word, list(known), 1)
    hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
    return wrong(key, f"unknown {kind} {key}{place}; {hint}")
