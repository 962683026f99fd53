"""Grounding: an action schema and values for its parameters make a ground action."""

from __future__ import annotations

from pnm.core.logic.conditions import ground
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import ground_effects
from pnm.core.logic.expressions import DURATION, Environment
from pnm.core.machine.plan_graph import GroundAction


def ground_schema(schema: ActionSchema, arguments: tuple[str, ...], env: Environment, duration: float | None = None) -> GroundAction:
    """Substitute values for the parameters of a schema.

    Args:
        schema: the action.
        arguments: how the values are written, in the order of the parameters.
        env: the values, by parameter with ``?``; a parameter without one stays.
        duration: the planned one, in seconds.
    """
    if duration is not None:
        env = {**env, DURATION[0]: duration}
    return GroundAction(
        name=schema.name,
        arguments=arguments,
        parameters=tuple(variable.name[1:] for variable in schema.parameters),
        precondition=ground(schema.precondition, env),
        invariant=ground(schema.invariant, env),
        end_condition=ground(schema.end_condition, env),
        start_effects=ground_effects(schema.start_effects, env),
        end_effects=ground_effects(schema.end_effects, env),
        duration=duration,
        expected=ground(schema.expected, env),
    )
