"""What a PDDL file declares: types, objects, predicates and functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Final, TypeAlias

from planner_bridge.model.problem import Declaration, Domain
from planner_bridge.pddl.read.requirements import Requirements
from planner_bridge.pddl.read.symbols import SymbolTable
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, where, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, Types, new_name, show_types, type_words, typed_runs, with_article
from pnm.core.logic.expressions import Variable

Lists: TypeAlias = Iterable[Sequence[Node]]
"""What stands in each of the sections of a name: a type in one says nothing of the names in another."""

# --- types ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _TypeHierarchy:
    words: dict[str, Node] = field(default_factory=dict)
    """Where each type stands first."""
    spelled: dict[str, str] = field(default_factory=lambda: {"object": "object"})
    above: dict[str, dict[str, None]] = field(default_factory=dict)
    """For every type in order, the types written behind its ``-``, in order."""
    declared: set[str] = field(default_factory=set)
    """Types that have stood before a ``-``, or without one."""

    def name(self, node: Node) -> str:
        written = new_name(node, "type")
        name = self.spelled.setdefault(written.lower(), written)
        self.words.setdefault(name, node)
        self.above.setdefault(name, {})
        return name

    def declare(self, node: Node) -> str:
        name = self.name(node)
        if name in self.declared and name != "object":
            tolerate(node, f"the type {node} is declared twice; it is of all the kinds given")
        self.declared.add(name)
        return name


def types(lists: Lists, requirements: Requirements) -> dict[str, Types]:
    """Read the type hierarchy; a type that only stands behind a ``-`` is declared by that."""
    table = _TypeHierarchy()
    for names, kind in chain.from_iterable(map(typed_runs, lists)):
        requirements.need(names[0], ":typing")
        children = [table.declare(name) for name in names]
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


def objects(lists: Lists, symbols: SymbolTable) -> dict[str, Types]:
    """Read constants or objects; one that is there again, or in `names` already, is of all the types given."""
    found: dict[str, tuple[str, Types]] = {}
    for words, kind in chain.from_iterable(map(typed_runs, lists)):
        given = symbols.types(kind)
        for word in words:
            name = new_name(word, "object")
            key = name.lower()
            before = found.get(key) or symbols.find_object(name)
            if before is None:
                found[key] = name, given
                continue
            tolerate(word, f"the object {name!r} is declared twice{_and(given, before[1])}")
            both = symbols.joined(before[1], given)
            if both != before[1]:
                found[key] = before[0], both
    return dict(found.values())


def _and(given: Types, before: Types) -> str:
    if frozenset(given) == frozenset(before):
        return ""
    return f": as {show_types(given)} here, as {show_types(before)} before; it is of both types"


def borrow(own: dict[str, Types], symbols: SymbolTable, whole: Node) -> dict[str, Types]:
    """Return a problem's objects, spelled as its domain spells those that it borrows, each of which must be there."""
    borrowed = symbols.domain.borrowed
    spelled = {name.lower(): name for name in borrowed}
    found = {spelled.get(name.lower(), name): types for name, types in own.items()}
    for name, here in borrowed.items():
        if name not in found:
            raise wrong(whole, f"the object {name!r} is not declared; the domain names it at {here.position}")
        if not symbols.matches(found[name], here.types):
            raise wrong(whole, f"{name!r} is of type {show_types(found[name])}; the domain expects {show_types(here.types)}")
    return found


# --- predicates and functions --------------------------------------------------------------

_NUMBER: Final = "number"


@dataclass(frozen=True, slots=True)
class UniqueNames:
    """Refuses what was declared before."""

    kind: str
    first: dict[str, Node] = field(default_factory=dict)
    """Where each name, in lower case, was declared first."""

    def check(self, name: str, node: Node) -> None:
        """Refuse the name, if it is known already, where the node stands."""
        first = self.first.setdefault(name.lower(), node)
        if first is not node:
            raise wrong(node, f"the {self.kind} {name!r} is declared twice; the first time in line {where(first).line}")


def predicates(parts: Sequence[Node], symbols: SymbolTable) -> dict[str, Declaration]:
    """Read the declarations of predicates."""
    table = _DeclarationTable("predicate", symbols)
    for part in parts:
        table.add(part, ())
    return table.found


def functions(lists: Lists, symbols: SymbolTable, facts: Mapping[str, Declaration]) -> dict[str, Declaration]:
    """Read the declarations of functions, which a state must be able to tell from the predicates."""
    table = _DeclarationTable("function", symbols)
    taken = {(name.lower(), len(declared.parameters)) for name, declared in facts.items()}
    for group, kind in chain.from_iterable(map(typed_runs, lists)):
        numeric = kind is None or (isinstance(kind, Atom) and kind.key == _NUMBER)
        if not numeric:
            symbols.requirements.need(kind or group[0], ":object-fluents")
        values = () if numeric else symbols.types(kind)
        for part in group:
            declared = table.add(part, values)
            if (declared.name.lower(), len(declared.parameters)) in taken:
                raise wrong(part, f"the function {declared.name!r} has the name and the number of arguments of a predicate")
    return table.found


@dataclass(frozen=True, slots=True)
class _DeclarationTable:
    kind: str
    symbols: SymbolTable
    found: dict[str, Declaration] = field(default_factory=dict)
    first: dict[str, tuple[str, Node]] = field(default_factory=dict)
    """For every name in lower case, its spelling and where it stands first."""

    def add(self, node: Node, values: Types) -> Declaration:
        if not isinstance(node, Group) or not node.items:
            raise wrong(node, f"expected {with_article(self.kind)} in parentheses such as (name ?x - type), found {node}")
        written = new_name(node.items[0], self.kind, CONNECTIVES)
        name, first = self.first.setdefault(written.lower(), (written, node))
        declared = Declaration(name, self.symbols.variables(node.rest, declaring=True), values)
        if first is not node:
            declared = self._again(node, declared, self.found[name], where(first).line)
        self.found[name] = declared
        return declared

    def _again(self, node: Node, new: Declaration, old: Declaration, line: int) -> Declaration:
        if len(new.parameters) != len(old.parameters) or frozenset(new.values) != frozenset(old.values):
            raise wrong(node, f"the {self.kind} {new.name!r} is declared twice, and differently; the first time in line {line}")
        tolerate(node, f"the {self.kind} {new.name!r} is declared twice, the first time in line {line}; it takes the types of both")
        return Declaration(old.name, tuple(map(_either, old.parameters, new.parameters)), old.values)


def _either(old: Variable, new: Variable) -> Variable:
    return Variable(old.name, tuple(dict.fromkeys((*old.types, *new.types))))
