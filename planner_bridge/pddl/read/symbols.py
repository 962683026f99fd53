"""The symbol table of a PDDL file: names are found without regard to case, spelled as first declared, checked by type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, TypeAlias

from planner_bridge.model.problem import Borrowed, Domain
from planner_bridge.pddl.read.requirements import REFUSED_HEADS, Leniency, Requirements
from planner_bridge.pddl.read.sections import type_words, typed_runs
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, where, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, NAME, Types, is_number, nearest, unknown, with_article
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Variable

SymbolKind: TypeAlias = Literal["predicate", "function"]

TOTAL_COST: Final = "total-cost"
"""The one function that is used undeclared."""
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

_PLACES: Final[Mapping[str, str]] = {
    "preference": "in a goal, a precondition or :constraints, and there only inside and, forall",
    "is-violated": "in :metric",
    **dict.fromkeys(CONSTRAINTS, "in :constraints"),
}
"""Where words may stand that are neither predicates nor functions."""


@dataclass
class SymbolTable:
    """The types, objects, predicates and functions that are declared.

    The mutable state is the symbols that are used without having been declared.
    """

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
        if not self.lenient or not NAME.fullmatch(word.text) or is_number(word) or nearest(word, self.objects):
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
                and nearest(word, [*self._predicates, *self._functions]) is None
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
