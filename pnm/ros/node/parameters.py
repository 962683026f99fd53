"""Parameters of a ROS 2 node: declared once with a description; command line, launch file and parameter services show and set them.

They are set when the node starts, and read-only from then on.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from sys import float_info
from typing import Any, Final, TypeAlias

from pnm.errors import InputError, suggestion
from pnm.files.database.place import without_password

ParameterValue: TypeAlias = bool | int | float | str
_OF_ROS: Final = "qos_overrides."
"""The prefixes of parameters that a node declares when it makes their subjects."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NodeParameter:
    """One parameter; its type is that of its default."""

    name: str
    """As ROS 2 has it; the option of a command line has ``-`` for ``_``."""
    default: ParameterValue
    """An empty text stands for no value."""
    description: str
    least: float = 0
    choices: tuple[str, ...] = ()
    """The valid texts; empty if all are."""
    option: str = ""
    """The name of the command line's option, if it differs."""


def parameter(default: ParameterValue, description: str, **more: Any) -> Any:
    """Return a field for the value of a parameter, with what `NodeParameter` says of it besides its name."""
    return field(metadata={"default": default, "description": description, **more})


def declare(node: Any, parameters: Iterable[NodeParameter], given: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Declare read-only parameters, and return their values; only on the ROS thread.

    What is `given` overrides ROS arguments and the files that they name, and these override the defaults. There is a warning about
    parameters in them that the node does not have: files for several nodes may have some. Raises `InputError` if a value has the wrong
    type, is too small, or is none of the choices.
    """
    values: dict[str, ParameterValue] = {}
    # of ROS arguments and of the files that they name; `rclpy` has no other way to them
    overrides: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})
    for parameter in parameters:
        name, default = parameter.name, parameter.default
        try:
            descriptor, ignore = _descriptor(parameter), name in given
            secret = given[name] if ignore else getattr(overrides.get(name), "value", None)
            if isinstance(secret, str) and (shown := without_password(secret)) != secret:  # every node may read parameters
                node.declare_parameter(name, shown, descriptor, ignore_override=True)
                value: Any = secret
            else:
                value = node.declare_parameter(name, given.get(name, default), descriptor, ignore_override=ignore).value
        except Exception as error:
            hint = "; expected a number such as 10.0" if isinstance(default, float) else ""
            raise InputError(f"the parameter {name} is wrong: {str(error) or type(error).__name__}{hint}") from error
        if parameter.choices and value not in (parameter.default, *parameter.choices):
            hint = suggestion(str(value), parameter.choices)
            expected = f"expected one of {', '.join(parameter.choices)}{f'; {hint}' if hint else ''}"
            raise InputError(f"the parameter {name} is {value!r}; {expected}")
        values[name] = value
    for name in sorted(overrides):
        if not node.has_parameter(name) and not name.startswith(_OF_ROS):
            hint = suggestion(name, values) or "`ros2 param list` or `pnm serve --help` show which there are"
            _log.warning("there is no parameter %s; it is ignored; %s", name, hint)
    return values


def _descriptor(parameter: NodeParameter) -> Any:
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor  # here: `pnm serve --help` needs no ROS

    descriptor = ParameterDescriptor(description=parameter.description, read_only=True)
    if parameter.choices:
        descriptor.additional_constraints = f"one of {', '.join(parameter.choices)}"
    if isinstance(parameter.default, float):
        limits = FloatingPointRange(from_value=float(parameter.least), to_value=float_info.max, step=0.0)
        descriptor.floating_point_range = [limits]
    elif isinstance(parameter.default, int) and not isinstance(parameter.default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(parameter.least), to_value=2**31 - 1, step=0)]
    return descriptor
