"""Files of sensors: what is read, and what is refused."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Bindings
from pnm.core.message_fields import Combined, Comparison, Field, FieldValue, Flag, Unreadable, parse_field, succeeds
from pnm.errors import InputError
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import ByService, instances, read, unknown
from pnm.ros.backend import Ros2Backend
from tests.support.files import refused, written
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


def sensing_of(entry: str, sensor: str = "topic: t") -> str:
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
