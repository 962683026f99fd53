"""What a PDDL file declares: requirements, types, objects, predicates and functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from planner_bridge.model import Declaration, Domain
from planner_bridge.pddl.names import CONNECTIVES, Names, Types, new_name, runs, show_types, type_words, unsupported
from planner_bridge.pddl.sexpr import Atom, Group, Node, where, wrong

Parts = tuple[Node, ...]


def requirements(parts: Parts) -> tuple[str, ...]:
    """Read requirements, each with its colon and in lower case; unknown ones are kept."""
    found: list[str] = []
    for part in parts:
        if not isinstance(part, Atom):
            raise wrong(part, f"expected a requirement such as :typing, found {part}")
        found.append(":" + new_name(Atom(part.key.lstrip(":") or ":", part.offset, part.source), "requirement"))
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True, slots=True)
class Once:
    """Refuses what was declared before."""

    kind: str
    first: dict[str, Node] = field(default_factory=dict)
    """Where each name, in lower case, was declared first."""

    def check(self, name: str, node: Node) -> None:
        """Refuse the name, if it is known already, where the node stands."""
        first = self.first.setdefault(name.lower(), node)
        if first is not node:
            raise wrong(node, f"the {self.kind} {name!r} is declared twice; the first time in line {where(first).line}")


# --- types ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _TypeTable:
    words: dict[str, Node] = field(default_factory=dict)
    """Where each type stands first."""
    spelled: dict[str, str] = field(default_factory=lambda: {"object": "object"})
    above: dict[str, dict[str, None]] = field(default_factory=dict)
    """For every type in order, the types written behind its ``-``, in order."""

    def name(self, node: Node) -> str:
        written = new_name(node, "type")
        name = self.spelled.setdefault(written.lower(), written)
        self.words.setdefault(name, node)
        self.above.setdefault(name, {})
        return name


def types(parts: Parts) -> dict[str, Types]:
    """Read the type hierarchy; a type that only stands behind a ``-`` is declared by that."""
    table = _TypeTable()
    for names, kind in runs(parts):
        children = [table.name(name) for name in names]
        above = dict.fromkeys(table.name(word) for word in type_words(kind)) if kind else {}
        for child in children:
            table.above[child].update(above)
    found = {name: tuple(one for one in above if one != "object") for name, above in table.above.items()}
    _no_cycle(found, table.words)
    found.pop("object", None)
    return found


def _no_cycle(found: Mapping[str, Types], words: Mapping[str, Node]) -> None:
    domain = Domain("", types=found)
    for name, above in found.items():
        if any(name in domain.supertypes(parent) for parent in above):
            raise wrong(words[name], f"the type {name!r} is a kind of itself")


# --- objects -------------------------------------------------------------------------------


def objects(parts: Parts, names: Names) -> dict[str, Types]:
    """Read constants or objects; what `names` has already may be repeated with the same types."""
    found: dict[str, tuple[str, Types]] = {}
    for words, kind in runs(parts):
        given = names.types(kind)
        for word in words:
            name = new_name(word, "object")
            before = names.find_object(name) or found.setdefault(name.lower(), (name, given))
            if frozenset(before[1]) != frozenset(given):
                raise wrong(word, f"the object {name!r} is of type {show_types(given)} here, but of type {show_types(before[1])} before")
    return dict(found.values())


# --- predicates and functions --------------------------------------------------------------

_NUMBER: Final = "number"


def predicates(parts: Parts, names: Names) -> dict[str, Declaration]:
    """Read the declarations of predicates."""
    once = Once("predicate")
    return dict(_declaration(part, "predicate", names, once) for part in parts)


def functions(parts: Parts, names: Names, facts: Mapping[str, Declaration]) -> dict[str, Declaration]:
    """Read the declarations of functions, which a state must be able to tell from the predicates."""
    once = Once("function")
    taken = {(name.lower(), len(declared.parameters)) for name, declared in facts.items()}
    found: dict[str, Declaration] = {}
    for group, kind in runs(parts):
        if kind is not None and not (isinstance(kind, Atom) and kind.key == _NUMBER):
            raise unsupported(kind, f"functions whose values are not numbers (- {_word(kind)})", "objects as values in a state")
        for part in group:
            name, declared = _declaration(part, "function", names, once)
            if (name.lower(), len(declared.parameters)) in taken:
                raise wrong(part, f"the function {name!r} has the name and the number of arguments of a predicate")
            found[name] = declared
    return found


def _word(node: Node) -> str:
    return node.text if isinstance(node, Atom) else str(node)


def _declaration(node: Node, kind: str, names: Names, once: Once) -> tuple[str, Declaration]:
    if not isinstance(node, Group) or not node.items:
        raise wrong(node, f"expected a {kind} in parentheses such as (name ?x - type), found {node}")
    name = new_name(node.items[0], kind, CONNECTIVES)
    once.check(name, node)
    return name, Declaration(name, names.variables(node.rest, distinct=False))
