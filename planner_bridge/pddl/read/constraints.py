"""PDDL preferences, split from the hard part of a condition, and trajectory constraints (PDDL 3.0)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeVar

from planner_bridge.pddl.read.formulas import condition
from planner_bridge.pddl.read.requirements import Leniency
from planner_bridge.pddl.read.symbols import CONSTRAINTS
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, wrong
from planner_bridge.pddl.syntax.words import TimeSpecifier, new_name, time
from pnm.core.logic.conditions import Condition, ForAll, conjunction
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import Constraint
from pnm.errors import counted

T = TypeVar("T")


def is_preference(node: Node, scope: TermScope) -> bool:
    """Whether the part is a preference, and no predicate of that name."""
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
    return [replace(preference, variables=(*variables, *preference.variables)) for preference in preferences]


def split_preferences(node: Node, scope: TermScope, moment: TimeSpecifier | None = None) -> tuple[Condition, tuple[Preference, ...]]:
    """Read a condition: return its hard part, and its preferences, at the moment of a durative action if one is given."""
    hard, soft = _split(node, scope)
    return conjunction(hard), tuple([replace(preference, moment=moment) for preference in soft] if moment else soft)


def _split(node: Node, scope: TermScope) -> tuple[list[Condition], list[Preference]]:
    match node:
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: condition(body, scope))
            return [], [Preference(name, wanted)]
        case Group() if node.head == "and":
            return _joined(_split(part, scope) for part in node.rest)
        case Group() if node.head == "forall" and _has_preferences(node):
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _split(body, scope.inside(variables))
            return [ForAll(variables, conjunction(hard))] if hard else [], with_variables(variables, soft)
        case _:
            return [condition(node, scope)], []


def _has_preferences(node: Group) -> bool:
    return any(isinstance(part, Group) and (part.head == "preference" or _has_preferences(part)) for part in node.rest)


def _joined(parts: Iterable[tuple[list[T], list[Preference]]]) -> tuple[list[T], list[Preference]]:
    both = list(parts)
    return [part for hard, _ in both for part in hard], [preference for _, soft in both for preference in soft]


def constraints(parts: tuple[Node, ...], scope: TermScope) -> tuple[tuple[Constraint, ...], tuple[Preference, ...]]:
    """Read ``(:constraints ...)``: return the hard constraints, and the preferences over constraints."""
    if len(parts) > 1:
        Leniency.SEVERAL_CONSTRAINTS.note(parts[1])
    hard, soft = _joined(_constraints(part, scope) for part in parts)
    return tuple(hard), tuple(soft)


def _constraints(node: Node, scope: TermScope) -> tuple[list[Constraint], list[Preference]]:
    scope.symbols.requirements.need(node, ":constraints")
    match node:
        case Group(items=()):
            return [], []
        case Group() if node.head == "and":
            return _joined(_constraints(part, scope) for part in node.rest)
        case Group() if node.head == "forall":
            variables, body = scope.quantified(node)
            hard, soft = _constraints(body, scope.inside(variables))
            return [replace(part, variables=(*variables, *part.variables)) for part in hard], with_variables(variables, soft)
        case Group() if is_preference(node, scope):
            name, (hard, soft) = preference(node, scope, lambda body: _constraints(body, scope))
            if soft:
                raise wrong(node.rest[-1], "a preference cannot stand inside another")
            return [], [Preference(name, tuple(hard))]
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "end"):
            return [Constraint("at end", (condition(body, scope),))], []
        case Group() if node.head in CONSTRAINTS:
            times, conditions = CONSTRAINTS[node.head]
            if len(node.rest) != times + conditions:
                form = " and ".join([*([counted(times, "time")] if times else []), counted(conditions, "condition")])
                raise wrong(node, f"'{node.head}' takes {form}, found {counted(len(node.rest), 'part')}")
            wanted = tuple([condition(part, scope) for part in node.rest[times:]])
            return [Constraint(node.head, wanted, tuple([time(part) for part in node.rest[:times]]))], []
        case _:
            raise wrong(node, f"expected and, forall, preference, at end, {', '.join(CONSTRAINTS)}; found {node}")
