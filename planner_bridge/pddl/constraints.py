"""PDDL trajectory constraints, and preferences over them (PDDL 3.0)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeAlias

from planner_bridge.model import Preference
from planner_bridge.pddl.conditions import condition
from planner_bridge.pddl.names import CONSTRAINTS
from planner_bridge.pddl.preferences import is_preference, preference, under
from planner_bridge.pddl.scope import Scope
from planner_bridge.pddl.sexpr import Atom, Group, Node, tolerate, wrong
from planner_bridge.pddl.words import counted, time
from pnm.trajectory import Constraint

_Found: TypeAlias = tuple[list[Constraint], list[Preference]]


def constraints(parts: tuple[Node, ...], scope: Scope) -> tuple[tuple[Constraint, ...], tuple[Preference, ...]]:
    """Read what stands in ``(:constraints ...)``: what must be kept, and what should."""
    if len(parts) > 1:
        tolerate(parts[1], "several constraints without 'and' around them; all of them count")
    hard, soft = _merged(_read(part, scope) for part in parts)
    return tuple(hard), tuple(soft)


def _read(node: Node, scope: Scope) -> _Found:
    scope.names.requirements.need(node, ":constraints")
    match node:
        case Group(items=()):
            return [], []
        case Group() if node.head == "and":
            return _merged(_read(part, scope) for part in node.rest)
        case Group() if node.head == "forall":
            variables, body = scope.quantified(node)
            hard, soft = _read(body, scope.inside(variables))
            return [replace(one, variables=(*variables, *one.variables)) for one in hard], under(variables, soft)
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: _wanted(body, scope))
            return [], [Preference(name, wanted)]
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "end"):
            return [Constraint("at end", (condition(body, scope),))], []
        case Group() if node.head in CONSTRAINTS:
            return [_constraint(node, scope)], []
        case _:
            raise wrong(node, f"expected and, forall, preference, at end, {', '.join(CONSTRAINTS)}; found {node}")


def _wanted(node: Node, scope: Scope) -> tuple[Constraint, ...]:
    hard, soft = _read(node, scope)
    if soft:
        raise wrong(node, "a preference cannot stand inside another")
    return tuple(hard)


def _constraint(node: Group, scope: Scope) -> Constraint:
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
