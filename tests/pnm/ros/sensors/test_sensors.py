"""Topics and services in other processes, and what is known because of them."""

from __future__ import annotations

import asyncio
import gc
import json
import math
from collections.abc import Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.logic.rules import Rules
from pnm.errors import InputError
from pnm.knowledge.message_fields import parse_field
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import Instance, Sensing, read
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.service_client import until_true
from pnm.ros.sensors.fields import find_field, fitted, value_at
from pnm.ros.sensors.sensors import Sensors
from tests.support.pddl.sensed_world import DOMAIN, PROBLEM
from tests.support.processes import LIMIT
from tests.support.ros.child_process import run

BASIC = "test_msgs/msg/BasicTypes"


@pytest.fixture
def sensing(tmp_path: Path) -> Callable[[str], Sensing]:
    def read(text: str) -> Sensing:
        (tmp_path / "sensing.yaml").write_text(text)
        return read_sensing(tmp_path / "sensing.yaml", PROBLEM.vocabulary)

    return read


@pytest.fixture
def sensors(begin) -> Callable[..., object]:
    return lambda *which: begin("sensors", *map(json.dumps, which))


@asynccontextmanager
async def listening(ros, sensing):
    world = KnowledgeBase(objects=PROBLEM.objects_by_type)
    listener = Sensors(ros, sensing, world, 1.0)
    try:
        await listener.open()
        yield world
    finally:
        await listener.close()


async def becomes(world: KnowledgeBase, fluent, value) -> None:
    """Wait until it is so."""
    changed = asyncio.Event()
    stop = world.listen(lambda _: changed.set())
    try:
        async with asyncio.timeout(LIMIT):
            while world.value(fluent) != value:
                changed.clear()
                await changed.wait()
    finally:
        stop()


def test_publishers_of_every_kind_are_heard(ros, names, sensing, sensors):
    robots = {"r1": (True, True), "r_2": (False, False), "a1": (True, False)}
    name = names()
    told = [
        {"topic": f"{name}/{robot}", "type": BASIC, "fields": {"float64_value": number}, "reliable": reliable, "latched": latched}
        for number, (robot, (reliable, latched)) in enumerate(robots.items())
    ]
    once = {"topic": f"{name}_lamp", "type": "test_msgs/msg/Nested", "fields": {"basic_types_value": {"bool_value": True}}, "once": True}
    sensors(*told, once)
    file = sensing(f"""
        sensors:
          - {{topic: "{name}/{{r}}", for: {{r: robot}}, facts: [{{number: "(battery ?r)", field: float64_value}}], lag: 3}}
          - {{topic: {name}_lamp, facts: [{{fact: (dark), field: basic_types_value.bool_value}}]}}""")

    async def main():
        async with listening(ros, file) as world:
            for fluent, value in {("battery", "r1"): 0.0, ("battery", "r-2"): 1.0, ("battery", "a1"): 2.0, ("dark",): True}.items():
                await becomes(world, fluent, value)
            assert (world.lag(["battery"]), world.lag(["dark"]), world.is_sensed(("at", "r1", "hall"))) == (3.0, 1.0, False)

    run(main())


def test_of_a_publisher_that_is_killed_nothing_is_known_any_more(ros, names, sensing, sensors, caplog):
    name = names()
    published = {"topic": name, "type": "test_msgs/msg/Strings", "fields": {"string_value": "A1"}}
    file = sensing(f"""
        stale: 1.0
        sensors:
          - topic: {name}
            facts: [{{fact: "(at r1 ?value)", field: string_value, table: {{A1: kitchen}}}}]
            variables: [{{name: zone, field: string_value}}]""")

    async def main():
        async with listening(ros, file) as world:
            killed = await asyncio.to_thread(sensors, published)
            await becomes(world, ("at", "r1", "kitchen"), True)
            assert world.value(("at", "r1", "hall")) is False
            assert world.variables() == {"zone": "A1"}
            world.update({("at", "r1", "hall"): True, ("at", "r-2", "hall"): True})
            await becomes(world, ("at", "r1", "hall"), False)
            assert world.value(("at", "r-2", "hall")) is True, "others may speak of others"
            await asyncio.to_thread(killed.kill)
            await becomes(world, ("at", "r1", "kitchen"), UNKNOWN)
            assert world.value(("at", "r1", "hall")) is UNKNOWN
            assert world.variables() == {}
            await asyncio.to_thread(sensors, published)
            await becomes(world, ("at", "r1", "kitchen"), True)

    run(main())
    assert f"nothing was heard on {name} for 1 s; what it tells is unknown" in caplog.text


def test_what_cannot_be_read_is_unknown_with_one_warning(ros, names, sensing, sensors, caplog):
    name = names()
    sensors({"topic": name, "type": "test_msgs/msg/UnboundedSequences", "fields": {"float64_values": [1.0, math.nan]}})
    file = sensing(f"""
        sensors:
          - topic: {name}
            facts:
              - {{number: (battery r1), field: "float64_values[-1]"}}
              - {{number: (battery r-2), field: "float64_values[0]"}}
              - {{number: (battery a1), field: "float64_values[2]"}}""")

    async def main():
        async with listening(ros, file) as world:
            for value in (1.0, 2.0, 3.0):
                world.update({("battery", "r1"): value})
                await becomes(world, ("battery", "r1"), UNKNOWN)
            assert world.facts() == {("battery", "r1"): UNKNOWN, ("battery", "r-2"): 1.0, ("battery", "a1"): UNKNOWN}

    run(main())
    assert caplog.text.count(f"{name}: float64_values[-1] is not a number (NaN); (battery r1) is unknown") == 1
    assert caplog.text.count(f"{name}: there is no float64_values[2]: the list has 2 items; (battery a1) is unknown") == 1


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ("{number: (battery r1), field: percentage}", "BasicTypes has no field 'percentage'; it has bool_value, byte_value"),
        (
            "{number: (battery r1), field: flaot64_value}",
            "has no field 'flaot64_value'; did you mean 'float64_value'? it has bool_value",
        ),
        ("{number: (battery r1), field: bool_value}", "bool_value is a boolean; expected a number, or a table"),
        ("{object: (location r1), field: int8_value}", "int8_value is a int8; expected a text, or a table"),
        ("{fact: (dark), field: int8_value}", "int8_value is a int8; expected a boolean, or 'when' and how it compares"),
        ("{fact: (dark), when: {field: int8_value, eq: low}}", "int8_value is a int8, which cannot be compared with 'low'"),
        ("{fact: (dark), when: {not: {field: bool_value, eq: 1}}}", "bool_value is a boolean, which cannot be compared with 1"),
        ("{fact: (dark), when: {field: bool_value, contains: 1}}", "bool_value is a boolean, which contains nothing"),
        ("{number: (battery r1), field: 'float64_value[0]'}", "float64_value is a double; only a list has an item 0"),
        ("{number: (battery r1), field: float64_value.x}", "double has no field 'x'; it has none"),
    ],
    ids=lambda value: value[:50],
)
def test_a_field_that_the_type_does_not_have_is_refused(ros, sensing, facts, said):
    file = sensing(f"sensors:\n  - topic: nobody\n    type: {BASIC}\n    facts: [{facts}]")

    async def main():
        with pytest.raises(InputError) as caught:
            Sensors(ros, file, KnowledgeBase(objects=PROBLEM.objects_by_type), 1.0)
        assert said in str(caught.value)
        assert caught.value.position.line == 4

    run(main())


def test_types_found_in_the_graph_are_checked_as_well(ros, names, sensing, sensors):
    topic, service = names(), names()
    sensors(
        {"topic": topic, "type": BASIC, "fields": {}},
        {"service": service, "type": "test_msgs/srv/BasicTypes", "fields": {}},
    )

    async def main(text, said):
        await until_true(ros, lambda: ros.node.count_services(service))
        with pytest.raises(InputError, match=said):
            async with listening(ros, sensing(text)):
                pass

    run(main(f"sensors: [{{topic: {topic}, facts: [{{fact: (dark), field: open}}]}}]", "BasicTypes has no field 'open'"))
    run(main(f"sensors: [{{service: {service}, facts: [{{fact: (dark), field: open}}]}}]", "BasicTypes_Response has no field 'open'"))
    refused = f"sensors: [{{service: {service}, request: {{level: 1}}, facts: [{{fact: (dark), field: bool_value}}]}}]"
    run(main(refused, "a field that BasicTypes_Request does not have"))


def test_what_cannot_be_listened_to_is_refused(ros, sensing):
    async def main():
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

    run(main())


def test_publishers_of_another_type_are_ignored(ros, names, sensing, sensors, caplog):
    name = names()
    sensors({"topic": name, "type": "test_msgs/msg/Strings", "fields": {"string_value": "hall"}})
    sensors({"topic": name, "type": BASIC, "fields": {"bool_value": True}})
    file = sensing(f"sensors: [{{topic: {name}, type: {BASIC}, facts: [{{fact: (dark), field: bool_value}}]}}]")

    async def main():
        async with listening(ros, file) as world:
            await becomes(world, ("dark",), True)
            await until_true(ros, lambda: "is ignored where" in caplog.text)

    run(main())
    assert f"{name} is ignored where it has the type test_msgs/msg/Strings; expected {BASIC}" in caplog.text


def test_a_topic_that_we_already_use_with_another_type_is_refused(ros, names, sensing, sensors):
    name = names()
    sensors({"topic": name, "type": BASIC, "fields": {"bool_value": True}})
    text = f"sensors: [{{topic: {name}, facts: [{{fact: (dark), field: bool_value}}]}}]"

    async def main():
        own = await ros.ask(lambda: ros.node.create_subscription(import_type("test_msgs/msg/Empty"), name, print, 1))
        await until_true(ros, lambda: ros.node.count_publishers(name))
        with pytest.raises(InputError, match=f"1:11: {name} cannot be listened to: "):
            async with listening(ros, sensing(text)):
                pass
        await ros.ask(lambda: ros.node.destroy_subscription(own))

    run(main())


def test_services_are_polled_and_unknown_when_they_do_not_answer(ros, names, sensing, sensors, caplog):
    name, deaf = names(), names()
    offered = {"service": f"{name}/a1", "type": "test_msgs/srv/BasicTypes", "fields": {"float32_value": 0.5}}
    file = sensing(f"""
        sensors:
          - service: {name}/{{a}}
            for: {{a: arm}}
            request: {{string_value: "?a", int32_value: 3}}
            every: 0.2
            facts: [{{number: "(battery ?a)", field: float32_value}}]
            stale: 2
          - {{service: {deaf}, every: 0.1, limit: 0.1, stale: 0.5, facts: [{{fact: (dark), field: bool_value}}]}}""")

    async def main():
        other = await asyncio.to_thread(sensors, {**offered, "service": deaf, "deaf": True})
        process = await asyncio.to_thread(sensors, offered)
        async with listening(ros, file) as world:
            await becomes(world, ("battery", "a1"), 0.5)
            assert json.loads(await asyncio.to_thread(process.line)) == {"string_value": "a1", "int32_value": 3}
            await becomes(world, ("dark",), UNKNOWN)
            await asyncio.to_thread(process.kill)
            await becomes(world, ("battery", "a1"), UNKNOWN)
            await asyncio.to_thread(sensors, offered)
            await becomes(world, ("battery", "a1"), 0.5)
        assert other.process.poll() is None

    run(main())
    assert caplog.text.count(f"the service {deaf} did not answer within 0.1 s") == 1


def test_nobody_is_waited_for_who_is_not_there(ros, sensing, caplog):
    async def main():
        async with listening(ros, sensing("sensors: [{topic: nobody, facts: [{fact: (dark), field: x}]}]")) as world:
            assert world.facts() == {}
        gc.collect()

    run(main())
    assert "nothing has been heard on nobody yet" in caplog.text
    assert "never retrieved" not in caplog.text


def test_fields_of_messages():
    message = to_message(import_type("test_msgs/msg/Arrays"), {"byte_values": [1, 2, 255], "float32_values": [0.5, 1.5, 2.5]})
    wanted = {"byte_values[-1]": 255, "float32_values[1]": 1.5, "bool_values_default": [False, True, False], "alignment_check": 0}
    assert {path: value_at(message, parse_field(path)) for path in wanted} == wanted
    assert value_at(message, parse_field("basic_types_values[2].int64_value")) == 0
    assert find_field(type(message), parse_field("basic_types_values[2].int64_value")).kind == "int64"
    assert find_field(type(message), parse_field("string_values")).kind == "string[3]"


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
