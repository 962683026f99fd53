"""Sensors over topics and services of real publishers and servers."""

from __future__ import annotations

import asyncio
import gc
import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.logic.rules import Rules
from pnm.errors import InputError
from pnm.ros.node.messages import import_type
from pnm.ros.node.services import until_true
from pnm.ros.sensors import Sensors
from tests.support.pddl.sensed_world import DOMAIN
from tests.support.ros.child_process import run_bounded
from tests.support.ros.listening import becomes, listening

BASIC = "test_msgs/msg/BasicTypes"


async def test_publishers_of_every_kind_are_heard(ros, name, sensing, sensors):
    robots = {"r1": (True, True), "r_2": (False, False), "a1": (True, False)}
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

    async with listening(ros, file) as world:
        for fluent, value in {("battery", "r1"): 0.0, ("battery", "r-2"): 1.0, ("battery", "a1"): 2.0, ("dark",): True}.items():
            await becomes(world, fluent, value)
        assert (world.lag(["battery"]), world.lag(["dark"]), world.is_sensed(("at", "r1", "hall"))) == (3.0, 1.0, False)


async def test_of_a_publisher_that_is_killed_nothing_is_known_any_more(ros, name, sensing, sensors, caplog):
    published = {"topic": name, "type": "test_msgs/msg/Strings", "fields": {"string_value": "A1"}}
    file = sensing(f"""
        stale: 1.0
        sensors:
          - topic: {name}
            facts: [{{fact: "(at r1 ?value)", field: string_value, table: {{A1: kitchen}}}}]
            variables: [{{name: zone, field: string_value}}]""")

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
        assert world.because(("at", "r1", "hall")) == f"(nothing was heard on {name} for 1 s)"
        assert world.variables() == {}
        await asyncio.to_thread(sensors, published)
        await becomes(world, ("at", "r1", "kitchen"), True)
        assert world.because(("at", "r1", "kitchen")) == ""
    assert f"nothing was heard on {name} for 1 s; its facts are unknown" in caplog.text


async def test_what_cannot_be_read_is_unknown_with_one_warning(ros, name, sensing, sensors, caplog):
    sensors({"topic": name, "type": "test_msgs/msg/UnboundedSequences", "fields": {"float64_values": [1.0, math.nan]}})
    file = sensing(f"""
        sensors:
          - topic: {name}
            facts:
              - {{number: (battery r1), field: "float64_values[-1]"}}
              - {{number: (battery r-2), field: "float64_values[0]"}}
              - {{number: (battery a1), field: "float64_values[2]"}}""")

    async with listening(ros, file) as world:
        for value in (1.0, 2.0, 3.0):
            world.update({("battery", "r1"): value})
            await becomes(world, ("battery", "r1"), UNKNOWN)
        assert world.facts() == {("battery", "r1"): UNKNOWN, ("battery", "r-2"): 1.0, ("battery", "a1"): UNKNOWN}
    assert caplog.text.count(f"{name}: float64_values[-1] is not a number (NaN); (battery r1) is unknown") == 1
    assert caplog.text.count(f"{name}: there is no float64_values[2]: the list has 2 items; (battery a1) is unknown") == 1


async def test_a_topic_without_the_field_or_that_we_already_use_with_another_type_is_refused(ros, name, sensing, sensors):
    sensors({"topic": name, "type": BASIC, "fields": {"bool_value": True}})
    text = f"sensors: [{{topic: {name}, facts: [{{fact: (dark), field: bool_value}}]}}]"

    await until_true(ros, lambda: ros.node.count_publishers(name))
    with pytest.raises(InputError, match="BasicTypes has no field 'open'"):
        async with listening(ros, sensing(text.replace("bool_value", "open"))):
            pass
    own = await ros.ask(lambda: ros.node.create_subscription(import_type("test_msgs/msg/Empty"), name, print, 1))
    with pytest.raises(InputError, match=f"1:11: {name} cannot be listened to: "):
        async with listening(ros, sensing(text)):
            pass
    await ros.ask(lambda: ros.node.destroy_subscription(own))


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

    run_bounded(main())
    warnings = [record.message for record in caplog.records if deaf in record.message]
    assert f"the service {deaf} did not answer within 0.1 s" in warnings
    assert all(one != other for one, other in pairwise(warnings)), "the same is not said again and again"


async def test_nobody_is_waited_for_who_is_not_there(ros, sensing, caplog):
    async with listening(ros, sensing("sensors: [{topic: nobody, facts: [{fact: (dark), field: x}]}]")) as world:
        assert world.facts() == {}
    gc.collect()
    assert "never retrieved" not in caplog.text


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


async def test_publishers_of_another_type_are_ignored(ros, name, sensing, sensors, caplog):
    sensors({"topic": name, "type": "test_msgs/msg/Strings", "fields": {"string_value": "hall"}})
    sensors({"topic": name, "type": BASIC, "fields": {"bool_value": True}})
    file = sensing(f"sensors: [{{topic: {name}, type: {BASIC}, facts: [{{fact: (dark), field: bool_value}}]}}]")
    # both are there before it is looked: a topic that nobody but the wrong publisher has is refused
    await until_true(ros, lambda: ros.node.count_publishers(f"/{name}") == 2)

    async with listening(ros, file) as world:
        await becomes(world, ("dark",), True)
        await until_true(ros, lambda: "is ignored where" in caplog.text)
    assert f"{name} is ignored where it has the type test_msgs/msg/Strings; expected {BASIC}" in caplog.text
