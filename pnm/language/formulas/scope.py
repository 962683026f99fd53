"""Names in formulas: which ones may be used where a formula stands, and PDDL's texts for facts and typed lists."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

from pnm.core.logic.domain import Declaration, DomainModel, ProblemModel, Types
from pnm.core.logic.expressions import DURATION, UNDEFINED, Constant, Expression, Fluent, ValueOf, Variable
from pnm.errors import InputError, Position, suggestion
from pnm.files.yaml_nodes import Node

FluentKind: TypeAlias = Literal["predicate", "function"]

_FLUENT: Final = re.compile(r"\(\s*([^\s()?][^\s()]*(?:\s+[^\s()]+)*)\s*\)\Z")
_VARIABLE: Final = re.compile(r"\?[^\s()?]+\Z")
_TOKEN: Final = re.compile(r"[()]|[^\s()]+")


NOTHING_DECLARED: Final = ProblemModel("", DomainModel(""))
_ANY: Final = ("object",)


@dataclass(frozen=True, slots=True)
class FormulaScope:
    """The names that a formula may use: what is declared, and the variables bound around it.

    Where no names of a kind are declared, any will do, unless the scope is strict.
    """

    declared: ProblemModel = NOTHING_DECLARED
    variables: Mapping[str, Types] | None = None
    """With ``?``, the parameters of the action and what quantifiers around the formula bind, with their types; any if None."""
    strict: bool = False
    """Whether the formula is for planners: all names are declared, of the right kind and type, and it has facts and functions alone."""
    borrows: bool = False
    """Of a strict scope: whether objects may be named that only problems declare."""

    def inside(self, variables: Iterable[Variable]) -> FormulaScope:
        """Return the scope inside of a quantifier."""
        if self.variables is None:
            return self
        return replace(self, variables={**self.variables, **{variable.name: variable.types for variable in variables}})

    def check_variable(self, name: str, node: Node) -> None:
        """Refuse a variable that is not bound here."""
        if self.variables is not None and name not in self.variables and (self.strict or name != DURATION[0]):
            raise unknown("parameter", name, self.variables, node.position_of(name))

    def check_object(self, name: str, node: Node, needed: Types = _ANY) -> None:
        """Refuse an object, or a variable, that is not there; in a strict scope, one that is of none of the needed types, too."""
        known = self.declared.objects
        if name.startswith("?"):
            self.check_variable(name, node)
        elif name not in known and (not self.borrows if self.strict else known and name != UNDEFINED):
            raise unknown("object", name, known, node.position_of(name))
        if not self.strict:
            return
        if name == DURATION[0]:
            raise InputError(f"{name} is a number; expected an object", node.position_of(name))
        domain = self.declared.domain
        types = (self.variables or {}).get(name, _ANY) if name.startswith("?") else known.get(name, needed)
        if not (domain.may_match if name.startswith("?") else domain.matches)(types, needed):
            raise InputError(f"{name!r} is of type {' or '.join(types)}; expected {' or '.join(needed)}", node.position_of(name))

    def check_fluent(self, fluent: Fluent, node: Node, kind: FluentKind | None = None) -> None:
        """Refuse a fluent of names that are not there, or with another number of arguments than it takes.

        In a strict scope, refuse one of another kind, or with arguments of other types, too.
        """
        declaration = self._declaration(fluent[0], node, kind)
        if declaration is not None and len(declaration.parameters) != len(fluent) - 1:
            raise InputError(f"{fluent[0]} takes {len(declaration.parameters)} arguments, found {len(fluent) - 1}", node.position)
        needed = [_ANY] * (len(fluent) - 1) if declaration is None else [variable.types for variable in declaration.parameters]
        for name, types in zip(fluent[1:], needed, strict=True):
            self.check_object(name, node, types)

    def _declaration(self, name: str, node: Node, kind: FluentKind | None) -> Declaration | None:
        domain = self.declared.domain
        known = domain.fluents
        if not self.strict or kind is None:
            if known and name not in known:
                raise unknown("predicate or function", name, known, node.position_of(name))
            return known.get(name)
        own: Mapping[str, Declaration] = domain.predicates if kind == "predicate" else domain.functions
        if name not in own and name in known:
            other = "function" if kind == "predicate" else "predicate"
            raise InputError(f"{name} is a {other}; expected a {kind}", node.position_of(name))
        if name not in own:
            raise unknown(kind, name, own, node.position_of(name))
        return own[name]

    def check_change(self, fluent: Fluent, node: Node, value: Expression, value_node: Node | None = None) -> None:
        """Refuse a new value of what is not there; in a strict scope, one of another kind or type, or of a derived predicate, too.

        The value stands in the node of the fluent, if not in one of its own.
        """
        is_truth = isinstance(value, Constant) and isinstance(value.value, bool)
        self.check_fluent(fluent, node, "predicate" if is_truth else "function")
        if not self.strict:
            return
        if is_truth:
            if fluent[0] in self.declared.domain.rules.derived:
                raise InputError(f"{fluent[0]!r} is a derived predicate; it follows from others", node.position_of(fluent[0]))
            return
        self.check_value(value, self._values(fluent), value_node or node)

    def check_value(self, value: Expression, types: Types, node: Node) -> None:
        """Refuse an expression that is no number, or, where types are given, no object of any of these."""
        match value:
            case Constant(str() as name) if types:
                if name != UNDEFINED:
                    self.check_object(name, node, types)
            case ValueOf(fluent) if types and (own := self._values(fluent)):
                if not self.declared.domain.may_match(own, types):
                    raise node.wrong(f"{value} is of type {' or '.join(own)}; expected {' or '.join(types)}")
            case _ if types or self.is_object(value):
                raise node.wrong(f"expected {'an object' if types else 'a number'}, found {value}")

    def is_object(self, value: Expression) -> bool:
        """Return whether the expression stands for an object rather than a number."""
        match value:
            case Constant(constant):
                return isinstance(constant, str)
            case ValueOf(fluent):
                return bool(self._values(fluent))
            case _:
                return False

    def _values(self, fluent: Fluent) -> Types:
        """Return the types of the values of a function, if these are objects."""
        return () if fluent == DURATION else self.declared.domain.functions[fluent[0]].values

    def check_type(self, name: str, node: Node) -> None:
        """Refuse a type that is not there."""
        known = self.declared.domain.types
        if name != "object" and name not in known and (known or self.strict):
            raise unknown("type", name, known, node.position_of(name))


ANYTHING: Final = FormulaScope()
"""The scope without declared names."""


def unknown(what: str, name: str, known: Collection[str], position: Position | None) -> InputError:
    """Return the error about a name that is not there, with the nearest one that is."""
    return InputError(f"there is no {what} {name!r} here; {known_names(name, known)}", position)


def known_names(name: str, known: Collection[str]) -> str:
    """Return the known name nearest to this one, or which names are known, as the end of an error."""
    names = sorted(known)
    return suggestion(name, names) or (f"expected one of: {', '.join(names[:20])}" if names else "there is none")


def is_variable(text: str) -> bool:
    """Return whether the text names a parameter: ``?x``."""
    return _VARIABLE.match(text) is not None


def fluent_in(text: str) -> Fluent | None:
    """Read ``(at ?r kitchen)``; None for any other text."""
    match = _FLUENT.match(text.strip())
    return tuple(match[1].split()) if match else None


def read_fluent(node: Node, scope: FormulaScope = ANYTHING, kind: FluentKind | None = None) -> Fluent:
    """Read the text of a fact, or of a function with its arguments: ``(at ?r kitchen)``."""
    fluent = fluent_in(node.text) if node.text is not None else None
    if fluent is None:
        raise node.wrong(f"expected something like (at ?r kitchen), found {shown(node)}")
    scope.check_fluent(fluent, node, kind)
    return fluent


def read_typed(node: Node, scope: FormulaScope = ANYTHING) -> tuple[Variable, ...]:
    """Read variables with their types: PDDL's text ``?r - robot ?from ?to - place``, or a list of such texts.

    In a list a name may stand without its ``?``.
    """
    return _variables(_typed_list(node, scope), node)


def read_typed_text(text: str, node: Node, scope: FormulaScope = ANYTHING, *, distinct: bool = True) -> tuple[Variable, ...]:
    """Read variables with their types from a part of the node's text; names that only give the arity may repeat."""
    return _variables(_typed(text, node, scope), node, distinct=distinct)


def _variables(pairs: list[tuple[str, tuple[str, ...]]], node: Node, *, distinct: bool = True) -> tuple[Variable, ...]:
    variables = tuple(Variable(name if name.startswith("?") else f"?{name}", types) for name, types in pairs)
    counted = Counter(variable.name for variable in variables)
    if distinct and counted and counted.most_common(1)[0][1] > 1:
        raise node.wrong(f"{counted.most_common(1)[0][0]} is there twice")
    return variables


def read_names(node: Node, scope: FormulaScope = ANYTHING) -> dict[str, tuple[str, ...]]:
    """Read names with their types, such as objects: ``r1 r2 - robot kitchen - place``, or a list of such texts."""
    typed: dict[str, Types] = {}
    for name, types in _typed_list(node, scope):
        typed[name] = tuple(dict.fromkeys((*typed.get(name, ()), *types)))
    return typed


def _typed_list(node: Node, scope: FormulaScope) -> list[tuple[str, Types]]:
    pairs: list[tuple[str, Types]] = []
    for part in (part for part in node.each if not part.is_null):
        if part.text is None:
            hint = f"; write {part.written!r} with quotes" if part.written else f", found {shown(part)}"
            raise part.wrong(f"expected names and types such as '?r - robot ?to - place'{hint}")
        pairs += _typed(part.text, part, scope)
    return pairs


def _typed(text: str, node: Node, scope: FormulaScope) -> list[tuple[str, tuple[str, ...]]]:
    tokens: deque[str] = deque(_TOKEN.findall(text))
    pairs: list[tuple[str, tuple[str, ...]]] = []
    waiting: list[str] = []
    while tokens:
        token = tokens.popleft()
        if token == "-" and waiting:
            types = _types(tokens, node)
            for kind in types:
                scope.check_type(kind, node)
            pairs += [(name, types) for name in waiting]
            waiting = []
        elif token in ("-", "(", ")", "?"):
            raise node.wrong(f"expected a name in place of {token!r} in {shown(node)}")
        else:
            waiting.append(token)
    return [*pairs, *((name, ("object",)) for name in waiting)]


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
    """Return the text at this position, in few words, for errors."""
    if node.text is not None:
        return repr(node.text if len(node.text) < 60 else f"{node.text[:59]}…")
    return "a mapping" if node.is_mapping else "a list" if node.items is not None else node.written or "nothing"
