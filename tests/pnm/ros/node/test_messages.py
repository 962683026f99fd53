"""Values in, messages out, and back: every kind of field, and every way a value can be wrong."""

from __future__ import annotations

import array
import json
import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from test_msgs import msg
from test_msgs.action import Fibonacci, NestedMessage

from pnm.errors import InputError
from pnm.ros.node.messages import FieldError, import_type, to_data, to_message


def over_the_wire(message):
    """Return the message as the other side gets it."""
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize(
    "kind",
    [
        msg.Arrays,
        msg.BasicTypes,
        msg.BoundedSequences,
        msg.Builtins,
        msg.Constants,
        msg.Defaults,
        msg.Empty,
        msg.MultiNested,
        msg.Nested,
        msg.Strings,
        msg.UnboundedSequences,
        msg.WStrings,
        NestedMessage.Goal,
    ],
)
def test_defaults_go_through_plain_data_and_over_the_wire(kind):
    data = to_data(kind())
    assert json.loads(json.dumps(data)) == data
    assert to_data(over_the_wire(to_message(kind, data))) == data


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        (msg.BasicTypes, {"float64_value": 1, "float32_value": -0.5, "int8_value": -128, "uint64_value": 2**64 - 1, "byte_value": 255}),
        (msg.BasicTypes, {"bool_value": True, "int32_value": 80.0, "char_value": 65}),
        (msg.Strings, {"string_value": "größer", "bounded_string_value": "x" * 22}),
        (msg.WStrings, {"wstring_value": "größer 🤖", "array_of_wstrings": ["a", "", "c"]}),
        (
            msg.Arrays,
            {"int16_values": [1, -2, 3], "bool_values": [True, False, True], "byte_values": [0, 1, 255], "float32_values": [0, 1, 2]},
        ),
        (msg.BoundedSequences, {"uint8_values": [1, 2], "string_values": [], "basic_types_values": [{"int32_value": 7}]}),
        (msg.UnboundedSequences, {"float64_values": [0.1, 2], "byte_values": [9], "int64_values": [-(2**63)], "bool_values": [True]}),
    ],
)
def test_values_arrive(kind, data):
    arrived = to_data(over_the_wire(to_message(kind, data)))
    for name, value in data.items():
        if name != "basic_types_values":
            assert arrived[name] == value
        else:
            assert arrived[name][0]["int32_value"] == 7


def test_numpy_arrays_and_bytes_do_for_lists():
    data = {
        "float64_values": np.array([1.5, 2.5]),
        "int32_values": array.array("i", [3]),
        "uint8_values": b"\x01\x02",
        "byte_values": b"\x03",
    }
    message = over_the_wire(to_message(msg.UnboundedSequences, data))
    assert to_data(message)["float64_values"] == [1.5, 2.5]
    assert to_data(message)["int32_values"] == [3]
    assert to_data(message)["uint8_values"] == [1, 2]
    assert to_data(message)["byte_values"] == [3]
    assert to_message(msg.BasicTypes, {"int32_value": np.int64(5), "bool_value": np.bool_(True)}).int32_value == 5


@pytest.mark.parametrize(("seconds", "sec", "nanosec"), [(2, 2, 0), (1.5, 1, 500_000_000), (-0.25, -1, 750_000_000), (0.9999999999, 1, 0)])
def test_seconds_do_for_a_time(seconds, sec, nanosec):
    message = to_message(msg.Builtins, {"time_value": seconds, "duration_value": {"sec": 3}})
    assert message.time_value == Time(sec=sec, nanosec=nanosec)
    assert to_data(message)["duration_value"] == {"sec": 3, "nanosec": 0}


def test_nan_and_infinity_are_floats():
    message = over_the_wire(to_message(msg.BasicTypes, {"float64_value": math.nan, "float32_value": math.inf}))
    assert math.isnan(message.float64_value)
    assert message.float32_value == math.inf


@pytest.mark.parametrize(
    ("kind", "data", "path", "needs", "got"),
    [
        (msg.BasicTypes, {"int32_value": "3"}, "int32_value", "int32 (-2147483648 to 2147483647)", "'3' (str)"),
        (msg.BasicTypes, {"int32_value": 1.5}, "int32_value", "int32 (-2147483648 to 2147483647)", "1.5 (float)"),
        (msg.BasicTypes, {"int32_value": math.nan}, "int32_value", "int32 (-2147483648 to 2147483647)", "nan (float)"),
        (msg.BasicTypes, {"int32_value": math.inf}, "int32_value", "int32 (-2147483648 to 2147483647)", "inf (float)"),
        (msg.BasicTypes, {"int32_value": True}, "int32_value", "int32 (-2147483648 to 2147483647)", "True (bool)"),
        (msg.BasicTypes, {"uint8_value": -1}, "uint8_value", "uint8 (0 to 255)", "-1 (int)"),
        (msg.BasicTypes, {"uint8_value": 256}, "uint8_value", "uint8 (0 to 255)", "256 (int)"),
        (msg.BasicTypes, {"byte_value": 256}, "byte_value", "byte (0 to 255)", "256 (int)"),
        (msg.BasicTypes, {"bool_value": 1}, "bool_value", "bool", "1 (int)"),
        (msg.BasicTypes, {"float64_value": "1.0"}, "float64_value", "float64", "'1.0' (str)"),
        (msg.BasicTypes, {"float64_value": None}, "float64_value", "float64", "nothing"),
        (msg.BasicTypes, {"float64_value": True}, "float64_value", "float64", "True (bool)"),
        (msg.BasicTypes, {"float64_value": 10**400}, "float64_value", "float64", f"1{'0' * 56}... (int)"),
        (msg.BasicTypes, {"float32_value": 1e39}, "float32_value", "float32", "1e+39 (float)"),
        (msg.Strings, {"string_value": 3}, "string_value", "string", "3 (int)"),
        (msg.Strings, {"string_value": "a\0b"}, "string_value", "text that can be sent", r"'a\x00b' (str)"),
        (msg.Strings, {"string_value": "\ud800"}, "string_value", "text that can be sent", r"'\ud800' (str)"),
        (msg.Strings, {"bounded_string_value": "x" * 23}, "bounded_string_value", "text of at most 22 characters", "23 of them"),
        (msg.Arrays, {"int8_values": [1, 2]}, "int8_values", "exactly 3 values of type int8", "2 of them"),
        (msg.BoundedSequences, {"int8_values": [1] * 4}, "int8_values", "at most 3 values of type int8", "4 of them"),
        (msg.BoundedSequences, {"int8_values": [1, 200]}, "int8_values[1]", "int8 (-128 to 127)", "200 (int)"),
        (msg.UnboundedSequences, {"string_values": "abc"}, "string_values", "a list of values of type string", "'abc' (str)"),
        (msg.UnboundedSequences, {"bool_values": 1}, "bool_values", "a list of values of type bool", "1 (int)"),
        (msg.Nested, {"basic_types_value": "kitchen"}, "basic_types_value", "the fields of a test_msgs/BasicTypes", "'kitchen' (str)"),
        (msg.Nested, {"basic_types_value": {"int8_value": 128}}, "basic_types_value.int8_value", "int8 (-128 to 127)", "128 (int)"),
        (msg.Builtins, {"time_value": math.nan}, "time_value", "the seconds of a builtin_interfaces/Time", "nan (float)"),
        (msg.Builtins, {"time_value": 1e10}, "time_value.sec", "int32 (-2147483648 to 2147483647)", "10000000000 (int)"),
    ],
)
def test_what_does_not_fit_is_refused_with_path_need_and_value(kind, data, path, needs, got):
    with pytest.raises(FieldError) as caught:
        to_message(kind, data)
    assert (caught.value.path, caught.value.needs, caught.value.got) == (path, needs, got)
    assert f"field {path} needs {needs}, got {got}" in str(caught.value)


def test_text_for_a_number_comes_with_advice():
    with pytest.raises(FieldError, match=r"got 'kitchen' \(str\); add a goal mapping to the binding$"):
        to_message(Fibonacci.Goal, {"order": "kitchen"})


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        (Fibonacci.Goal, "ordr", "field ordr needs to be one of order, got a field that Fibonacci_Goal does not have; order?"),
        (msg.Empty, "x", "field x needs to be left out: the message has no fields"),
    ],
)
def test_an_unknown_field_is_refused_with_those_there_are(kind, name, said):
    with pytest.raises(FieldError) as caught:
        to_message(kind, {name: 1})
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nav2_msgs/action/NoSuch", "nav2_msgs/action/NoSuch is not installed; install the ROS package nav2_msgs"),
        ("test_msgs/action/NoSuch", "test_msgs/action/NoSuch is not installed"),
        ("pnm_interfaces/action/NoSuch", "`pip install ./ros/pnm_interfaces`"),
        ("test_msgs/Fibonacci", "not a ROS type: 'test_msgs/Fibonacci'; expected something like nav2_msgs/action/NavigateToPose"),
        ("os/path/join", "not a ROS type"),
    ],
)
def test_a_type_that_is_not_there_is_refused(name, said):
    with pytest.raises(InputError) as caught:
        import_type(name)
    assert said in str(caught.value)
