"""What sensors make of messages, and of silence."""

from __future__ import annotations

import asyncio
import math
import re

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.pipeline.loading import load
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.core.message_fields import Comparison, parse_field, succeeds
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import instances, read
from pnm.knowledge.state_reports import StalenessWatchdog, StateReports
from tests.support.files import ROOT, written
from tests.support.pddl.sensed_world import KNOWN, PROBLEM, SENSING, look, objects

# --- messages ---


@pytest.fixture
def sensors():
    return {one.name: one for one in instances(SENSING, objects)}


def test_a_message_is_read(sensors):
    reading = read(sensors["/r1/battery"], look({"percentage": 0.8}), objects)
    assert reading.facts == {("battery", "r1"): 0.8, ("charged", "r1"): True}
    reading = read(sensors["/r_2/zone"], look({"zones": [{"name": "A1"}], "room": "hall"}), objects)
    where = {("at", "r-2", "kitchen"): True, ("at", "r-2", "hall"): False}
    assert reading.facts == {**where, ("location", "r-2"): "hall"}
    assert reading.variables == {"r-2_zone": [{"name": "A1"}]}
    reading = read(sensors["/r1/zone"], look({"zones": [{"name": 2}], "room": ""}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): False, ("at", "r1", "hall"): True, ("location", "r1"): UNKNOWN}
    assert reading.unread == {1: "room is '', which is no object of type place"}
    reading = read(sensors["/r1/zone"], look({"zones": [{"name": ""}], "room": "undefined"}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): False, ("at", "r1", "hall"): False, ("location", "r1"): UNDEFINED}
    for on, lux, names, dark in [(False, 9, [], True), (True, 3, ["moon"], True), (True, 3, [], False), (True, 0, ["moon"], False)]:
        reading = read(sensors["light"], look({"on": on, "lux": lux, "names": names}), objects)
        assert reading.facts == {("dark",): dark}


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"percentage": math.nan}, "percentage is not a number (NaN)"),
        ({"percentage": "full"}, "percentage is 'full'"),
        ({"percentage": True}, "percentage is True"),
        ({}, "there is no percentage"),
    ],
)
def test_what_cannot_be_read_is_unknown(sensors, message, said):
    reading = read(sensors["/r1/battery"], look(message), objects)
    assert reading.facts[("battery", "r1")] is UNKNOWN
    assert said in reading.unread[0]


def test_an_infinite_number_is_unknown_but_can_be_compared(sensors):
    reading = read(sensors["/r1/battery"], look({"percentage": math.inf}), objects)
    assert reading.facts == {("battery", "r1"): UNKNOWN, ("charged", "r1"): True}
    assert reading.unread == {0: "percentage is inf; expected a finite number"}


def test_a_value_that_is_not_in_the_table_is_unknown(sensors):
    reading = read(sensors["/r1/zone"], look({"zones": [{"name": "B7"}], "room": "hall"}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): UNKNOWN, ("at", "r1", "hall"): UNKNOWN, ("location", "r1"): "hall"}
    assert reading.unread == {0: "zones[0].name is 'B7', which is not in the table (A1, 2, )"}


def test_a_table_of_objects_is_needed_only_for_values_that_are_no_objects(sensors):
    sensor = sensors["/r1/zone"]
    for name, places in {"kitchen": {"kitchen"}, "hall": {"hall"}, "2": {"hall"}, "": set(), "r1": UNKNOWN, "undefined": UNKNOWN}.items():
        reading = read(sensor, look({"zones": [{"name": name}], "room": "hall"}), objects)
        at = {place: reading.facts["at", "r1", place] for place in ("kitchen", "hall")}
        assert at == {place: UNKNOWN if places is UNKNOWN else place in places for place in at}


def test_a_request_names_objects(tmp_path):
    text = "sensors: [{service: s, for: {r: arm}, request: {who: '?r', n: [1, '?r']}, facts: [{fact: '(charged ?r)'}]}]"
    (only,) = instances(read_sensing(written(tmp_path, text), KNOWN), objects)
    assert only.request(only.sensor.service) == {"who": "a1", "n": [1, "a1"]}
    assert read(only, look({}), objects).facts == {("charged", "a1"): True}, "that somebody answers may be all there is to say"


def test_items_of_a_list_are_found_by_a_field_of_theirs(tmp_path):
    text = """\
sensors:
  - topic: world
    facts:
      - {for: {r: robot}, fact: "(at ?r ?value)", field: "robots[name=?r].room", table: {A1: kitchen, moving: undefined}}
      - {for: {r: robot}, number: "(battery ?r)", field: "robots[name=?r].level"}
      - {for: {r: robot}, fact: "(charged ?r)", when: {field: "robots[name=?r].level", gt: 50}}
    variables: [{for: {r: arm}, name: "{r}_level", field: "robots[name=?r].level"}, {name: first, field: "robots[name=r1].room"}]
"""
    (world,) = instances(read_sensing(written(tmp_path, text), KNOWN), objects)
    robots = [{"name": "r1", "room": "A1", "level": 80}, {"name": "a1", "room": "moving", "level": 20}]
    reading = read(world, look({"robots": robots}), objects)
    rooms = {("at", "r1", "kitchen"): True, ("at", "a1", "kitchen"): False, ("at", "r-2", "kitchen"): UNKNOWN}
    rooms |= {("at", "r1", "hall"): False, ("at", "a1", "hall"): False, ("at", "r-2", "hall"): UNKNOWN}
    levels = {("battery", "r1"): 80.0, ("battery", "a1"): 20.0, ("battery", "r-2"): UNKNOWN}
    assert reading.facts == {**rooms, **levels, ("charged", "r1"): True, ("charged", "a1"): False, ("charged", "r-2"): UNKNOWN}
    assert reading.variables == {"a1_level": 20, "first": "A1"}
    assert set(reading.unread.values()) == {
        "there is no robots[name=r-2].room: none of the 2 items has name=r-2",
        "there is no robots[name=r-2].level: none of the 2 items has name=r-2",
    }
    twice = read(world, look({"robots": [robots[0], robots[0]]}), objects)
    assert "there is no robots[name=r1].room: 2 of the 2 items has name=r1" in twice.unread.values(), "which of them is meant?"


def test_numbers_that_conditions_take_for_equal_are_equal():
    for operation, holds in {"eq": True, "ne": False, "le": True, "ge": True, "lt": False, "gt": False}.items():
        float32 = 0.800000011920929
        assert succeeds(Comparison(parse_field("x"), operation, 0.8), look({"x": float32})) is holds


def test_the_example_of_the_documentation_says_what_it_shows(tmp_path):
    (example,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "guides" / "sensing.md").read_text(encoding="utf-8"), re.DOTALL)
    problem = load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")
    world = initial_knowledge(problem)
    by_name = {one.name: one for one in instances(read_sensing(written(tmp_path, example), problem.vocabulary), world.objects)}
    assert list(by_name) == ["/r1/zone", "/r2/zone", "/r1/battery", "/r2/battery", "/door1/get_state"]
    for name, message in {
        "/r1/zone": {"data": "C1"},
        "/r2/zone": {"data": "charging"},
        "/r1/battery": {"power_supply_status": 0, "cell_voltage": [3.5, 3.6]},
        "/door1/get_state": {"current_state": {"id": "PRIMARY_STATE_ACTIVE"}},  # constants have names until the type is known
    }.items():
        reading = read(by_name[name], look(message), world.objects)
        assert not reading.unread
        world.update(reading.facts)
        world.store(reading.variables)
    held = {fluent for fluent, value in world.facts().items() if fluent[0] in ("at", "open") and fluent[1] in ("r1", "r2", "door1")}
    assert held == {("at", "r1", "kitchen"), ("open", "door1")}
    assert (world.value(("speed", "r1")), world.variables()) == (0.5, {"r1_cells": [3.5, 3.6]})


# --- silence ---


def test_what_nobody_reports_for_too_long_falls_silent_once_and_again():
    fallen = []

    async def main():
        loop = asyncio.get_running_loop()
        watchdog = StalenessWatchdog(10.0, lambda: fallen.append(loop.time()))
        forever = StalenessWatchdog(None, lambda: fallen.append("never"))
        for _ in range(3):
            await asyncio.sleep(9.0)
            watchdog.reset()
            forever.reset()
        await asyncio.sleep(50.0)
        watchdog.reset()
        await asyncio.sleep(50.0)
        watchdog.reset()
        watchdog.close()
        await asyncio.sleep(50.0)
        forever.close()

    run_async(main(), virtual=True)
    assert fallen == [37.0, 87.0]


def test_what_is_no_longer_reported_is_unknown_until_it_is_reported_again(caplog):
    async def main():
        world = KnowledgeBase({("at", "r1", "hall"): True, ("dark",): True}, objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {"ready": "its facts follow from rules", "spam": ""}, 1.0, 5.0, KNOWN)
        names = {"at", "battery", "location", "ready", "spam"}
        report = {("at", "r1", "kitchen"): True, ("battery", "r1"): 3.0, ("location", "r1"): "hall", ("ready", "r1"): True}
        reports.record(names, report)
        kept = world.facts()
        assert kept == {("at", "r1", "kitchen"): True, ("battery", "r1"): 3.0, ("location", "r1"): "hall", ("dark",): True}
        await asyncio.sleep(4.0)
        reports.record({"battery"}, {("battery", "r1"): 2.0})
        await asyncio.sleep(3.0)
        places = [("at", robot, place) for robot in ("r1", "r-2", "a1") for place in ("kitchen", "hall")]
        assert {world.value(fluent) for fluent in [*places, ("location", "r1"), ("location", "a1")]} == {UNKNOWN}
        assert (world.value(("battery", "r1")), world.value(("dark",))) == (2.0, True)
        await asyncio.sleep(5.0)
        assert world.value(("battery", "r1")) is UNKNOWN
        reports.record(names, {("at", "r1", "hall"): True})
        assert [place for place in places if world.value(place) is not False] == [("at", "r1", "hall")]
        assert world.value(("location", "r1")) == UNDEFINED
        reports.close()
        await asyncio.sleep(50.0)
        assert world.value(("at", "r1", "hall")) is True

    run_async(main(), virtual=True)
    assert caplog.text.count("reports about ready are ignored: its facts follow from rules") == 1
    assert "spam" not in caplog.text
    assert "nothing was reported about battery for 5 s; it is unknown now" in caplog.text


def test_of_names_that_nobody_knows_more_about_what_was_recorded_is_unknown():
    async def main():
        world = KnowledgeBase(objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {}, 1.0, 5.0)
        reports.record({"at"}, {("at", "r1", "kitchen"): True})
        await asyncio.sleep(6.0)
        assert (world.value(("at", "r1", "kitchen")), world.value(("at", "r1", "hall"))) == (UNKNOWN, None)
        reports.record({"at"}, {})
        assert world.value(("at", "r1", "kitchen")) is False
        reports.close()

    run_async(main(), virtual=True)
