"""Parameters of a node: declared once with a description, given when it starts, read by anybody.

Parameters of a program, as command lines, launch files and parameter services give and show them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from sys import float_info
from typing import Any, TypeAlias

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from pnm.errors import InputError, suggestion

ParameterValue: TypeAlias = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter; its type is that of its default.

    Args:
        name: as ROS 2 has it; the option of a command line has ``-`` for ``_``.
        default: an empty text stands for nothing.
        description: for people.
        least: the smallest number that makes sense.
        choices: the texts that make sense, when not all do.
        option: the name of the option, when it is another one.
    """

    name: str
    default: ParameterValue
    description: str
    least: float = 0
    choices: tuple[str, ...] = ()
    option: str = ""


def declare(node: Any, parameters: Iterable[Parameter], given: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Declare parameters that cannot be changed any more, and return their values; only on the ROS thread.

    What ROS says about a parameter counts before what is given here, and that before its default.

    Raises:
        InputError: a value is of the wrong type, or makes no sense.
    """
    values: dict[str, ParameterValue] = {}
    for one in parameters:
        try:
            values[one.name] = node.declare_parameter(one.name, given.get(one.name, one.default), _descriptor(one)).value
        except Exception as error:
            hint = "; expected a number such as 10.0" if isinstance(one.default, float) else ""
            raise InputError(f"the parameter {one.name} is wrong: {str(error) or type(error).__name__}{hint}") from error
        if one.choices and values[one.name] not in one.choices:
            hint = suggestion(str(values[one.name]), one.choices)
            expected = f"expected one of {', '.join(one.choices)}{f'; {hint}' if hint else ''}"
            raise InputError(f"the parameter {one.name} is {values[one.name]!r}; {expected}")
    return values


def _descriptor(parameter: Parameter) -> Any:
    found = ParameterDescriptor(description=parameter.description, read_only=True)
    if parameter.choices:
        found.additional_constraints = f"one of {', '.join(parameter.choices)}"
    match parameter.default:
        case bool() | str():
            pass
        case int():
            found.integer_range = [IntegerRange(from_value=int(parameter.least), to_value=2**31 - 1, step=0)]
        case float():
            found.floating_point_range = [FloatingPointRange(from_value=float(parameter.least), to_value=float_info.max, step=0.0)]
    return found
