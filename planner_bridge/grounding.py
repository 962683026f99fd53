"""An action schema and objects → a ground action of the neutral plan."""

from __future__ import annotations

from planner_bridge.model import ActionSchema
from pnm.conditions import ground
from pnm.effects import ground_effects
from pnm.errors import InputError
from pnm.expressions import DURATION, UNKNOWN, Environment, State, value_of
from pnm.plan_graph import GroundAction


def ground_action(schema: ActionSchema, arguments: tuple[str, ...], duration: float | None = None) -> GroundAction:
    """Substitute the arguments for the parameters; `duration` is the planned one, in seconds.

    Raises:
        InputError: the number of arguments is not that of the parameters.
    """
    if len(arguments) != len(schema.parameters):
        expected = " ".join(variable.name for variable in schema.parameters) or "none"
        raise InputError(f"{schema.name} takes {len(schema.parameters)} arguments ({expected}), found {len(arguments)}")
    env: dict[str, str] = {variable.name: argument for variable, argument in zip(schema.parameters, arguments, strict=True)}
    if duration is not None:
        env[DURATION[0]] = repr(duration)
    return GroundAction(
        name=schema.name,
        arguments=arguments,
        parameters=tuple(variable.name[1:] for variable in schema.parameters),
        precondition=ground(schema.precondition, env),
        invariant=ground(schema.invariant, env),
        end_condition=ground(schema.end_condition, env),
        start_effects=ground_effects(schema.start_effects, env),
        end_effects=ground_effects(schema.end_effects, env),
        duration=duration if schema.duration is not None else None,
    )


def modelled_duration(schema: ActionSchema, arguments: tuple[str, ...], state: State) -> float | None:
    """Return the shortest duration the schema allows in the state; None for an instantaneous action."""
    if schema.duration is None:
        return None
    env: Environment = {variable.name: argument for variable, argument in zip(schema.parameters, arguments, strict=True)}
    bounds = [value_of(one.bound, state, env) for one in schema.duration if one.operation in ("=", ">=")]
    numbers = [float(bound) for bound in bounds if bound is not UNKNOWN and not isinstance(bound, str)]
    return max(numbers, default=0.0)
