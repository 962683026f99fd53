"""Declarations of a PDDL file: types, objects, predicates and functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import TypeAlias

from planner_bridge.model.problem import Domain
from planner_bridge.pddl.read.requirements import Leniency, Requirements
from planner_bridge.pddl.read.sections import type_words, typed_runs
from planner_bridge.pddl.read.symbols import SymbolKind, SymbolTable
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, where, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, Types, new_name, show_types, with_article
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Variable

Lists: TypeAlias = Iterable[Sequence[Node]]
"""The contents of each section of a name: a type at the end of one does not hold for the names in another."""


@dataclass(frozen=True, slots=True)
class _TypeHierarchy:
    first: dict[str, Node] = field(default_factory=dict)
    """Where each type is named first."""
    spelled: dict[str, str] = field(default_factory=lambda: {"object": "object"})
    supertypes: dict[str, dict[str, None]] = field(default_factory=dict)
    """For every type in order, the types written behind its ``-``, in order."""
    declared: set[str] = field(default_factory=set)
    """Types that have stood before a ``-``, or without one."""

    def name(self, node: Node) -> str:
        written = new_name(node, "type")
        name = self.spelled.setdefault(written.lower(), written)
        self.first.setdefault(name, node)
        self.supertypes.setdefault(name, {})
        return name

    def declare(self, node: Node) -> str:
        name = self.name(node)
        if name in self.declared and name != "object":
            Leniency.TYPE_TWICE.note(node, node)
        self.declared.add(name)
        return name


def types(lists: Lists, requirements: Requirements) -> dict[str, Types]:
    """Read the type hierarchy; a type that only stands behind a ``-`` is declared by that."""
    table = _TypeHierarchy()
    for nodes, types_node in chain.from_iterable(map(typed_runs, lists)):
        requirements.need(nodes[0], ":typing")
        children = [table.declare(name) for name in nodes]
        above = dict.fromkeys(table.name(word) for word in type_words(types_node)) if types_node else {}
        for child in children:
            table.supertypes[child].update(above)
    hierarchy = {name: tuple(parent for parent in above if parent != "object") for name, above in table.supertypes.items()}
    domain = Domain("", types=hierarchy)
    for name, parents in hierarchy.items():
        if any(name in domain.supertypes(parent) for parent in parents):
            raise wrong(table.first[name], f"the type {name!r} is a kind of itself")
    hierarchy.pop("object", None)
    return hierarchy


def objects(lists: Lists, symbols: SymbolTable) -> dict[str, Types]:
    """Read constants or objects; one that is there again, or in the symbol table already, is of all the types given."""
    declared: dict[str, tuple[str, Types]] = {}
    for words, types_node in chain.from_iterable(map(typed_runs, lists)):
        given = symbols.types(types_node)
        for word in words:
            name = new_name(word, "object")
            key = name.lower()
            before = declared.get(key) or symbols.find_object(name)
            if before is None:
                declared[key] = name, given
                continue
            different = f": as {show_types(given)} here, as {show_types(before[1])} before; it is of both types"
            Leniency.OBJECT_TWICE.note(word, name, "" if frozenset(given) == frozenset(before[1]) else different)
            both = symbols.domain.joined(before[1], given)
            if both != before[1]:
                declared[key] = before[0], both
    return dict(declared.values())


def borrow(own: dict[str, Types], symbols: SymbolTable, whole: Node) -> dict[str, Types]:
    """Return a problem's objects, spelled as its domain spells those that it borrows; they must all be there."""
    borrowed = symbols.domain.borrowed
    spelled = {name.lower(): name for name in borrowed}
    objects = {spelled.get(name.lower(), name): types for name, types in own.items()}
    for name, use in borrowed.items():
        if name not in objects:
            raise wrong(whole, f"the object {name!r} is not declared; the domain names it at {use.position}")
        if not symbols.domain.matches(objects[name], use.types):
            raise wrong(whole, f"{name!r} is of type {show_types(objects[name])}; the domain expects {show_types(use.types)}")
    return objects


def predicates(parts: Sequence[Node], symbols: SymbolTable) -> dict[str, Declaration]:
    """Read the declarations of predicates."""
    table = _DeclarationTable("predicate", symbols)
    for part in parts:
        table.add(part, ())
    return table.declarations


def functions(lists: Lists, symbols: SymbolTable, predicates: Mapping[str, Declaration]) -> dict[str, Declaration]:
    """Read the declarations of functions, none of which may have both the name and the arity of a predicate."""
    table = _DeclarationTable("function", symbols)
    taken = {(name.lower(), len(declared.parameters)) for name, declared in predicates.items()}
    for nodes, types_node in chain.from_iterable(map(typed_runs, lists)):
        is_numeric = types_node is None or (isinstance(types_node, Atom) and types_node.key == "number")
        if not is_numeric:
            symbols.requirements.need(types_node or nodes[0], ":object-fluents")
        values = () if is_numeric else symbols.types(types_node)
        for node in nodes:
            declared = table.add(node, values)
            if (declared.name.lower(), len(declared.parameters)) in taken:
                raise wrong(node, f"the function {declared.name!r} has the name and the number of arguments of a predicate")
    return table.declarations


@dataclass(frozen=True, slots=True)
class _DeclarationTable:
    """Predicates or functions by name; one that is declared again takes the types of both declarations."""

    kind: SymbolKind
    symbols: SymbolTable
    declarations: dict[str, Declaration] = field(default_factory=dict)
    first: dict[str, tuple[str, Node]] = field(default_factory=dict)
    """For every name in lower case, its spelling and where it stands first."""

    def add(self, node: Node, values: Types) -> Declaration:
        if not isinstance(node, Group) or not node.items:
            raise wrong(node, f"expected {with_article(self.kind)} in parentheses such as (name ?x - type), found {node}")
        written = new_name(node.items[0], self.kind, CONNECTIVES)
        name, first = self.first.setdefault(written.lower(), (written, node))
        parameters = self.symbols.variables(node.rest, declaring=True)
        if first is not node:
            old, line = self.declarations[name], where(first).line
            if len(parameters) != len(old.parameters) or frozenset(values) != frozenset(old.values):
                raise wrong(node, f"the {self.kind} {name!r} is declared twice, and differently; the first time in line {line}")
            Leniency.SYMBOL_TWICE.note(node, self.kind, name, line)
            both = zip(old.parameters, parameters, strict=True)
            parameters = tuple(Variable(first.name, tuple(dict.fromkeys((*first.types, *second.types)))) for first, second in both)
            values = old.values
        self.declarations[name] = Declaration(name, parameters, values)
        return self.declarations[name]
