"""Fields and types of messages: what a sensor may not ask for is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.rules import Rules
from pnm.core.message_fields import Unreadable, parse_field
from pnm.errors import InputError
from pnm.knowledge.sensor_model import Instance, read
from pnm.ros.node.messages import find_field, fitted, import_type, to_message, value_at
from pnm.ros.node.services import until_true
from pnm.ros.sensors import Sensors
from tests.support.pddl.sensed_world import DOMAIN
from tests.support.ros.child_process import bounded
from tests.support.ros.listening import becomes, listening

BASIC = "test_msgs/msg/BasicTypes"


@bounded
async def test_what_cannot_be_listened_to_is_refused(ros, sensing):
    for text, said in {
        "topic: t, type: spam_msgs/msg/Eggs, facts: [{fact: (dark)}]": "1:11: the ROS type spam_msgs/msg/Eggs is not installed",
        "topic: 1t, facts: [{fact: (dark)}]": "1:11: not a name for a topic: '1t'",
        "service: 1t, facts: [{fact: (dark)}]": "1:11: not a name for a service: '1t'",
    }.items():
        with pytest.raises(InputError, match=said):
            async with listening(ros, sensing(f"sensors: [{{{text}}}]")):
                pass
    rules = Rules(tuple(replace(rule, name="dark", variables=()) for rule in DOMAIN.rules))
    with pytest.raises(InputError, match="facts of dark follow from rules"):
        Sensors(ros, sensing("sensors: [{topic: t, facts: [{fact: (dark)}]}]"), KnowledgeBase(rules=rules), 1.0)


@bounded
async def test_publishers_of_another_type_are_ignored(ros, names, sensing, sensors, caplog):
    name = names()
    sensors({"topic": name, "type": "test_msgs/msg/Strings", "fields": {"string_value": "hall"}})
    sensors({"topic": name, "type": BASIC, "fields": {"bool_value": True}})
    file = sensing(f"sensors: [{{topic: {name}, type: {BASIC}, facts: [{{fact: (dark), field: bool_value}}]}}]")
    # both are there before it is looked: a topic that nobody but the wrong publisher has is refused
    await until_true(ros, lambda: ros.node.count_publishers(f"/{name}") == 2)

    async with listening(ros, file) as world:
        await becomes(world, ("dark",), True)
        await until_true(ros, lambda: "is ignored where" in caplog.text)
    assert f"{name} is ignored where it has the type test_msgs/msg/Strings; expected {BASIC}" in caplog.text


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
