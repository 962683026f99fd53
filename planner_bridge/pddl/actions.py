"""PDDL actions, instantaneous and durative: from their sections to `ActionSchema`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from planner_bridge.model import ActionSchema
from planner_bridge.pddl.declarations import Once
from planner_bridge.pddl.durative import duration, timed_conditions, timed_effects
from planner_bridge.pddl.effects import effects
from planner_bridge.pddl.names import Names
from planner_bridge.pddl.preferences import told_apart
from planner_bridge.pddl.scope import Scope
from planner_bridge.pddl.sections import keyed
from planner_bridge.pddl.sexpr import Group, Node, tolerate, wrong
from planner_bridge.pddl.words import new_name
from pnm.expressions import Variable

INSTANTANEOUS: Final = ":action"
DURATIVE: Final = ":durative-action"
_EMPTY: Final[tuple[Node, ...]] = ()
_VARS: Final = ":vars"
"""Of an early PDDL: variables that are no parameters, but have to be chosen just the same."""


def actions(sections: Iterable[Group], names: Names) -> dict[str, ActionSchema]:
    """Read the actions in the order of the file."""
    once = Once("action")
    found: dict[str, ActionSchema] = {}
    for section in sections:
        if not section.rest:
            raise wrong(section, f"expected a name after '{section.head}', found nothing")
        name = new_name(section.rest[0], "action")
        once.check(name, section)
        found[name] = (_durative if section.head == DURATIVE else _instantaneous)(name, section, names)
    return found


def _instantaneous(name: str, section: Group, names: Names) -> ActionSchema:
    parts = keyed(section.rest[1:], f"the action {name!r}", (":parameters", ":precondition", ":effect", _VARS))
    parameters = _parameters(parts, names)
    scope = Scope(names).inside(parameters)
    nothing = Group(_EMPTY, section.offset, section.source)
    precondition, preferences = told_apart(parts.get(":precondition", nothing), scope)
    return ActionSchema(
        name,
        parameters,
        precondition=precondition,
        end_effects=effects(parts.get(":effect", nothing), scope),
        preferences=preferences,
    )


def _durative(name: str, section: Group, names: Names) -> ActionSchema:
    names.requirements.need(section, ":durative-actions")
    parts = keyed(section.rest[1:], f"the durative action {name!r}", (":parameters", ":duration", ":condition", ":effect", _VARS))
    if ":duration" not in parts:
        raise wrong(section, f"the durative action {name!r} has no :duration; expected :duration (= ?duration ...), or () for any")
    parameters = _parameters(parts, names)
    bare = Scope(names).inside(parameters)
    timed = Scope(names, bare.variables, duration=True)
    nothing = Group(_EMPTY, section.offset, section.source)
    conditions, preferences = timed_conditions(parts.get(":condition", nothing), timed)
    changes = timed_effects(parts.get(":effect", nothing), timed)
    return ActionSchema(
        name,
        parameters,
        precondition=conditions["at start"],
        invariant=conditions["over all"],
        end_condition=conditions["at end"],
        start_effects=changes["at start"],
        end_effects=changes["at end"],
        duration=duration(parts[":duration"], bare),
        preferences=preferences,
    )


def _parameters(parts: dict[str, Node], names: Names) -> tuple[Variable, ...]:
    words: list[Node] = []
    for key in (":parameters", _VARS):
        node = parts.get(key)
        if node is None:
            continue
        if not isinstance(node, Group):
            raise wrong(node, f"expected the parameters in parentheses, found {node}")
        if key == _VARS:
            tolerate(node, "the variables of :vars are read as further parameters")
        words.extend(node.items)
    return names.variables(words)
