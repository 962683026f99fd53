"""The symbol table of a PDDL file, and the declarations that fill it.

Names are found without regard to case, spelled as first declared, checked by type.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Final, Literal, TypeAlias

from planner_bridge.model.problem import TOTAL_COST, Borrowed, Domain
from planner_bridge.pddl.expressions import (
    CONNECTIVES,
    NAME,
    Atom,
    Group,
    Node,
    Types,
    is_number,
    new_name,
    show_types,
    unknown,
    where,
    with_article,
    wrong,
)
from planner_bridge.pddl.sections import REFUSED_HEADS, Leniency, Requirements, type_words, typed_runs
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Variable
from pnm.errors import suggestion

SymbolKind: TypeAlias = Literal["predicate", "function"]

CONSTRAINTS: Final[Mapping[str, tuple[int, int]]] = {
    "always": (0, 1),
    "sometime": (0, 1),
    "at-most-once": (0, 1),
    "sometime-after": (0, 2),
    "sometime-before": (0, 2),
    "within": (1, 1),
    "always-within": (1, 2),
    "hold-during": (2, 1),
    "hold-after": (1, 1),
}
"""For every operator of a trajectory constraint, how many times and how many conditions it takes."""

OUTCOMES: Final[Mapping[str, str]] = {"oneof": ":non-deterministic", "probabilistic": ":probabilistic-effects"}
"""The words for effects that may turn out in several ways, and the requirement of each."""
_PLACES: Final[Mapping[str, str]] = {
    "preference": "in a goal, a precondition or :constraints, and there only inside and, forall",
    "is-violated": "in :metric",
    **dict.fromkeys(OUTCOMES, "in :effect"),
    **dict.fromkeys(CONSTRAINTS, "in :constraints"),
}
"""The positions of words that are neither predicates nor functions."""


@dataclass
class SymbolTable:
    """The types, objects, predicates and functions that are declared. The mutable state is those that are used undeclared."""

    domain: Domain
    objects: Mapping[str, Types]
    requirements: Requirements
    lenient: bool = False
    """In a domain: actions may name objects of the problems to come, and ask for facts that no action brings about."""
    derived: frozenset[str] = frozenset()
    costs: Declaration | None = None
    """The declaration of the total cost, when it is used undeclared."""
    borrowed: dict[str, Borrowed] = field(default_factory=dict)
    """Objects that a domain uses and only problems declare."""
    preference_names: dict[str, str] = field(default_factory=dict)
    """By lower case."""
    _undeclared: dict[str, bool] = field(default_factory=dict)
    """Answers of `is_undeclared`, by lower case."""

    def types(self, node: Node | None) -> Types:
        """Return the declared types of a typed list; ``object`` when it has none."""
        if node is None:
            return ("object",)
        self.requirements.need(node, ":typing")
        words = type_words(node)
        for word in words:
            if word.key not in self._types:
                raise unknown("type", word, self._types.values())
        return tuple(dict.fromkeys(self._types[word.key] for word in words))

    def variables(self, items: Sequence[Node], *, declaring: bool = False) -> tuple[Variable, ...]:
        """Read typed variables; only a declaration may repeat a name."""
        variables: list[Variable] = []
        seen: set[str] = set()
        for names, types_node in typed_runs(items):
            types = self.types(types_node)
            for name in names:
                if not isinstance(name, Atom) or name.text[0] != "?" or not NAME.fullmatch(name.text[1:]):
                    raise wrong(name, f"expected a variable such as ?x, found {name}")
                if name.key in seen:
                    if not declaring:
                        raise wrong(name, f"the variable {name} is there twice")
                    Leniency.VARIABLE_TWICE.note(name, name)
                seen.add(name.key)
                variables.append(Variable(name.text, types))
        return tuple(variables)

    def object(self, word: Atom, needed: Types) -> tuple[str, Types]:
        """Return the object's name as declared, and its types; a domain may use one of the needed types that its problems declare."""
        known = self._objects.get(word.key)
        if known is not None:
            return known
        if not self.lenient or not NAME.fullmatch(word.text) or is_number(word) or suggestion(word.text, self.objects):
            fitting = [name for name, types in self._objects.values() if self.domain.matches(types, needed)]
            raise unknown("object", word, fitting or self.objects)
        Leniency.OBJECT_OF_PROBLEMS.note(word, word)
        self.borrowed[word.text] = Borrowed(needed, where(word))
        self._objects[word.key] = word.text, needed
        return word.text, needed

    def find_object(self, name: str) -> tuple[str, Types] | None:
        """Return an object's name as declared and its types, or None when there is no such object."""
        return self._objects.get(name.lower())

    def predicate(self, node: Node) -> Declaration:
        """Return the declaration of the predicate the list begins with."""
        return self._declared(node, "predicate")

    def function(self, node: Node) -> Declaration:
        """Return the declaration of the function the list begins with; without arguments, the word alone will do."""
        return self._declared(node, "function")

    def find_function(self, node: Node) -> Declaration | None:
        """Return the declaration of the function that the word, or the list, begins with, if it is one."""
        word = node.items[0] if isinstance(node, Group) and node.items else node
        return self._functions.get(word.key) if isinstance(word, Atom) else None

    def has_predicate(self, key: str) -> bool:
        """Whether a predicate has this name, in lower case."""
        return key in self._predicates

    def is_undeclared(self, node: Node) -> bool:
        """Whether the list begins with a name that is not declared and is unlike any that is, so that it is no misspelling."""
        word = node.items[0] if isinstance(node, Group) and node.items else node
        if not isinstance(word, Atom) or word.key in self._predicates or word.key in self._functions:
            return False
        if isinstance(node, Group) and any(isinstance(part, Group) for part in node.rest):
            return False
        if word.key not in self._undeclared:
            self._undeclared[word.key] = (
                word.key not in (*_PLACES, *REFUSED_HEADS, *CONNECTIVES, TOTAL_COST)
                and NAME.fullmatch(word.text) is not None
                and not is_number(word)
                and not suggestion(word.key, [*self._predicates, *self._functions])
            )
        return self._undeclared[word.key]

    @cached_property
    def has_object_functions(self) -> bool:
        """Whether some function has objects for values."""
        return any(declared.values for declared in self._functions.values())

    def _declared(self, node: Node, kind: SymbolKind) -> Declaration:
        word = node.items[0] if isinstance(node, Group) and node.items else node
        if not isinstance(word, Atom):
            raise wrong(word, f"expected the name of {with_article(kind)}, found {word}")
        known, other = (self._predicates, self._functions) if kind == "predicate" else (self._functions, self._predicates)
        if word.key in known:
            return known[word.key]
        for key, declared in known.items():
            if key.replace("_", "-") == word.key.replace("_", "-"):
                Leniency.OTHER_SPELLING.note(word, kind, word, declared.name)
                return declared
        if kind == "function" and word.key == TOTAL_COST:
            Leniency.TOTAL_COST_UNDECLARED.note(word, word)
            self.costs = self._functions[TOTAL_COST] = Declaration(TOTAL_COST)
            return self.costs
        if word.key in other:
            raise wrong(word, f"{word} is a {'function' if kind == 'predicate' else 'predicate'}; expected a {kind}")
        if word.key in REFUSED_HEADS:
            raise REFUSED_HEADS[word.key].at(node)
        if word.key in _PLACES:
            raise wrong(word, f"{word} cannot stand here; expected it {_PLACES[word.key]}")
        if word.key in CONNECTIVES:
            raise wrong(word, f"{word} cannot stand here; expected a {kind}")
        raise unknown(kind, word, [declared.name for declared in known.values()])

    @cached_property
    def _types(self) -> dict[str, str]:
        return {name.lower(): name for name in ("object", *self.domain.types)}

    @cached_property
    def _predicates(self) -> dict[str, Declaration]:
        return {name.lower(): declared for name, declared in self.domain.predicates.items()}

    @cached_property
    def _functions(self) -> dict[str, Declaration]:
        return {name.lower(): declared for name, declared in self.domain.functions.items()}

    @cached_property
    def _objects(self) -> dict[str, tuple[str, Types]]:
        return {name.lower(): (name, types) for name, types in self.objects.items()}


# --- declarations ---------------------------------------------------------------------------------
# Declarations of a PDDL file: types, objects, predicates and functions.


Lists: TypeAlias = Iterable[Sequence[Node]]
"""The contents of each section of a name: a type at the end of one does not hold for the names in another."""


def declared_types(lists: Lists, requirements: Requirements) -> dict[str, Types]:
    """Read the type hierarchy; a type that only stands behind a ``-`` is declared by that."""
    first: dict[str, Node] = {}
    spelled = {"object": "object"}
    supertypes: dict[str, dict[str, None]] = {}  # for every type in order, the types written behind its ``-``, in order

    def named(node: Node) -> str:
        written = new_name(node, "type")
        name = spelled.setdefault(written.lower(), written)
        first.setdefault(name, node)
        supertypes.setdefault(name, {})
        return name

    declared: set[str] = set()
    for nodes, types_node in chain.from_iterable(map(typed_runs, lists)):
        requirements.need(nodes[0], ":typing")
        for node in nodes:
            if (name := named(node)) in declared and name != "object":
                Leniency.TYPE_TWICE.note(node, node)
            declared.add(name)
        above = dict.fromkeys(named(word) for word in type_words(types_node)) if types_node else {}
        for node in nodes:
            supertypes[named(node)].update(above)
    hierarchy = {name: tuple(parent for parent in above if parent != "object") for name, above in supertypes.items()}
    domain = Domain("", types=hierarchy)
    for name, parents in hierarchy.items():
        if any(name in domain.supertypes(parent) for parent in parents):
            raise wrong(first[name], f"the type {name!r} is a kind of itself")
    hierarchy.pop("object", None)
    return hierarchy


def declared_objects(lists: Lists, symbols: SymbolTable) -> dict[str, Types]:
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


def borrowed_objects(own: dict[str, Types], symbols: SymbolTable, whole: Node) -> dict[str, Types]:
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


def declared_predicates(parts: Sequence[Node], symbols: SymbolTable) -> dict[str, Declaration]:
    """Read the declarations of predicates."""
    table = _DeclarationTable("predicate", symbols)
    for part in parts:
        table.add(part, ())
    return table.declarations


def declared_functions(lists: Lists, symbols: SymbolTable, predicates: Mapping[str, Declaration]) -> dict[str, Declaration]:
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
