"""Fields of messages, and bindings and sensors against their types: what can never work is refused, constants have their values."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import pytest
from test_msgs.action import Fibonacci, NestedMessage

from pnm.actions.bindings_file import read_bindings
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding
from pnm.core.message_fields import Unreadable, parse_field
from pnm.errors import InputError
from pnm.knowledge.sensor_model import Instance, read
from pnm.ros.node.messages import find_field, fitted, fitted_binding, import_type, to_message, value_at
from tests.support.files import input_error, written


def test_fields_of_messages():
    message = to_message(import_type("test_msgs/msg/Arrays"), {"byte_values": [1, 2, 255], "float32_values": [0.5, 1.5, 2.5]})
    wanted = {"byte_values[-1]": 255, "float32_values[1]": 1.5, "bool_values_default": [False, True, False], "alignment_check": 0}
    assert {path: value_at(message, parse_field(path)) for path in wanted} == wanted
    assert value_at(message, parse_field("basic_types_values[2].int64_value")) == 0
    assert find_field(type(message), parse_field("basic_types_values[2].int64_value")).kind == "int64"
    assert find_field(type(message), parse_field("string_values")).kind == "string[3]"


def test_items_are_found_by_a_field_that_is_a_text_or_a_number():
    items = [{"int32_value": 3, "float64_value": 1.5}, {"int32_value": 4}]
    message = to_message(import_type("test_msgs/msg/UnboundedSequences"), {"basic_types_values": items})
    assert value_at(message, parse_field("basic_types_values[int32_value=3].float64_value")) == 1.5
    assert find_field(type(message), parse_field("basic_types_values[int32_value=3].float64_value")).kind == "double"
    with pytest.raises(Unreadable, match=r"none of the 2 items has int32_value=5"):
        value_at(message, parse_field("basic_types_values[int32_value=5].float64_value"))
    for wrong, said in {
        "basic_types_values[name=a].int32_value": "BasicTypes has no field 'name'",
        "basic_types_values[int32_value=?r].int32_value": "int32_value is a int32; expected a text",
        "alignment_check[name=a]": "alignment_check is a int32; only a list has an item name=a",
        "int32_values[name=a]": "int32_values is a list of int32; only items with fields can be found by one",
    }.items():
        with pytest.raises(InputError, match=re.escape(said)):
            find_field(type(message), parse_field(wrong))


def test_constants_of_messages_have_names(sensing):
    state = import_type("lifecycle_msgs/srv/GetState").Response
    text = """sensors: [{{service: s, facts: [
        {{number: (battery r1), field: current_state.id, table: {{PRIMARY_STATE_ACTIVE: 1, {key}: 0.5}}}},
        {{fact: (dark), when: {{not: {{any: [{{all: [{{field: current_state.id, ne: {name}}}]}}]}}}}}}]}}]"""
    (sensor,) = sensing(text.format(key=4, name="PRIMARY_STATE_ACTIVE")).sensors
    look = partial(value_at, to_message(state, {"current_state": {"id": 3}}))
    reading = read(Instance(fitted(sensor, state), {}), look, KnowledgeBase().objects)
    assert reading.facts == {("battery", "r1"): 1.0, ("dark",): True}
    for key, name, said in [
        (4, "PRIMARY_STATE_ACTVE", "3:9: current_state.id is a uint8, which cannot be compared with 'PRIMARY_STATE_ACTVE'; did you mean"),
        (
            "active",
            "PRIMARY_STATE_ACTIVE",
            "2:9: current_state.id is a uint8, which cannot be compared with 'active'; expected a number, or one",
        ),
    ]:
        (sensor,) = sensing(text.format(key=key, name=name)).sensors
        with pytest.raises(InputError) as caught:
            fitted(sensor, state)
        assert said.split(": ", 1)[1] in str(caught.value)
        assert f"sensing.yaml:{said[0]}:" in str(caught.value)


def binding(path: Path, text: str) -> Binding:
    return read_bindings(written(path, f"actions: {{move: {text}}}")).of("move")


@pytest.mark.parametrize(
    "text",
    [
        "{goal: {nested_field: {int32_value: 3, float64_value: 1, int8_value: '(level ?to)', bool_value: true}}}",
        "{goal: {nested_different_pkg: 2.5}}",
        "{goal: {nested_field: {of: '?to', table: {hall: {float64_value: 1.5}, kitchen: {float64_value: '$x'}}}}}",
        "{goal: {nested_field: {float64_value: {of: '?to', table: {hall: 1.5, kitchen: '(x ?to)'}}}}}",
        "{success: {field: nested_field.int32_value, eq: 0}}",
        "{success: {any: [{field: nested_field.bool_value}, {field: nested_field.float64_value, ge: 0.5}]}}",
        "{reason: nested_field.int64_value}",
        "{reason: {field: nested_field.int32_value, table: {1: no way, 2: no battery}}}",
        "{store: {nested_field.int8_value: why}}",
        "{outcomes: {slipped: {field: nested_field.int32_value, eq: 3}}}",
    ],
)
def test_a_binding_that_fits_is_as_before(tmp_path: Path, text: str) -> None:
    wanted = binding(tmp_path, text)
    assert fitted_binding(wanted, NestedMessage) == wanted


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{goal: {nested_fild: {}}}", "NestedMessage_Goal has no field 'nested_fild'; did you mean 'nested_field'?"),
        ("{goal: {nested_field: {int32_valu: 3}}}", "BasicTypes has no field 'int32_valu'; did you mean"),
        ("{goal: {nested_field: {int32_value: 1.5}}}", "field nested_field.int32_value needs int32"),
        ("{goal: {nested_field: {bool_value: 1}}}", "field nested_field.bool_value needs bool, got 1 (int)"),
        ("{goal: {nested_field: 3}}", "field nested_field needs the fields of a test_msgs/BasicTypes, got 3 (int)"),
        (
            "{goal: {nested_field: {of: '?to', table: {hall: {float64_value: far}, kitchen: {}}}}}",
            "field nested_field of hall.float64_value needs float64, got 'far' (str)",
        ),
        ("{success: {field: nested_field.status, eq: 0}}", "has no field 'status'"),
        ("{success: {field: nested_field.int32_value, eq: done}}", "cannot be compared with 'done'"),
        ("{success: {field: nested_field.int32_value}}", "nested_field.int32_value is a int32; expected a boolean"),
        ("{reason: message}", "NestedMessage_Result has no field 'message'"),
        ("{reason: {field: nested_field.int32_value, table: {bad: no way}}}", "cannot be compared with 'bad'"),
        ("{outcomes: {slipped: {field: nested_field.status, eq: 3}}}", "has no field 'status'"),
        ("{store: {time: t}}", "NestedMessage_Result has no field 'time'"),
    ],
)
def test_what_can_never_work_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        fitted_binding(binding(tmp_path, text), NestedMessage)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("int32_value", 1.0, ""),
        ("bool_value", True, ""),
        ("bool_value", 1.0, "nested_field.bool_value is a boolean; (level ?to) needs a number"),
        ("float64_value", "object", "nested_field.float64_value is a double; (level ?to) needs a text"),
        ("float32_value", True, "nested_field.float32_value is a float; (level ?to) needs a boolean"),
    ],
)
def test_a_field_that_sets_a_fluent_has_values_of_its_kind(tmp_path: Path, field: str, value: object, message: str) -> None:
    wanted = binding(tmp_path, f"{{store: {{nested_field.{field}: '(level ?to)'}}}}")
    refusal = input_error(lambda: fitted_binding(wanted, NestedMessage, lambda source: value))
    assert message == (refusal.message if refusal else "")


def test_items_of_lists_are_looked_at(tmp_path: Path) -> None:
    assert fitted_binding(binding(tmp_path, "{success: {field: 'sequence[-1]', gt: 5}}"), Fibonacci)
    with pytest.raises(InputError, match=r"Fibonacci_Goal has no field 'order\[0\]'|order is a int32; only a list has an item 0"):
        fitted_binding(binding(tmp_path, "{goal: {'order[0]': 3}}"), Fibonacci)


@pytest.mark.parametrize(
    ("action", "field", "message"),
    [
        ("test_msgs/action/Fibonacci", "sequence", ""),
        ("pyrobosim_msgs/action/DetectObjects", "detected_objects", ""),
        ("pyrobosim_msgs/action/DetectObjects", "found", "has no field 'found'"),
        (
            "pyrobosim_msgs/action/DetectObjects",
            "execution_result.message",
            "execution_result.message is a string; expected a list of names",
        ),
        ("pnm_interfaces/action/AchieveGoal", "trace", "has no field 'name'"),
    ],
)
def test_a_field_that_names_objects_is_a_list_of_names(tmp_path: Path, action: str, field: str, message: str) -> None:
    wanted = binding(tmp_path, f"{{found: {{field: {field}, type: cup}}}}")
    refusal = input_error(lambda: fitted_binding(wanted, import_type(action)))
    assert message in refusal.message if refusal else not message
