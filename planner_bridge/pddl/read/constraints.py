"""PDDL trajectory constraints, and preferences over them (PDDL 3.0).

PDDL preferences: told apart from what must hold in a goal or a precondition (PDDL 3.0).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal, TypeAlias, TypeVar

from planner_bridge.model.problem import Preference
from planner_bridge.pddl.read.formulas import condition
from planner_bridge.pddl.read.symbols import CONSTRAINTS
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import counted, new_name, time
from pnm.core.logic.conditions import Condition, ForAll, conjunction
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import Constraint

T = TypeVar("T")


def is_preference(node: Node, scope: TermScope) -> bool:
    """Tell whether the part is a preference, and no predicate of that name."""
    return isinstance(node, Group) and node.head == "preference" and not scope.symbols.has_predicate("preference")


def preference(node: Group, scope: TermScope, read: Callable[[Node], T]) -> tuple[str, T]:
    """Read ``(preference NAME BODY)``, or ``(preference BODY)``: return the name, empty without one, and the body."""
    scope.symbols.requirements.need(node, ":preferences")
    match node.rest:
        case (Atom() as word, body):
            name = new_name(word, "preference")
            return scope.symbols.preference_names.setdefault(name.lower(), name), read(body)
        case (Group() as body,):
            return "", read(body)
        case _:
            raise wrong(node, f"expected (preference NAME CONDITION), found {counted(len(node.rest), 'part')}")


def with_variables(variables: tuple[Variable, ...], preferences: Iterable[Preference]) -> list[Preference]:
    """Return the preferences, each with the variables of a quantifier around it."""
    return [replace(one, variables=(*variables, *one.variables)) for one in preferences]


def split_preferences(
    node: Node, scope: TermScope, moment: Literal["at start", "over all", "at end"] | None = None
) -> tuple[Condition, tuple[Preference, ...]]:
    """Return what must hold, and what should."""
    hard, soft = _parts(node, scope)
    return conjunction(hard), tuple([replace(one, moment=moment) for one in soft] if moment else soft)


def _parts(node: Node, scope: TermScope) -> tuple[list[Condition], list[Preference]]:
    match node:
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: condition(body, scope))
            return [], [Preference(name, wanted)]
        case Group() if node.head == "and":
            both = [_parts(part, scope) for part in node.rest]
            return [one for hard, _ in both for one in hard], [one for _, soft in both for one in soft]
        case Group() if node.head == "forall" and _mentions(node):
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _parts(body, scope.inside(variables))
            return [ForAll(variables, conjunction(hard))] if hard else [], with_variables(variables, soft)
        case _:
            return [condition(node, scope)], []


def _mentions(node: Group) -> bool:
    return any(isinstance(part, Group) and (part.head == "preference" or _mentions(part)) for part in node.rest)


_Found: TypeAlias = tuple[list[Constraint], list[Preference]]


def constraints(parts: tuple[Node, ...], scope: TermScope) -> tuple[tuple[Constraint, ...], tuple[Preference, ...]]:
    """Read what stands in ``(:constraints ...)``: what must be kept, and what should."""
    if len(parts) > 1:
        tolerate(parts[1], "several constraints without 'and' around them; all of them count")
    hard, soft = _merged(_read(part, scope) for part in parts)
    return tuple(hard), tuple(soft)


def _read(node: Node, scope: TermScope) -> _Found:
    scope.symbols.requirements.need(node, ":constraints")
    match node:
        case Group(items=()):
            return [], []
        case Group() if node.head == "and":
            return _merged(_read(part, scope) for part in node.rest)
        case Group() if node.head == "forall":
            variables, body = scope.quantified(node)
            hard, soft = _read(body, scope.inside(variables))
            return [replace(one, variables=(*variables, *one.variables)) for one in hard], with_variables(variables, soft)
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: _wanted(body, scope))
            return [], [Preference(name, wanted)]
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "end"):
            return [Constraint("at end", (condition(body, scope),))], []
        case Group() if node.head in CONSTRAINTS:
            return [_constraint(node, scope)], []
        case _:
            raise wrong(node, f"expected and, forall, preference, at end, {', '.join(CONSTRAINTS)}; found {node}")


def _wanted(node: Node, scope: TermScope) -> tuple[Constraint, ...]:
    hard, soft = _read(node, scope)
    if soft:
        raise wrong(node, "a preference cannot stand inside another")
    return tuple(hard)


def _constraint(node: Group, scope: TermScope) -> Constraint:
    times, conditions = CONSTRAINTS[node.head]
    if len(node.rest) != times + conditions:
        form = " and ".join([*([counted(times, "time")] if times else []), counted(conditions, "condition")])
        raise wrong(node, f"'{node.head}' takes {form}, found {counted(len(node.rest), 'part')}")
    return Constraint(
        node.head,
        tuple([condition(part, scope) for part in node.rest[times:]]),
        tuple([time(part) for part in node.rest[:times]]),
    )


def _merged(found: Iterable[_Found]) -> _Found:
    both = list(found)
    return [one for hard, _ in both for one in hard], [one for _, soft in both for one in soft]
