"""PDDL actions, instantaneous and durative: from their sections to `ActionSchema`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from planner_bridge.model import ActionSchema
from planner_bridge.pddl.conditions import Reader
from planner_bridge.pddl.declarations import Once
from planner_bridge.pddl.durative import duration, timed_conditions, timed_effects
from planner_bridge.pddl.names import Names, new_name
from planner_bridge.pddl.sections import keyed
from planner_bridge.pddl.sexpr import Group, Node, wrong
from pnm.expressions import Variable

INSTANTANEOUS: Final = ":action"
DURATIVE: Final = ":durative-action"
_EMPTY: Final[tuple[Node, ...]] = ()


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
    parts = keyed(section.rest[1:], f"the action {name!r}", (":parameters", ":precondition", ":effect"))
    parameters = _parameters(parts.get(":parameters"), names)
    reader = Reader(names).inside(parameters)
    nothing = Group(_EMPTY, section.offset, section.source)
    return ActionSchema(
        name,
        parameters,
        precondition=reader.condition(parts.get(":precondition", nothing)),
        end_effects=reader.effects(parts.get(":effect", nothing)),
    )


def _durative(name: str, section: Group, names: Names) -> ActionSchema:
    parts = keyed(section.rest[1:], f"the durative action {name!r}", (":parameters", ":duration", ":condition", ":effect"))
    if ":duration" not in parts:
        raise wrong(section, f"the durative action {name!r} has no :duration; expected :duration (= ?duration ...), or () for any")
    parameters = _parameters(parts.get(":parameters"), names)
    bare = Reader(names).inside(parameters)
    reader = bare.timed()
    nothing = Group(_EMPTY, section.offset, section.source)
    conditions = timed_conditions(parts.get(":condition", nothing), reader)
    effects = timed_effects(parts.get(":effect", nothing), reader)
    return ActionSchema(
        name,
        parameters,
        precondition=conditions["at start"],
        invariant=conditions["over all"],
        end_condition=conditions["at end"],
        start_effects=effects["at start"],
        end_effects=effects["at end"],
        duration=duration(parts[":duration"], bare),
    )


def _parameters(node: Node | None, names: Names) -> tuple[Variable, ...]:
    if node is None:
        return ()
    if not isinstance(node, Group):
        raise wrong(node, f"expected the parameters in parentheses, found {node}")
    return names.variables(node.items)
