"""The structure of a PDDL file before anything in it is interpreted: sections, keyed lists and typed lists."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from planner_bridge.pddl.expressions import Atom, Group, Node, new_name, normalized, parse, where, wrong
from planner_bridge.pddl.requirements import REFUSED_SECTIONS, Leniency
from pnm.errors import InputError, Position, suggestion

_REPEATABLE: Final = (":action", ":durative-action", ":process", ":event", ":derived", ":task", ":method")
"""Sections that a file may have several times."""
_YAML: Final = re.compile(r"(?:\s|#.*\n|---\s*\n)*[\w-]+:(?:\s|$)")


@dataclass(frozen=True, slots=True)
class Definition:
    """``(define (domain NAME) SECTION ...)``, or a problem, cut into its sections."""

    name: str
    whole: Group
    sections: tuple[Group, ...]

    def every(self, *keys: str) -> list[Group]:
        """Return the sections of these names in the order of the file."""
        return [section for section in self.sections if section.head in keys]

    def lists(self, key: str) -> list[tuple[Node, ...]]:
        """Return the contents of each section of the name."""
        return [section.rest for section in self.every(key)]

    def parts(self, key: str) -> tuple[Node, ...]:
        """Return the contents of the sections of the name, joined."""
        return tuple([part for parts in self.lists(key) for part in parts])

    def one(self, key: str) -> Group | None:
        """Return the section, if there is one; a second one is refused unless it has the same words."""
        sections = self.every(key)
        for other in sections[1:]:
            if normalized(other) != normalized(sections[0]):
                raise wrong(other, f"a second {key} section; the first is in line {where(sections[0]).line}")
        return sections[0] if sections else None


def define(text: str, file: str, kind: Literal["domain", "problem"], known: tuple[str, ...]) -> Definition:
    """Read a definition; all its sections must be known ones."""
    form = f"(define ({kind} NAME) ...)"
    match parse(text, file):
        case ():
            raise InputError(f"the file is empty; expected {form}", Position(file, 1, 1))
        case (Group() as whole,) if whole.head == "define":
            pass
        case (Group() as whole, extra, *_) if whole.head == "define":
            raise wrong(extra, f"expected the end of the file after {form}, found {extra}")
        case (Group(items=(Atom() as word, *_)), *_):
            raise wrong(word, f"expected 'define', found {word}")
        case (first, *_):
            hint = "; this is YAML: `pnm import` writes a domain in YAML as PDDL" if _YAML.match(text) else ""
            raise wrong(first, f"expected {form}, found {first}{hint}")
    match whole.rest:
        case (Group(items=(_, name)) as head, *sections) if head.head == kind:
            return Definition(new_name(name, kind), whole, _sections(sections, known))
        case (other, *_):
            misplaced = isinstance(other, Group) and other.head in {"domain", "problem"} - {kind}
            hint = f"; this file is not a {kind}: the domain comes first, then the problem" if misplaced else ""
            raise wrong(other, f"expected ({kind} NAME), found {other}{hint}")
        case _:
            raise wrong(whole, f"expected {form}, found {whole}")


def _sections(nodes: list[Node], known: tuple[str, ...]) -> tuple[Group, ...]:
    sections: list[Group] = []
    for node in nodes:
        if not isinstance(node, Group) or not node.head.startswith(":"):
            raise wrong(node, f"expected a section such as ({known[1]} ...), found {node}")
        if node.head not in known:
            raise _unknown(node.items[0], "section", known)
        sections.append(node)
    first: dict[str, Group] = {}
    for section in sections:
        if first.setdefault(section.head, section) is not section and section.head not in _REPEATABLE:
            Leniency.SECOND_SECTION.note(section, section.head, where(first[section.head]).line)
    return tuple(sections)


def keyed(items: tuple[Node, ...], place: str, known: tuple[str, ...]) -> dict[str, Node]:
    """Read ``:key value :key value``, each key a known one and there once."""
    values: dict[str, Node] = {}
    rest = iter(items)
    for key in rest:
        if not isinstance(key, Atom) or key.text[0] != ":":
            raise wrong(key, f"expected one of {', '.join(known)}; found {key}")
        if key.key not in known:
            raise _unknown(key, "key", known, f" in {place}")
        if key.key in values:
            raise wrong(key, f"a second {key.key}; expected one")
        value = next(rest, None)
        if value is None or (isinstance(value, Atom) and value.text[0] == ":"):
            raise wrong(key, f"expected a value after {key}, found {value or 'nothing'}")
        values[key.key] = value
    return values


def _unknown(key: Node, kind: str, known: Collection[str], place: str = "") -> InputError:
    word = key.key if isinstance(key, Atom) else ""
    if word in REFUSED_SECTIONS:
        return REFUSED_SECTIONS[word].at(key)
    hint = suggestion(word, known) or f"expected one of {', '.join(known)}"
    return wrong(key, f"unknown {kind} {key}{place}; {hint}")


def typed_runs(items: Sequence[Node]) -> Iterator[tuple[list[Node], Node | None]]:
    """Split ``a b - t c`` into ``([a, b], t)`` and ``([c], None)``; ``-t`` without a space is read too."""
    names: list[Node] = []
    rest = iter(items)
    for item in rest:
        match item:
            case Atom("-"):
                types = next(rest, None)
                if types is None:
                    raise wrong(item, "expected a type after '-', found nothing")
            case Atom(text, offset, source) if text[0] == "-":
                types = Atom(text[1:], offset + 1, source)
            case _:
                names.append(item)
                continue
        if names:
            yield names, types
        else:
            Leniency.TYPE_WITHOUT_NAMES.note(item, types)
        names = []
    if names:
        yield names, None


def type_words(node: Node) -> tuple[Atom, ...]:
    """Return the words of ``t`` or ``(either t u)``."""
    nodes = node.rest if isinstance(node, Group) and node.head == "either" and node.rest else (node,)
    words = tuple(word for word in nodes if isinstance(word, Atom))
    if len(words) < len(nodes):
        raise wrong(node, f"expected a type or (either TYPE ...), found {node}")
    return words
