"""The things in a PDDL definition that comments can be about: sections, declarations, actions, their parts, facts.

A thing is named by what it says, in lower case and as the reader understands it: ``and`` and the moments of a
durative action's parts are looked through, so that a condition has the same name wherever a writer puts it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from planner_bridge.pddl.comments.table import Item, Path
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node
from planner_bridge.pddl.syntax.pretty_print import Form, flat
from planner_bridge.pddl.syntax.sections import Definition
from planner_bridge.pddl.syntax.words import NUMBER, TIME_SPECIFIERS, number_text, typed_runs

ACTION: Final = "action"
PARTS: Final = {
    ":precondition": "condition",
    ":condition": "condition",
    ":effect": "effect",
    ":parameters": "parameters",
    ":vars": "parameters",
    ":duration": "duration",
}
"""What the parts of an action are called, whatever its kind."""
HIERARCHY: Final = (":task", ":method", ":htn", ":tasks")
"""Sections that are kept as they stand, with the comments in them."""
_HIERARCHY: Final = re.compile(r"\(\s*([^\s()]*)\s*([^\s()]*)")
_NAMES: Final = (":types", ":constants", ":objects")
_ACTIONS: Final = (":action", ":durative-action")
INNER: Final = frozenset(("or", "imply", "when", "forall", "exists", "not", "preference"))
"""Things that have things inside them."""


# --- what a thing says ---------------------------------------------------------------------


def said(form: Form) -> str:
    """Return the name of a condition, an effect or a fact.

    >>> said(["and", ["at", "start", ["p", "?X"]]]) == said(["p", "?x"]) == "(p ?x)"
    True
    """
    if not isinstance(form, list):
        word = flat(form)
        return number_text(float(word)) if NUMBER.fullmatch(word) else word.lower()
    head = _head(form)
    if head == "and":
        parts = [said(part) for part in _conjuncts(form)]
        return parts[0] if len(parts) == 1 else f"({' '.join(('and', *parts))})"
    if is_timed(form):
        return said(form[2])
    if head.startswith("?"):  # variables: some say their type though they need not
        return f"({' '.join(part.lower() for part in form if isinstance(part, str) and part.startswith('?'))})"
    return f"({' '.join(map(said, form))})"


def fact_said(form: Form) -> str:
    """Return the name of what stands in an initial state, which is the same whatever the value."""
    return said(form[:2]) if isinstance(form, list) and _head(form) in ("=", "assign") else said(form)


def hierarchy_said(text: str) -> tuple[str, str]:
    """Return what names the text of a task, a method or a network: the keyword, and the first word behind it.

    >>> hierarchy_said("(:task Clean :parameters ())")
    (':task', 'clean')
    """
    found = _HIERARCHY.match(text)
    return (found[1].lower(), found[2].lower()) if found else ("", "")


def form_of(node: Node) -> Form:
    """Return a part of a text as nested lists of words."""
    return node.text if isinstance(node, Atom) else [form_of(item) for item in node.items]


def is_timed(form: Form) -> bool:
    """Tell whether the form is ``(at start X)``, ``(over all X)`` or ``(at end X)``."""
    match form:
        case [str() as first, str() as second, list()]:
            return f"{first} {second}".lower() in TIME_SPECIFIERS
        case _:
            return False


def _conjuncts(form: list[Form]) -> Iterator[Form]:
    for part in form[1:]:
        inner = part[2] if isinstance(part, list) and is_timed(part) else part
        if isinstance(inner, list) and _head(inner) == "and":
            yield from _conjuncts(inner)
        else:
            yield inner


def _head(form: list[Form]) -> str:
    return form[0].lower() if form and isinstance(form[0], str) else ""


# --- the things of a file ------------------------------------------------------------------


def items(definition: Definition, root: str, ends: Mapping[int, int]) -> list[Item]:
    """Return the things in a definition.

    Args:
        definition: a file cut into its sections.
        root: what its own path begins with: ``domain`` or ``problem``.
        ends: for the offset of every list, the offset behind it, where that counts.
    """
    return list(_Finder(ends).definition(definition, (root,)))


@dataclass(frozen=True, slots=True)
class _Finder:
    ends: Mapping[int, int]

    def definition(self, definition: Definition, path: Path) -> Iterator[Item]:
        yield self.item(definition.whole, path)
        for section in definition.sections:
            yield from self.section(section, path)

    def item(self, node: Node, path: Path, last: Node | None = None, opaque: bool = False) -> Item:
        behind = last or node
        end = behind.offset + len(behind.text) if isinstance(behind, Atom) else self.ends.get(behind.offset, behind.offset + 1)
        return Item(path, node.offset, end, opaque)

    def section(self, section: Group, path: Path) -> Iterator[Item]:
        head = section.head
        if head in _ACTIONS or head in HIERARCHY or head == ":derived":
            yield from self.named(section, path)
            return
        inner = (*path, head)
        yield self.item(section, inner)
        if head in _NAMES:
            for names, _ in typed_runs(section.rest):
                yield from (self.item(name, (*inner, name.key)) for name in names if isinstance(name, Atom))
        elif head in (":predicates", ":functions"):
            yield from (self.item(part, (*inner, part.head)) for part in section.rest if isinstance(part, Group))
        elif head == ":init":
            yield from (self.item(part, (*inner, fact_said(form_of(part)))) for part in section.rest if isinstance(part, Group))
        elif head in (":goal", ":constraints"):
            yield from self.formulas(section.rest, inner)

    def named(self, section: Group, path: Path) -> Iterator[Item]:
        name = section.rest[0] if section.rest else section
        if section.head in HIERARCHY:
            yield self.item(section, (*path, section.head, name.key if isinstance(name, Atom) else ""), opaque=True)
        elif section.head == ":derived":
            inner = (*path, section.head, rule_said(form_of(section)))
            yield self.item(section, inner)
            yield from self.formulas(section.rest[1:], inner)
        else:
            inner = (*path, ACTION, said(form_of(name)))
            yield self.item(section, inner)
            for keyword, value in zip(section.rest[1::2], section.rest[2::2], strict=False):
                part = (*inner, PARTS.get(said(form_of(keyword)), ""))
                yield self.item(keyword, part, value)
                if part[-1] in ("condition", "effect"):
                    yield from self.formulas((value,), part)

    def formulas(self, nodes: Iterable[Node], path: Path) -> Iterator[Item]:
        """Yield conditions or effects that stand beside each other, and what is in them."""
        for node in nodes:
            if not isinstance(node, Group) or not node.items or node.head.startswith("?"):
                continue
            if node.head == "and":
                yield from self.formulas(node.rest, path)
            elif is_timed(form := form_of(node)):
                yield from self.formulas(node.items[2:], path)
            else:
                inner = (*path, said(form))
                yield self.item(node, inner)
                if node.head in INNER and not _is_plain_negation(node):
                    yield from self.formulas(node.rest, inner)


def rule_said(form: Form) -> str:
    """Return the name of a rule: that of its head, and its body."""
    match form:
        case [_, [head, *_], body]:
            return f"{said(head)} {said(body)}"
        case _:
            return said(form)


def _is_plain_negation(node: Group) -> bool:
    inner = node.rest[0] if node.rest else None
    return node.head == "not" and not (isinstance(inner, Group) and (inner.head in INNER or inner.head == "and"))
