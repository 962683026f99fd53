"""The names a PDDL file may use: found without regard to case, spelled as first declared, checked by type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, NoReturn, TypeAlias

from planner_bridge.model.problem import Borrowed, Declaration, Domain
from planner_bridge.pddl.read.requirements import Requirements
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, where, wrong
from planner_bridge.pddl.syntax.words import (
    CONNECTIVES,
    CONTINGENT,
    NAME,
    Types,
    is_number,
    nearest,
    type_words,
    typed_runs,
    unknown,
    unsupported,
    with_article,
)
from pnm.core.logic.expressions import Variable

_Kind: TypeAlias = Literal["predicate", "function"]

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

_UNCERTAIN: Final[Mapping[str, tuple[str, str]]] = {
    "oneof": ("uncertain facts (oneof)", CONTINGENT),
    "unknown": ("uncertain facts (unknown)", CONTINGENT),
    "probabilistic": ("probabilistic effects", "a probabilistic planner"),
}
_PLACES: Final[Mapping[str, str]] = {
    "preference": "in a goal, a precondition or :constraints, and there only inside and, forall",
    "is-violated": "in :metric",
    **dict.fromkeys(CONSTRAINTS, "in :constraints"),
}


@dataclass
class SymbolTable:
    """Everything declared so far: what a domain declares, and the objects.

    The mutable state is what is used without having been declared.
    """

    domain: Domain
    objects: Mapping[str, Types]
    requirements: Requirements
    lenient: bool = False
    """In a domain: actions may name objects of the problems to come, and ask for facts that no action brings about."""
    derived: frozenset[str] = frozenset()
    """Predicates that follow from others."""
    costs: Declaration | None = None
    """Of the total cost, when it is used undeclared."""
    borrowed: dict[str, Borrowed] = field(default_factory=dict)
    """Objects that only problems declare."""
    preference_names: dict[str, str] = field(default_factory=dict)
    """Names of preferences, by lower case."""
    _strays: dict[str, bool] = field(default_factory=dict)
    """Answers of `is_undeclared`, by lower case."""

    # --- types ---

    def types(self, node: Node | None) -> Types:
        """Return the types a typed list gives; ``object`` when it gives none."""
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
        found: list[Variable] = []
        seen: set[str] = set()
        for names, kind in typed_runs(items):
            given = self.types(kind)
            for name in names:
                if not isinstance(name, Atom) or name.text[0] != "?" or not NAME.fullmatch(name.text[1:]):
                    raise wrong(name, f"expected a variable such as ?x, found {name}")
                if name.key in seen:
                    if not declaring:
                        raise wrong(name, f"the variable {name} is there twice")
                    tolerate(name, f"the variable {name} is there twice")
                seen.add(name.key)
                found.append(Variable(name.text, given))
        return tuple(found)

    def joined(self, *types: Types) -> Types:
        """Return the types of something that is of all of these, without those that follow from another."""
        every = tuple(dict.fromkeys(kind for some in types for kind in some))
        return tuple(kind for kind in every if not any(kind in self._supertypes[other] for other in every if other != kind))

    def matches(self, given: Types, needed: Types) -> bool:
        """Tell whether an object of these types can stand where the others are needed."""
        return given == needed or any(not self._supertypes[one].isdisjoint(needed) for one in given)

    def may_match(self, given: Types, needed: Types) -> bool:
        """Tell whether some object that fits the given types also fits the needed ones."""
        if self.matches(given, needed):
            return True
        below = [self._subtypes[one] for one in needed]
        return any(not self._subtypes[one].isdisjoint(other) for one in given for other in below)

    # --- objects ---

    def object(self, word: Atom, needed: Types) -> tuple[str, Types]:
        """Return the object's name as declared, and its types; a problem may still have to declare it, as what is needed."""
        found = self.find_object(word.text)
        if found is None:
            return self._borrow(word, needed)
        return found

    def find_object(self, name: str) -> tuple[str, Types] | None:
        """Return an object's name as declared and its types, or None when there is no such object."""
        return self._objects.get(name.lower())

    def _borrow(self, word: Atom, needed: Types) -> tuple[str, Types]:
        if not self.lenient or not NAME.fullmatch(word.text) or is_number(word) or nearest(word, self.objects):
            raise unknown("object", word, self.objects)
        tolerate(word, f"the object {word} is not among the :constants; every problem has to declare it")
        self.borrowed[word.text] = Borrowed(needed, where(word))
        self._objects[word.key] = (word.text, needed)
        return self._objects[word.key]

    # --- predicates and functions ---

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
        """Tell whether a predicate has this name, in lower case."""
        return key in self._predicates

    def is_undeclared(self, node: Node) -> bool:
        """Tell whether the list begins with a name that nothing has, nor anything alike: no slip of the pen."""
        word = node.items[0] if isinstance(node, Group) and node.items else node
        if not isinstance(word, Atom) or word.key in self._predicates or word.key in self._functions:
            return False
        if isinstance(node, Group) and any(isinstance(part, Group) for part in node.rest):
            return False
        if word.key not in self._strays:
            self._strays[word.key] = (
                word.key not in (*_PLACES, *_UNCERTAIN, *CONNECTIVES, TOTAL_COST)
                and NAME.fullmatch(word.text) is not None
                and not is_number(word)
                and nearest(word, [*self._predicates, *self._functions]) is None
            )
        return self._strays[word.key]

    @cached_property
    def has_object_functions(self) -> bool:
        """Whether some function has objects for values."""
        return any(declared.values for declared in self._functions.values())

    def _declared(self, node: Node, kind: _Kind) -> Declaration:
        word = node.items[0] if isinstance(node, Group) and node.items else node
        if not isinstance(word, Atom):
            raise wrong(word, f"expected the name of {with_article(kind)}, found {word}")
        known = self._known(kind)
        if word.key in known:
            return known[word.key]
        return self._alike(word, kind) or self._undeclared_cost(word, kind) or self._refuse(node, word, kind)

    def _known(self, kind: _Kind) -> dict[str, Declaration]:
        return self._predicates if kind == "predicate" else self._functions

    def _alike(self, word: Atom, kind: _Kind) -> Declaration | None:
        for key, declared in self._known(kind).items():
            if key.replace("_", "-") == word.key.replace("_", "-"):
                tolerate(word, f"the {kind} {word} is read as {declared.name!r}")
                return declared
        return None

    def _undeclared_cost(self, word: Atom, kind: _Kind) -> Declaration | None:
        if kind != "function" or word.key != TOTAL_COST:
            return None
        tolerate(word, f"the function {word} is not declared; it is read as (total-cost) - number")
        self.costs = self._functions[TOTAL_COST] = Declaration(TOTAL_COST)
        return self.costs

    def _refuse(self, node: Node, word: Atom, kind: _Kind) -> NoReturn:
        other: _Kind = "function" if kind == "predicate" else "predicate"
        if word.key in self._known(other):
            raise wrong(word, f"{word} is a {other}; expected a {kind}")
        if word.key in _UNCERTAIN:
            raise unsupported(node, *_UNCERTAIN[word.key])
        if word.key in _PLACES:
            raise wrong(word, f"{word} cannot stand here; expected it {_PLACES[word.key]}")
        if word.key in CONNECTIVES:
            raise wrong(word, f"{word} cannot stand here; expected a {kind}")
        raise unknown(kind, word, [declared.name for declared in self._known(kind).values()])

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

    @cached_property
    def _supertypes(self) -> dict[str, frozenset[str]]:
        return {name: self.domain.supertypes(name) for name in self._types.values()}

    @cached_property
    def _subtypes(self) -> dict[str, frozenset[str]]:
        return {name: frozenset(below for below, above in self._supertypes.items() if name in above) for name in self._types.values()}
