"""Reports about the world, from processes of their own."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from time import monotonic

import pytest
from pnm_interfaces.msg import State

from pnm.actions.simulated_robots import SimulatedWorld
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.errors import InputError
from pnm.ros.action_server.goal_server import publish_state
from pnm.ros.node.messages import to_message
from pnm.ros.node.ros_thread import profile
from pnm.ros.sensors import TOPIC, SensedReports, read_state, write_state
from tests.support.processes import LIMIT

FACTS = {
    ("at", "r1", "hall"): True,
    ("battery", "r1"): 80.0,
    ("battery", "r2"): UNKNOWN,
    ("held-by", "r1"): "cup",
    ("held-by", "r2"): UNDEFINED,
}


def ignore(*_):
    pass


async def test_a_report_is_handed_on_and_recorded(ros, sensors):
    report = {"names": ["at", "battery"], "facts": ["(at r1 hall)"], "fluents": ["(battery r1)"], "values": [80.0], "sequence": 7}
    world = KnowledgeBase({("at", "r1", "kitchen"): True})
    sequences = []

    def record(names, facts, sequence):
        world.replace(names, facts)
        sequences.append(sequence)

    sensing = SensedReports(ros, asyncio.get_running_loop(), record, ignore)
    await asyncio.to_thread(sensors, {"topic": TOPIC, "type": "pnm_interfaces/msg/State", "fields": report, "once": True})
    while not await sensing.first(5.0):
        pass
    sensing.close()
    assert sequences == [7]
    assert world.facts() == {("at", "r1", "hall"): True, ("battery", "r1"): 80.0}


async def test_who_comes_late_hears_the_last_report_of_a_simulation_and_no_earlier_one(ros):
    heard = []
    world = SimulatedWorld(KnowledgeBase({("at", "r1", "a"): True}), ["at"])
    joined = asyncio.Event()
    await publish_state(ros, world, world.dynamic, joined.set)
    for before, after in pairwise("abc"):
        world.change({("at", "r1", before): False, ("at", "r1", after): True})
        await ros.ask(lambda: None)  # the report is published
    sensing = SensedReports(ros, asyncio.get_running_loop(), lambda _, facts, __: heard.append(set(facts)), ignore)
    await joined.wait()
    assert await sensing.first(LIMIT)
    world.change({("at", "r1", "c"): False, ("at", "r1", "d"): True})
    while heard[-1] != {("at", "r1", "d")}:
        await ros.ask(lambda: None)
    sensing.close()
    assert heard == [{("at", "r1", "c")}, {("at", "r1", "d")}]


async def test_nobody_who_reports_is_not_waited_for(ros):
    sensing = SensedReports(ros, asyncio.get_running_loop(), ignore, ignore, topic="nobody/reports")
    await ros.settled()
    since = monotonic()
    assert not await sensing.first(LIMIT)
    assert monotonic() - since < LIMIT / 2
    sensing.close()


async def test_a_malformed_report_is_refused_with_its_names_and_the_reason(ros):
    heard, refused, topic = [], [], "knowledge/malformed"
    sensing = SensedReports(
        ros, asyncio.get_running_loop(), lambda *report: heard.append(report), lambda *report: refused.append(report), topic
    )
    publisher = await ros.ask(lambda: ros.node.create_publisher(State, topic, profile(10, latched=True)))
    await ros.ask(lambda: publisher.publish(State(names=["at"], facts=["at r1 hall"])))
    await ros.ask(lambda: publisher.publish(State(names=["at"], sequence=2)))
    await sensing.first(LIMIT)
    sensing.close()
    await ros.ask(lambda: ros.node.destroy_publisher(publisher))
    assert heard == [(frozenset({"at"}), {}, 2)]
    ((names, reason),) = refused
    assert names == {"at"}
    assert reason.startswith("not a fact: 'at r1 hall'")


def test_what_is_written_is_read():
    data = write_state(frozenset({"at", "battery"}), {**FACTS, ("at", "r2", "hall"): False}, 3)
    assert read_state(to_message(State, data)) == FACTS
    assert data["names"] == ["at", "battery"]
    assert data["facts"] == ["(at r1 hall)", "(= (held-by r1) cup)", "(= (held-by r2) undefined)"]


def test_values_must_match_fluents():
    with pytest.raises(InputError, match="1 fluents, but 2 values"):
        read_state(State(fluents=["(x)"], values=[1.0, 2.0]))
