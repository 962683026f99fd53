"""Names in formulas: which ones may be used where a formula stands, and PDDL's texts for facts and typed lists."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from pnm.core.logic.expressions import DURATION, UNDEFINED, Fluent, Variable
from pnm.errors import InputError, Position, suggestion
from pnm.files.yaml_nodes import Node

_FLUENT: Final = re.compile(r"\(\s*([^\s()?][^\s()]*(?:\s+[^\s()]+)*)\s*\)\Z")
_VARIABLE: Final = re.compile(r"\?[^\s()?]+\Z")
_TOKEN: Final = re.compile(r"[()]|[^\s()]+")


@dataclass(frozen=True, slots=True)
class Scope:
    """The names that a formula may use; anything goes where a field is None."""

    variables: frozenset[str] | None = None
    """With ``?``: the parameters of the action, and what quantifiers around the formula bind."""
    fluents: Mapping[str, int | None] | None = None
    """Predicates and functions, each with how many arguments it takes, if that is known."""
    objects: frozenset[str] | None = None
    types: frozenset[str] | None = None
    predicates: frozenset[str] = frozenset()
    """Which of the fluents are known to be true or false."""

    def inside(self, variables: Iterable[Variable]) -> Scope:
        """Return the scope inside of a quantifier."""
        if self.variables is None:
            return self
        return replace(self, variables=self.variables | {variable.name for variable in variables})

    def check_variable(self, name: str, position: Position) -> None:
        """Refuse a variable that is not there."""
        if self.variables is not None and name != DURATION[0] and name not in self.variables:
            raise unknown("parameter", name, self.variables, position)

    def check_object(self, name: str, position: Position) -> None:
        """Refuse an object, or a variable, that is not there."""
        if name.startswith("?"):
            self.check_variable(name, position)
        elif self.objects is not None and name != UNDEFINED and name not in self.objects:
            raise unknown("object", name, self.objects, position)

    def check_fluent(self, fluent: Fluent, position: Position) -> None:
        """Refuse a fluent of names that are not there, or with another number of arguments than it takes."""
        if self.fluents is not None:
            if fluent[0] not in self.fluents:
                raise unknown("predicate or function", fluent[0], self.fluents, position)
            takes = self.fluents[fluent[0]]
            if takes is not None and takes != len(fluent) - 1:
                raise InputError(f"{fluent[0]} takes {takes} arguments, found {len(fluent) - 1}", position)
        for name in fluent[1:]:
            self.check_object(name, position)

    def check_type(self, name: str, position: Position) -> None:
        """Refuse a type that is not there."""
        if self.types is not None and name != "object" and name not in self.types:
            raise unknown("type", name, self.types, position)


ANYTHING: Final = Scope()
"""Where no names are declared."""


def unknown(what: str, name: str, known: Collection[str], position: Position | None) -> InputError:
    """Return the error about a name that is not there, with the nearest one that is."""
    names = sorted(known)
    hint = suggestion(name, names) or f"expected one of: {', '.join(names[:20]) or 'none at all'}"
    return InputError(f"there is no {what} {name!r} here; {hint}", position)


def is_variable(text: str) -> bool:
    """Tell whether the text names a parameter: ``?x``."""
    return _VARIABLE.match(text) is not None


def fluent_in(text: str) -> Fluent | None:
    """Read ``(at ?r kitchen)``; None for any other text."""
    found = _FLUENT.match(text.strip())
    return tuple(found[1].split()) if found else None


def read_fluent(node: Node, scope: Scope = ANYTHING) -> Fluent:
    """Read the text of a fact, or of a function with its arguments: ``(at ?r kitchen)``.

    Raises:
        InputError: it is something else, or has names that are not there.
    """
    found = fluent_in(node.text) if node.text is not None else None
    if found is None:
        raise node.wrong(f"expected something like (at ?r kitchen), found {shown(node)}")
    scope.check_fluent(found, node.position)
    return found


def read_typed(node: Node, scope: Scope = ANYTHING) -> tuple[Variable, ...]:
    """Read variables with their types: PDDL's text ``?r - robot ?from ?to - place``, or a list of such texts.

    In a list a name may stand without its ``?``.

    Raises:
        InputError: it is something else, a name is there twice, or a type is not there.
    """
    parts = (node,) if node.items is None else node.items
    return _variables([pair for part in parts if not part.is_null for pair in _typed(_text(part), part, scope)], node)


def read_typed_text(text: str, node: Node, scope: Scope = ANYTHING, *, distinct: bool = True) -> tuple[Variable, ...]:
    """Read variables with their types from a part of the node's text; where they only say how many there are, names may repeat."""
    return _variables(_typed(text, node, scope), node, distinct=distinct)


def _variables(pairs: list[tuple[str, tuple[str, ...]]], node: Node, *, distinct: bool = True) -> tuple[Variable, ...]:
    found = tuple(Variable(name if name.startswith("?") else f"?{name}", types) for name, types in pairs)
    counted = Counter(variable.name for variable in found)
    if distinct and counted and counted.most_common(1)[0][1] > 1:
        raise node.wrong(f"{counted.most_common(1)[0][0]} is there twice")
    return found


def read_names(node: Node, scope: Scope = ANYTHING) -> dict[str, tuple[str, ...]]:
    """Read names with their types, such as objects: ``r1 r2 - robot kitchen - place``, or a list of such texts."""
    parts = (node,) if node.items is None else node.items
    return {name: types for part in parts if not part.is_null for name, types in _typed(_text(part), part, scope)}


def _text(node: Node) -> str:
    if node.text is None:
        hint = f"; write {node.written!r} with quotes" if node.written else ""
        raise node.wrong(f"expected names and types such as '?r - robot ?to - place'{hint}")
    return node.text


def _typed(text: str, node: Node, scope: Scope) -> list[tuple[str, tuple[str, ...]]]:
    tokens: deque[str] = deque(_TOKEN.findall(text))
    found: list[tuple[str, tuple[str, ...]]] = []
    waiting: list[str] = []
    while tokens:
        token = tokens.popleft()
        if token == "-" and waiting:
            types = _types(tokens, node)
            for one in types:
                scope.check_type(one, node.position)
            found += [(name, types) for name in waiting]
            waiting = []
        elif token in ("-", "(", ")", "?"):
            raise node.wrong(f"expected a name in place of {token!r} in {shown(node)}")
        else:
            waiting.append(token)
    return [*found, *((name, ("object",)) for name in waiting)]


def _types(tokens: deque[str], node: Node) -> tuple[str, ...]:
    """Take one type, or ``(either a b)``, from the tokens."""
    first = tokens.popleft() if tokens else ""
    if first and first not in "()-":
        return (first,)
    types: list[str] = []
    if first == "(" and tokens and tokens.popleft() == "either":
        while tokens and tokens[0] not in "()-":
            types.append(tokens.popleft())
        if types and tokens and tokens.popleft() == ")":
            return tuple(types)
    raise node.wrong(f"expected a type, or (either a b), after '-' in {shown(node)}")


def shown(node: Node) -> str:
    """Say what stands there, in few words."""
    if node.text is not None:
        return repr(node.text if len(node.text) < 60 else f"{node.text[:59]}…")
    return "a mapping" if node.is_mapping else "a list" if node.items is not None else node.written or "nothing"
