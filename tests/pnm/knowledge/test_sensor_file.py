"""What files of sensors say, and what sensors make of messages."""

from __future__ import annotations

import asyncio
import math
import re
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.loading import load
from planner_bridge.model.grounding import initial_knowledge
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError
from pnm.knowledge.message_fields import Comparison, Every, Field, FieldValue, Flag, Negation, Some, Unreadable, parse_field, succeeds
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import ByService, ByTopic, Instance, instances, read, unknown
from pnm.knowledge.state_reports import StateReports, Watchdog
from pnm.ros.backend import Ros2Backend
from tests.support.files import ROOT
from tests.support.pddl.sensed_world import KNOWN, PROBLEM
from tests.support.refusals import refused
from tests.support.yaml.damage import damaged

BAD_INPUT = Path(__file__).with_name("refused")

EVERYTHING = """\
stale: 30
sensors:
  - topic: /{r}/battery
    type: test_msgs/msg/BasicTypes
    for: {r: robot}
    facts:
      - number: (battery ?r)
        field: percentage
      - fact: (charged ?r)
        when: {field: percentage, ge: 0.8}
    stale: 10
    lag: 0.5
  - topic: /{r}/zone
    for: {r: robot}
    facts:
      - fact: (at ?r ?value)
        field: zones[0].name
        table: {A1: kitchen, 2: hall, "": undefined}
      - object: (location ?r)
        field: room
    variables:
      - {name: "{r}_zone", field: zones}
  - service: light
    request: {room: [hall], level: 2}
    every: 2.0
    limit: 0.5
    facts:
      - fact: (dark)
        when: {any: [{not: {field: on}}, {all: [{field: lux, lt: 5, gt: 0}, {field: names, contains: moon}]}]}
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "sensing.yaml"
    file.write_text(text)
    return file


with tempfile.TemporaryDirectory() as _folder:
    SENSING = read_sensing(written(Path(_folder), EVERYTHING), KNOWN)


@pytest.fixture
def everything():
    return SENSING


def objects(types):
    return tuple(dict.fromkeys(name for kind in types for name in PROBLEM.objects_by_type.get(kind, ())))


def look(message):
    """Return a function that looks into plain data as it would into a message."""

    def at(where: Field):
        value = message
        for step in where.steps:
            try:
                value = value[step]
            except (LookupError, TypeError) as error:
                raise Unreadable(f"there is no {where}") from error
        return value

    return at


# --- files ---------------------------------------------------------------------------------


def test_a_file_is_read(everything):
    battery, zone, light = everything.sensors
    assert (battery.stale, battery.lag, battery.way, battery.type) == (10.0, 0.5, ByTopic(), "test_msgs/msg/BasicTypes")
    assert (zone.stale, zone.lag, zone.type) == (30.0, None, None)
    assert light.way == ByService({"room": ["hall"], "level": 2}, 2.0, 0.5)
    assert light.lag == 2.5, "what is polled is as late as it is polled rarely"
    assert everything.names == {"battery", "charged", "at", "location", "dark"}
    assert everything.lags(1.0) == {"battery": 0.5, "charged": 0.5, "at": 1.0, "location": 1.0, "dark": 2.5}
    names = [one.name for one in instances(everything, objects)]
    assert names == ["/r1/battery", "/r_2/battery", "/a1/battery", "/r1/zone", "/r_2/zone", "/a1/zone", "light"]


def test_names_are_not_checked_without_a_domain(tmp_path):
    text = "sensors: [{topic: t, facts: [{fact: '(spam ?value)', field: f}, {object: (eggs x), field: f}]}]"
    sensing = read_sensing(written(tmp_path, text))
    assert [one.types for one in sensing.sensors[0].statements] == [("object",), ("object",)]


def about(entry: str, sensor: str = "topic: t") -> str:
    return f"sensors: [{{{sensor}, facts: [{entry}]}}]"


@pytest.mark.parametrize(("text", "said"), refused(BAD_INPUT / "sensors.yaml"))
def test_what_is_wrong_is_said_with_its_place(tmp_path, text, said):
    """The error is about what stands behind the mark."""
    file = written(tmp_path, text.replace("^", ""))
    with pytest.raises(InputError) as caught:
        read_sensing(file, KNOWN)
    assert said in caught.value.message
    assert str(caught.value).startswith(f"{file}:1:{text.index('^') + 1}: ")


def test_two_sensors_of_the_same_are_refused(tmp_path):
    text = """sensors:
  - {topic: '/{r}/b', for: {r: robot}, facts: [{number: '(battery ?r)', field: x}]}
  - {topic: c, facts: [{number: (battery r1), field: y}]}"""
    with pytest.raises(InputError, match=r":3:33: \(battery r1\) is sensed in line 2 as well"):
        instances(read_sensing(written(tmp_path, text), KNOWN), objects)


def test_what_is_sensed_cannot_be_assumed(everything):
    with pytest.raises(InputError, match="there is a sensor for dark, which is among the 'assumed' of the bindings"):
        Ros2Backend(Bindings(assumed=frozenset({"dark", "spam"})), sensing=everything)


# --- messages ------------------------------------------------------------------------------


def test_a_message_is_read(everything):
    battery, zone, light = everything.sensors
    reading = read(Instance(battery, {"?r": "r1"}), look({"percentage": 0.8}), objects)
    assert reading.facts == {("battery", "r1"): 0.8, ("charged", "r1"): True}
    reading = read(Instance(zone, {"?r": "r-2"}), look({"zones": [{"name": "A1"}], "room": "hall"}), objects)
    where = {("at", "r-2", "kitchen"): True, ("at", "r-2", "hall"): False}
    assert reading.facts == {**where, ("location", "r-2"): "hall"}
    assert reading.variables == {"r-2_zone": [{"name": "A1"}]}
    reading = read(Instance(zone, {"?r": "r1"}), look({"zones": [{"name": 2}], "room": ""}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): False, ("at", "r1", "hall"): True, ("location", "r1"): UNKNOWN}
    assert reading.unread == {1: "room is '', which is no object of type place"}
    reading = read(Instance(zone, {"?r": "r1"}), look({"zones": [{"name": ""}], "room": "undefined"}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): False, ("at", "r1", "hall"): False, ("location", "r1"): UNDEFINED}
    for on, lux, names, dark in [(False, 9, [], True), (True, 3, ["moon"], True), (True, 3, [], False), (True, 0, ["moon"], False)]:
        reading = read(Instance(light, {}), look({"on": on, "lux": lux, "names": names}), objects)
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
def test_what_cannot_be_read_is_unknown(everything, message, said):
    reading = read(Instance(everything.sensors[0], {"?r": "r1"}), look(message), objects)
    assert reading.facts[("battery", "r1")] is UNKNOWN
    assert said in reading.unread[0]


def test_an_infinite_number_is_unknown_but_can_be_compared(everything):
    reading = read(Instance(everything.sensors[0], {"?r": "r1"}), look({"percentage": math.inf}), objects)
    assert reading.facts == {("battery", "r1"): UNKNOWN, ("charged", "r1"): True}
    assert reading.unread == {0: "percentage is inf; expected a finite number"}


def test_a_value_that_is_not_in_the_table_is_unknown(everything):
    reading = read(Instance(everything.sensors[1], {"?r": "r1"}), look({"zones": [{"name": "B7"}], "room": "hall"}), objects)
    assert reading.facts == {("at", "r1", "kitchen"): UNKNOWN, ("at", "r1", "hall"): UNKNOWN, ("location", "r1"): "hall"}
    assert reading.unread == {0: "zones[0].name is 'B7', which is not in the table (A1, 2, )"}


def test_a_request_names_objects(tmp_path):
    text = "sensors: [{service: s, for: {r: arm}, request: {who: '?r', n: [1, '?r']}, facts: [{fact: '(charged ?r)'}]}]"
    (only,) = instances(read_sensing(written(tmp_path, text), KNOWN), objects)
    assert only.request(only.sensor.way) == {"who": "a1", "n": [1, "a1"]}
    assert read(only, look({}), objects).facts == {("charged", "a1"): True}, "that somebody answers may be all there is to say"


def test_numbers_that_conditions_take_for_equal_are_equal():
    for operation, holds in {"eq": True, "ne": False, "le": True, "ge": True, "lt": False, "gt": False}.items():
        float32 = 0.800000011920929
        assert succeeds(Comparison(parse_field("x"), operation, 0.8), look({"x": float32})) is holds


def test_the_example_of_the_documentation_says_what_it_shows(tmp_path):
    (example,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "sensing.md").read_text(encoding="utf-8"), re.DOTALL)
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


# --- laws ----------------------------------------------------------------------------------

words = st.from_regex(r"[A-Za-z]\w{0,5}", fullmatch=True).filter(str.isascii)
fields = st.builds(lambda first, rest: Field((first, *rest)), words, st.lists(st.one_of(words, st.integers(-99, 99)), max_size=4))
values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.sampled_from(["A1", "kitchen", "hall", "moon", ""])),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["name", "x"]), inner)),
    max_leaves=8,
)
messages = st.dictionaries(st.sampled_from(["percentage", "zones", "room", "on", "lux", "names"]), values)


@given(fields)
def test_a_field_is_read_as_it_is_written(field):
    assert parse_field(str(field)) == field


@given(st.text(max_size=12))
def test_what_is_no_field_is_refused_and_nothing_else_happens(text):
    with suppress(InputError):
        assert str(parse_field(text)) == text


@given(messages)
def test_a_sensor_says_something_of_the_same_whatever_it_hears(message):
    for one in instances(SENSING, objects):
        reading, nothing = read(one, look(message), objects), unknown(one, objects)
        assert reading.facts.keys() == nothing.facts.keys()
        assert reading.variables.keys() == nothing.variables.keys()
        assert set(nothing.facts.values()) <= {UNKNOWN}
        assert sum(value is True for fluent, value in reading.facts.items() if fluent[0] == "at") <= 1
        assert bool(reading.unread) is (UNKNOWN in reading.facts.values() or None in reading.variables.values())


def read_or_refused(text, known):
    """Return the sensors of a text, or where it is wrong."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            return instances(read_sensing(written(Path(folder), text), known), objects)
        except InputError as error:
            return error.position


@given(st.data(), messages, st.booleans())
@settings(max_examples=50, deadline=None)
def test_a_damaged_file_is_read_or_refused_with_a_place(data, message, checked):
    found = read_or_refused(damaged(data, EVERYTHING), KNOWN if checked else None)
    assert found is not None
    for one in found if isinstance(found, tuple) else ():
        read(one, look(message), objects)


@given(values, values)
def test_a_test_and_its_negation_disagree_or_say_nothing(value, constant):
    def outcome(test):
        try:
            return succeeds(test, look({"x": value}))
        except Unreadable:
            return None

    for operation in ("eq", "ne", "lt", "le", "gt", "ge", "contains"):
        test = Comparison(parse_field("x"), operation, constant)
        one, other = outcome(test), outcome(Negation(test))
        assert one is other is None or one is not other
        assert outcome(Every((test,))) is outcome(Some((test,))) is one
    assert outcome(Flag(parse_field("x"))) is (value if isinstance(value, bool) else None)


@given(values)
def test_a_table_has_a_value_for_what_it_lists(value):
    source = FieldValue(parse_field("x"), {"true": 1, "A1": 2, "3": 3})
    if value is True or value == "A1" or (value == 3 and not isinstance(value, bool)):
        assert source.value(look({"x": value})) in (1, 2, 3)
    else:
        with pytest.raises(Unreadable, match=r"which is not in the table \(true, A1, 3\)"):
            source.value(look({"x": value}))


# --- silence -------------------------------------------------------------------------------


def test_what_nobody_reports_for_too_long_falls_silent_once_and_again():
    fallen = []

    async def main():
        loop = asyncio.get_running_loop()
        watchdog = Watchdog(10.0, lambda: fallen.append(loop.time()))
        forever = Watchdog(None, lambda: fallen.append("never"))
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
        reports = StateReports(world, {"ready": "its facts follow from rules", "spam": ""}, 1.0, 5.0, KNOWN.signatures)
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
