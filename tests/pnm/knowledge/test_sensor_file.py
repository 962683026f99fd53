"""Files of sensors: what is read, and what is refused; and what sensors make of messages."""

from __future__ import annotations

import math
import re
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.pipeline.loading import load
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.core.machine.bindings import Bindings
from pnm.core.message_fields import Combined, Comparison, Field, FieldValue, Flag, Unreadable, parse_field, succeeds
from pnm.errors import InputError
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import ByService, instances, read, unknown
from pnm.ros.backend import Ros2Backend
from tests.support.files import ROOT, refused, written
from tests.support.pddl.sensed_world import EVERYTHING, KNOWN, SENSING, look, objects
from tests.support.yaml.damage import damaged

BAD_INPUT = Path(__file__).with_name("refused")


# --- files ---


def test_a_file_is_read():
    battery, zone, light = SENSING.sensors
    assert (battery.stale, battery.lag, battery.service, battery.type) == (10.0, 0.5, None, "test_msgs/msg/BasicTypes")
    assert (zone.stale, zone.lag, zone.type) == (30.0, None, None)
    assert light.service == ByService({"room": ["hall"], "level": 2}, 2.0, 0.5)
    assert light.lag == 1.0, "a request may be under way when an action ends, and another one follows it"
    assert SENSING.names == {"battery", "charged", "at", "location", "dark"}
    assert SENSING.lags(1.0) == {"battery": 0.5, "charged": 0.5, "at": 1.0, "location": 1.0, "dark": 1.0}
    names = [one.name for one in instances(SENSING, objects)]
    assert names == ["/r1/battery", "/r_2/battery", "/a1/battery", "/r1/zone", "/r_2/zone", "/a1/zone", "light"]


def test_names_are_not_checked_without_a_domain(tmp_path):
    text = "sensors: [{topic: t, facts: [{fact: '(spam ?value)', field: f}, {object: (eggs x), field: f}]}]"
    sensing = read_sensing(written(tmp_path, text))
    assert [one.types for one in sensing.sensors[0].statements] == [("object",), ("object",)]


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


def test_what_is_sensed_cannot_be_assumed():
    with pytest.raises(InputError, match="there is a sensor for dark, which is among the 'assumed' of the bindings"):
        Ros2Backend(Bindings(assumed=frozenset({"dark", "spam"})), sensing=SENSING)


words = st.from_regex(r"[A-Za-z]\w{0,5}", fullmatch=True).filter(str.isascii)
fields = st.builds(lambda first, rest: Field((first, *rest)), words, st.lists(st.one_of(words, st.integers(-99, 99)), max_size=4))
values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.sampled_from(["A1", "kitchen", "hall", "moon", ""])),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["name", "x"]), inner)),
    max_leaves=8,
)
messages = st.dictionaries(st.sampled_from(["percentage", "zones", "room", "on", "lux", "names"]), values)


# --- laws ---


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
        one, other = outcome(test), outcome(Combined("not", (test,)))
        assert one is other is None or one is not other
        assert outcome(Combined("all", (test,))) is outcome(Combined("any", (test,))) is one
    assert outcome(Flag(parse_field("x"))) is (value if isinstance(value, bool) else None)


@given(values)
def test_a_table_has_a_value_for_what_it_lists(value):
    source = FieldValue(parse_field("x"), {"true": 1, "A1": 2, "3": 3})
    if value is True or value == "A1" or (value == 3 and not isinstance(value, bool)):
        assert source.value(look({"x": value})) in (1, 2, 3)
    else:
        with pytest.raises(Unreadable, match=r"which is not in the table \(true, A1, 3\)"):
            source.value(look({"x": value}))


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
