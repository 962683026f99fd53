"""Conversion between ROS 2 messages and plain data; every value is checked before it becomes part of a message.

`rclpy` checks nothing by default and sends garbage: the int 1 in a float64 field arrives as 5e-324, -1 in an unsigned
one ends in a ``SystemError``. Its own checks (ROS_PYTHON_CHECK_FIELDS=1) are no alternative: they refuse whole numbers
for float fields, name no path, and apply to all other code in the process.

Plain data has the types of JSON: bool, int, float, str, list and dict. A byte is an int from 0 to 255.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Final

from pnm.errors import InputError, PnmError

_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)/(action|msg|srv)/([A-Z][A-Za-z0-9]*)")
_ARRAY: Final = re.compile(r"(.+)\[(\d+)\]")
_SEQUENCE: Final = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_TEXT: Final = re.compile(r"w?string(?:<(\d+)>)?")
_INTEGER: Final = re.compile(r"(u?)int(8|16|32|64)")
_WRITTEN: Final = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
_SECONDS: Final = frozenset({"builtin_interfaces/Time", "builtin_interfaces/Duration"})
_LARGEST_FLOAT32: Final = 3.4028235677973366e38  # from here on a double rounds to infinity
_ADVICE: Final = "add a goal mapping to the binding"


class FieldError(PnmError):
    """A value does not fit the field of a message; nothing was sent.

    The path is that of the field, such as ``pose.position.x`` or ``poses[2]``.
    """

    def __init__(self, path: str, needs: str, got: str, advice: str = "") -> None:
        super().__init__(f"field {path} needs {needs}, got {got}{f'; {advice}' if advice else ''}")
        self.path = path
        self.needs = needs
        self.got = got


def import_type(name: str) -> Any:
    """Return the class of an interface such as ``nav2_msgs/action/NavigateToPose``.

    Raises `InputError` if this is not the name of a type, or the type is not installed here.
    """
    parts = _TYPE.fullmatch(name)
    if not parts:
        raise InputError(f"not a ROS type: {name!r}; expected something like nav2_msgs/action/NavigateToPose")
    package, kind, interface = parts.groups()
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), interface)
    except (ImportError, AttributeError) as error:
        ours = "`pip install ./ros/pnm_interfaces`"
        advice = ours if package == "pnm_interfaces" else f"install the ROS package {package}, or source its workspace"
        raise InputError(f"the ROS type {name} is not installed; {advice}") from error


def fields(message_type: Any) -> tuple[str, ...]:
    """Return the names of the fields of a message class."""
    return tuple(message_type.get_fields_and_field_types())


def to_message(message_type: Any, data: Mapping[str, object], path: str = "") -> Any:
    """Make a message from values by field name; fields without a value keep their defaults. The path is for errors.

    Whole numbers are accepted for float fields and the other way round (80.0 for an int32), a number of seconds for a Time
    or a Duration. Nothing else is converted: text is never read as a number.
    """
    message = message_type()
    kinds = message_type.get_fields_and_field_types()
    for name, value in data.items():
        inner = f"{path}.{name}" if path else str(name)
        if name not in kinds:
            near = get_close_matches(str(name), kinds, n=1)
            needs = f"to be one of {', '.join(kinds)}" if kinds else "to be left out: the message has no fields"
            raise FieldError(inner, needs, f"a field that {message_type.__name__} does not have", f"{near[0]}?" if near else "")
        setattr(message, name, to_value(kinds[name], value, inner))
    return message


def to_data(message: Any) -> dict[str, object]:
    """Return the fields of a message as plain data."""
    return {name: plain(getattr(message, name)) for name in fields(message)}


def plain(value: Any) -> object:
    """Return the value of a field as plain data."""
    if isinstance(value, bytes):
        return value[0]
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "get_fields_and_field_types"):
        return to_data(value)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def to_value(kind: str, value: object, path: str) -> object:
    """Return the value as `rclpy` stores it in a field of this kind, as ``get_fields_and_field_types`` names it."""
    if hasattr(value, "tolist"):  # numpy arrays and numbers, array.array
        value = value.tolist()
    if array := _ARRAY.fullmatch(kind):
        return _items(array[1], int(array[2]), True, value, path)
    if sequence := _SEQUENCE.fullmatch(kind):
        return _items(sequence[1], int(sequence[2]) if sequence[2] else None, False, value, path)
    if "/" in kind:
        return _nested(kind, value, path)
    if text := _TEXT.fullmatch(kind):
        if not isinstance(value, str):
            raise FieldError(path, kind, _show(value))
        if text[1] and len(value) > int(text[1]):
            raise FieldError(path, f"text of at most {text[1]} characters", f"{len(value)} of them")
        # `rclpy` cuts the text off at a NUL, and fails to send a surrogate.
        if "\0" in value or any("\ud800" <= letter <= "\udfff" for letter in value):
            raise FieldError(path, "text that can be sent", _show(value))
        return value
    return _BASIC.get(kind, _integer)(kind, value, path)


def _items(kind: str, size: int | None, exact: bool, value: object, path: str) -> list[object]:
    what = f"values of type {_WRITTEN.get(kind, kind)}"
    count = "" if size is None else f"exactly {size} " if exact else f"at most {size} "
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise FieldError(path, f"a list of {count}{what}", _show(value), _ADVICE if isinstance(value, str) else "")
    if size is not None and (len(value) != size if exact else len(value) > size):
        raise FieldError(path, f"{count}{what}", f"{len(value)} of them")
    return [to_value(kind, item, f"{path}[{index}]") for index, item in enumerate(value)]


def _nested(kind: str, value: object, path: str) -> object:
    if kind in _SECONDS and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise FieldError(path, f"the seconds of a {kind}", _show(value))
        seconds = math.floor(value)
        nanoseconds = round((value - seconds) * 1e9)
        value = {"sec": seconds + nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    if not isinstance(value, Mapping):
        raise FieldError(path, f"the fields of a {kind}", _show(value), _ADVICE if isinstance(value, str) else "")
    package, _, name = kind.rpartition("/")
    return to_message(import_type(f"{package}/msg/{name}"), value, path)


def _boolean(kind: str, value: object, path: str) -> bool:
    if not isinstance(value, bool):
        raise _wrong(kind, value, path)
    return value


def _float(kind: str, value: object, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(kind, value, path)
    try:
        number = float(value)
    except OverflowError as error:
        raise _wrong(kind, value, path) from error
    if kind == "float" and math.isfinite(number) and abs(number) >= _LARGEST_FLOAT32:
        raise _wrong(kind, value, path)
    return number


def _integer(kind: str, value: object, path: str) -> int:
    integer = _INTEGER.fullmatch(kind)
    if not integer:
        raise FieldError(path, f"to be left out: {kind} fields are not supported", _show(value))
    bits = int(integer[2])
    low, high = (0, 2**bits - 1) if integer[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return _whole(f"{kind} ({low} to {high})", low, high, value, path)


def _octet(kind: str, value: object, path: str) -> bytes:
    if isinstance(value, bytes) and len(value) == 1:
        return value
    return bytes([_whole("byte (0 to 255)", 0, 255, value, path)])


def _whole(needs: str, low: int, high: int, value: object, path: str) -> int:
    if isinstance(value, float) and value.is_integer():  # numbers in PDDL are floats, counts among them
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise _wrong(needs, value, path)
    return value


_BASIC: Final[dict[str, Callable[[str, object, str], object]]] = {"boolean": _boolean, "float": _float, "double": _float, "octet": _octet}


def _wrong(kind: str, value: object, path: str) -> FieldError:
    return FieldError(path, _WRITTEN.get(kind, kind), _show(value), _ADVICE if isinstance(value, str) else "")


def _show(value: object) -> str:
    if value is None:
        return "nothing"
    written = repr(value)
    written = written if len(written) <= 60 else f"{written[:57]}..."
    return f"{written} ({type(value).__name__})"
