"""Parameters of a node: declared once with a description, given when it starts, read by anybody."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from sys import float_info
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from pnm.errors import InputError
from pnm.nearest import meant
from pnm.parameter import Parameter, ParameterValue


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
            hint = meant(str(values[one.name]), one.choices)
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
