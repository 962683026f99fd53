"""PDDL preferences: told apart from what must hold in a goal or a precondition (PDDL 3.0)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal, TypeVar

from planner_bridge.model import Preference
from planner_bridge.pddl.conditions import condition
from planner_bridge.pddl.scope import Scope
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from planner_bridge.pddl.words import counted, new_name
from pnm.conditions import Condition, ForAll, conjunction
from pnm.expressions import Variable

T = TypeVar("T")


def is_preference(node: Node, scope: Scope) -> bool:
    """Tell whether the part is a preference, and no predicate of that name."""
    return isinstance(node, Group) and node.head == "preference" and not scope.names.has_predicate("preference")


def preference(node: Group, scope: Scope, read: Callable[[Node], T]) -> tuple[str, T]:
    """Read ``(preference NAME BODY)``, or ``(preference BODY)``: return the name, empty without one, and the body."""
    scope.names.requirements.need(node, ":preferences")
    match node.rest:
        case (Atom() as word, body):
            name = new_name(word, "preference")
            return scope.names.wishes.setdefault(name.lower(), name), read(body)
        case (Group() as body,):
            return "", read(body)
        case _:
            raise wrong(node, f"expected (preference NAME CONDITION), found {counted(len(node.rest), 'part')}")


def under(variables: tuple[Variable, ...], preferences: Iterable[Preference]) -> list[Preference]:
    """Return the preferences, each with the variables of a quantifier around it."""
    return [replace(one, variables=(*variables, *one.variables)) for one in preferences]


def told_apart(
    node: Node, scope: Scope, moment: Literal["at start", "over all", "at end"] | None = None
) -> tuple[Condition, tuple[Preference, ...]]:
    """Return what must hold, and what should."""
    hard, soft = _parts(node, scope)
    return conjunction(hard), tuple([replace(one, moment=moment) for one in soft] if moment else soft)


def _parts(node: Node, scope: Scope) -> tuple[list[Condition], list[Preference]]:
    match node:
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: condition(body, scope))
            return [], [Preference(name, wanted)]
        case Group() if node.head == "and":
            both = [_parts(part, scope) for part in node.rest]
            return [one for hard, _ in both for one in hard], [one for _, soft in both for one in soft]
        case Group() if node.head == "forall" and _mentions(node):
            scope.names.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _parts(body, scope.inside(variables))
            return [ForAll(variables, conjunction(hard))] if hard else [], under(variables, soft)
        case _:
            return [condition(node, scope)], []


def _mentions(node: Group) -> bool:
    return any(isinstance(part, Group) and (part.head == "preference" or _mentions(part)) for part in node.rest)
