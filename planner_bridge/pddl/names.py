"""The names a PDDL file may use: found without regard to case, spelled as first declared, checked by type."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from typing import Final

from planner_bridge.model import Declaration, Domain
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from pnm.effects import OPERATIONS
from pnm.errors import InputError
from pnm.expressions import Variable

Types = tuple[str, ...]

CONNECTIVES: Final = frozenset(("and", "or", "not", "imply", "forall", "exists", "when", *OPERATIONS))
"""Words that begin a condition or an effect, so that no predicate or function can be called so."""

_NAME: Final = re.compile(r"[A-Za-z0-9_@.][A-Za-z0-9_@.-]*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_SHOWN: Final = 8
"""So many names at most are listed in an error."""

_FOREIGN: Final = {
    "preference": ("preferences", "a planner that weighs which goals to give up"),
    "oneof": ("uncertain facts (oneof)", "a contingent planner"),
    "unknown": ("uncertain facts (unknown)", "a contingent planner"),
    "probabilistic": ("probabilistic effects", "a probabilistic planner"),
    "is-violated": ("preferences (is-violated)", "a planner that weighs which goals to give up"),
    **dict.fromkeys(
        (
            *("always", "sometime", "within", "at-most-once", "sometime-after", "sometime-before"),
            *("always-within", "hold-during", "hold-after"),
        ),
        ("trajectory constraints", "checks over a whole run"),
    ),
}


# --- errors --------------------------------------------------------------------------------


def unsupported(node: Node, what: str, needed: str) -> InputError:
    """Return the error for a construct of PDDL that is not read."""
    return wrong(node, f"{what} are not supported yet; {needed} would be needed")


def unknown(kind: str, atom: Atom, known: Collection[str]) -> InputError:
    """Return the error for a name that nobody declared, with the nearest that somebody did."""
    spelled = {name.lower(): name for name in known}
    near = get_close_matches(atom.key, spelled, 1)
    if near:
        hint = f"did you mean {spelled[near[0]]!r}?"
    elif known:
        hint = f"expected one of {', '.join(list(known)[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}"
    else:
        hint = "none is declared"
    return wrong(atom, f"unknown {kind} {atom}; {hint}")


# --- words and typed lists -----------------------------------------------------------------


def is_number(node: Node) -> bool:
    """Tell whether the part is written as a number."""
    return isinstance(node, Atom) and _NUMBER.fullmatch(node.text) is not None


def number(node: Node) -> float:
    """Return the number, which must be finite."""
    if not isinstance(node, Atom) or not is_number(node):
        raise wrong(node, f"expected a number, found {node}")
    value = float(node.text)
    if value in (float("inf"), float("-inf")):
        raise wrong(node, f"the number {node.text} is too large")
    return value


def new_name(node: Node, kind: str, forbidden: Collection[str] = ()) -> str:
    """Return a name that is being declared, spelled as it stands."""
    match node:
        case Atom() if node.key in forbidden:
            raise wrong(node, f"{node} is a word of PDDL and cannot name {_one(kind)}")
        case Atom(text) if _NAME.fullmatch(text) and not is_number(node):
            return text
        case Atom(text) if text[0] != "?" and text[0] != ":" and not is_number(node):
            raise wrong(node, f"{node} cannot name {_one(kind)}; expected letters, digits and _ - . @")
        case _:
            raise wrong(node, f"expected the name of {_one(kind)}, found {node}")


def _one(kind: str) -> str:
    return f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"


def runs(items: Sequence[Node]) -> Iterator[tuple[list[Node], Node | None]]:
    """Split ``a b - t c`` into ``([a, b], t)`` and ``([c], None)``; ``-t`` without a space is read too."""
    names: list[Node] = []
    rest = iter(items)
    for item in rest:
        match item:
            case Atom("-"):
                kind = next(rest, None)
                if kind is None:
                    raise wrong(item, "expected a type after '-', found nothing")
            case Atom(text, offset, source) if text[0] == "-":
                kind = Atom(text[1:], offset + 1, source)
            case _:
                names.append(item)
                continue
        if not names:
            raise wrong(item, "expected a name before '-', found nothing")
        yield names, kind
        names = []
    if names:
        yield names, None


def type_words(node: Node) -> tuple[Atom, ...]:
    """Return the words of ``t`` or ``(either t u)``."""
    words = node.rest if isinstance(node, Group) and node.head == "either" and node.rest else (node,)
    found = tuple(word for word in words if isinstance(word, Atom))
    if len(found) < len(words):
        raise wrong(node, f"expected a type or (either TYPE ...), found {node}")
    return found


def show_types(types: Types) -> str:
    """Write the types of a term for a person."""
    return " or ".join(types)


# --- look-up -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Names:
    """Everything declared so far: what a domain declares, and the objects."""

    domain: Domain
    objects: Mapping[str, Types]

    def types(self, node: Node | None) -> Types:
        """Return the types a typed list gives; ``object`` when it gives none."""
        if node is None:
            return ("object",)
        words = type_words(node)
        for word in words:
            if word.key not in self._types:
                raise unknown("type", word, self._types.values())
        return tuple(dict.fromkeys(self._types[word.key] for word in words))

    def variables(self, items: Sequence[Node], *, distinct: bool = True) -> tuple[Variable, ...]:
        """Read typed variables; only a declaration may repeat a name."""
        found: list[Variable] = []
        seen: set[str] = set()
        for names, kind in runs(items):
            types = self.types(kind)
            for name in names:
                if not isinstance(name, Atom) or name.text[0] != "?" or not _NAME.fullmatch(name.text[1:]):
                    raise wrong(name, f"expected a variable such as ?x, found {name}")
                if distinct and name.key in seen:
                    raise wrong(name, f"the variable {name} is there twice")
                seen.add(name.key)
                found.append(Variable(name.text, types))
        return tuple(found)

    def predicate(self, node: Group) -> Declaration:
        """Return the declaration of the predicate the list begins with."""
        return self._declared(node, "predicate", self._predicates, "function", self._functions)

    def function(self, node: Node) -> Declaration:
        """Return the declaration of the function the list begins with; without arguments, the word alone will do."""
        return self._declared(node, "function", self._functions, "predicate", self._predicates)

    def is_function(self, word: Atom) -> bool:
        """Tell whether a function has this name."""
        return word.key in self._functions

    def has_predicate(self, key: str) -> bool:
        """Tell whether a predicate has this name, in lower case."""
        return key in self._predicates

    def object(self, word: Atom) -> tuple[str, Types]:
        """Return the object's name as declared, and its types."""
        found = self.find_object(word.text)
        if found is None:
            raise unknown("object", word, self.objects)
        return found

    def find_object(self, name: str) -> tuple[str, Types] | None:
        """Return an object's name as declared and its types, or None when there is no such object."""
        return self._objects.get(name.lower())

    def matches(self, given: Types, needed: Types) -> bool:
        """Tell whether an object of these types can stand where the others are needed."""
        return given == needed or any(not self._supertypes[one].isdisjoint(needed) for one in given)

    def may_match(self, given: Types, needed: Types) -> bool:
        """Tell whether some object that fits the given types also fits the needed ones."""
        if self.matches(given, needed):
            return True
        below = [self._subtypes[one] for one in needed]
        return any(not self._subtypes[one].isdisjoint(other) for one in given for other in below)

    def _declared(
        self, node: Node, kind: str, known: Mapping[str, Declaration], other_kind: str, other: Mapping[str, Declaration]
    ) -> Declaration:
        word = node.items[0] if isinstance(node, Group) and node.items else node
        if not isinstance(word, Atom):
            raise wrong(word, f"expected the name of {_one(kind)}, found {word}")
        if word.key in known:
            return known[word.key]
        if word.key in other:
            raise wrong(word, f"{word} is a {other_kind}; expected a {kind}")
        if word.key in _FOREIGN:
            raise unsupported(node, *_FOREIGN[word.key])
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

    @cached_property
    def _supertypes(self) -> dict[str, frozenset[str]]:
        return {name: self.domain.supertypes(name) for name in self._types.values()}

    @cached_property
    def _subtypes(self) -> dict[str, frozenset[str]]:
        return {name: frozenset(below for below, above in self._supertypes.items() if name in above) for name in self._types.values()}
