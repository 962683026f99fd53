"""Declarations of the YAML language: types, objects, predicates, functions, derived facts, initial facts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent, Value, Variable
from pnm.core.logic.rules import Rule, Rules, UnstratifiedError
from pnm.errors import InputError
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import Scope, read_names, read_typed_text, unknown

_DECLARED: Final = re.compile(r"\(\s*([^\s()?-][^\s()?]*)\s*((?:[^()]|\([^()]*\))*)\)\s*(?:-\s*(\S+|\(\s*either\s[^()]*\)))?\s*\Z")


@dataclass(frozen=True)
class Declared:
    """The names of a domain; without any of a kind, names of that kind are not checked."""

    types: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every type, the types it is directly a kind of."""
    objects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every constant and object, its types."""
    fluents: Mapping[str, tuple[Variable, ...]] = field(default_factory=dict)
    """Predicates and functions with their parameters."""
    predicates: frozenset[str] = frozenset()
    """Which of them are predicates."""
    values: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Of the functions whose values are objects, the types of these."""

    def scope(self, variables: Iterable[Variable] | None = None) -> Scope:
        """Return what a formula may use where these variables are bound; any if None."""
        return Scope(
            variables=None if variables is None else frozenset(variable.name for variable in variables),
            fluents={name: len(parameters) for name, parameters in self.fluents.items()} or None,
            objects=frozenset(self.objects) or None,
            types=frozenset(self.types) or None,
            predicates=self.predicates,
        )

    @cached_property
    def objects_by_type(self) -> dict[str, tuple[str, ...]]:
        """For every type, its objects in the order in which they were declared."""
        found: dict[str, list[str]] = {name: [] for name in ("object", *self.types)}
        for name, types in self.objects.items():
            for one in dict.fromkeys(parent for kind in types for parent in self.supertypes(kind)):
                found.setdefault(one, []).append(name)
        return {kind: tuple(names) for kind, names in found.items()}

    def supertypes(self, name: str) -> tuple[str, ...]:
        """Return the type itself and everything it is a kind of, ``object`` last."""
        found = {name: None}
        waiting = [name]
        while waiting:
            for parent in self.types.get(waiting.pop(), ()):
                if parent not in found:
                    found[parent] = None
                    waiting.append(parent)
        found.pop("object", None)
        return (*found, "object")


NOTHING_DECLARED: Final = Declared()


def read_declared(top: Mapped, problem: Mapped | None) -> Declared:
    """Read ``types``, ``constants``, ``predicates`` and ``functions``, and the ``objects`` of a problem."""
    types = _names(top, "types", Scope())
    types = {**{parent: ("object",) for parents in types.values() for parent in parents if parent != "object"}, **types}
    scope = Scope(types=frozenset(types) or None)
    objects = _names(top, "constants", scope) | (_names(problem, "objects", scope) if problem else {})
    predicates = {name: parameters for name, parameters, _ in _fluents(top, "predicates", scope)}
    functions = [*_fluents(top, "functions", scope)]
    fluents = {**predicates, **{name: parameters for name, parameters, _ in functions}}
    values = {name: kinds for name, _, kinds in functions if kinds not in ((), ("number",))}
    return Declared(types, objects, fluents, frozenset(predicates), values)


def _names(top: Mapped, key: str, scope: Scope) -> dict[str, tuple[str, ...]]:
    node = top.node(key)
    return {} if node is None or node.is_null else read_names(node, scope)


def _fluents(top: Mapped, key: str, scope: Scope) -> Iterator[tuple[str, tuple[Variable, ...], tuple[str, ...]]]:
    """Yield names with their parameters, and with what stands behind them."""
    for item in _items(top.node(key)):
        found = _DECLARED.match(item.text.strip()) if item.text is not None else None
        if found is None:
            raise item.wrong("expected something like (at ?r - robot ?p - place)")
        kinds = (found[3] or "").strip("()").split()
        yield found[1], read_typed_text(found[2], item, scope, distinct=False), tuple(kinds[kinds[:1] == ["either"] :])


def read_derived(top: Mapped, declared: Declared) -> Rules:
    """Read ``derived``: a list of ``{fact: (reachable ?p - place), condition: c}``.

    Raises:
        InputError: it is malformed, or a fact would depend on its own negation.
    """
    rules: list[Rule] = []
    for entry in top.sequence("derived"):
        entry.only("fact", "condition")
        fact, condition = entry.needed("fact"), entry.needed("condition")
        found = _DECLARED.match(fact.text.strip()) if fact.text is not None else None
        if found is None:
            raise fact.wrong("expected something like (reachable ?p - place)")
        variables = read_typed_text(found[2], fact, declared.scope())
        if declared.fluents and found[1] not in declared.fluents:
            raise unknown("predicate", found[1], declared.fluents.keys(), fact.position)
        rules.append(Rule(found[1], variables, read_condition(condition, declared.scope(variables))))
    try:
        return Rules(tuple(rules))
    except UnstratifiedError as error:
        raise InputError(str(error), top.position("derived")) from error


def read_facts(top: Mapped, key: str, scope: Scope) -> dict[Fluent, Value]:
    """Read what is so: a list of texts ``(at r1 hall)``, ``(= (battery r1) 80)``, ``(not (at r1 hall))``.

    Raises:
        InputError: it is something else, or has names that are not there.
    """
    return dict([_statement(item, scope) for item in _items(top.node(key))])


def read_initial(problem: Mapped, scope: Scope) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    """Read ``init``: what is so at the beginning, and, as ``{at: 5, facts: [...]}``, what becomes so by itself after so many seconds.

    Raises:
        InputError: it is something else, or has names that are not there.
    """
    items = _items(problem.node("init"))
    timed: list[TimedChange] = []
    for entry in [item.mapped() for item in items if item.is_mapping]:
        entry.only("at", "facts")
        entry.needed("at")
        timed.append(TimedChange(entry.number("at", 0.0), read_facts(entry, "facts", scope)))
    facts = dict([_statement(item, scope) for item in items if not item.is_mapping])
    return facts, tuple(sorted(timed, key=lambda change: change.time))


def _items(node: Node | None) -> tuple[Node, ...]:
    return () if node is None or node.is_null else (node,) if node.items is None else node.items


def _statement(node: Node, scope: Scope) -> tuple[Fluent, Value]:
    try:
        fluent, value = parse_statement(node.text or "")
    except InputError as error:
        raise node.wrong("expected a fact such as (at r1 kitchen) or (= (battery r1) 80)") from error
    scope.check_fluent(fluent, node.position)
    if isinstance(value, str):
        scope.check_object(value, node.position)
    return fluent, value
