"""Bindings and sensors against a snapshot of the ROS graph: what is ready, what is not there yet, and what can never work."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planner_bridge.pddl import parse_domain, parse_problem
from pnm.actions.bindings_file import read_bindings
from pnm.core.readiness import Readiness, ReadyState, refuse_unfit
from pnm.errors import InputError
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import instances
from pnm.ros.backend import action_readiness, sensor_readiness, server_calls
from pnm.ros.node.graph import GraphSnapshot
from pnm.ros.sensors import SensorUse
from tests.support.files import written

DOMAIN = parse_domain("""
(define (domain foreign)
  (:requirements :typing :fluents)
  (:types place robot)
  (:predicates (open ?p - place) (lit))
  (:functions (x ?p - place) (level) - number (home ?r - robot) - place)
  (:action count :parameters (?r - robot) :precondition () :effect (lit))
  (:action measure :parameters (?to - place) :precondition () :effect (lit)))
""")
PROBLEM = parse_problem(
    "(define (problem p) (:domain foreign) (:objects hall kitchen - place r-1 r2 - robot) (:init) (:goal (lit)))", DOMAIN
)
FIBONACCI, NESTED = "test_msgs/action/Fibonacci", "test_msgs/action/NestedMessage"
BASIC, BASIC_SERVICE = "test_msgs/msg/BasicTypes", "test_msgs/srv/BasicTypes"
NOTHING = GraphSnapshot({}, {}, {})
GRAPH = GraphSnapshot({"/count": (FIBONACCI,), "/measure": (NESTED,)}, {"/lamp": (BASIC,)}, {"/gauge": (BASIC_SERVICE,)})
OTHER = f"measure: {{type: {NESTED}, goal: {{}}}}"
COUNT, MEASURE = "count: {goal: {order: 3}}", "measure: {goal: {}}"


def actions(path: Path, *bindings: str, graph: GraphSnapshot = GRAPH) -> dict[str, Readiness]:
    """How ready the two actions are, by their servers."""
    bound = read_bindings(written(path / "bindings.yaml", "\n  ".join(("actions:", *bindings))), PROBLEM.vocabulary)
    calls = server_calls(PROBLEM.vocabulary, bound)
    servers = {call: f"/{bound.server(call).replace('-', '_').lstrip('/')}" for call in calls}
    rows = action_readiness(servers, bound, PROBLEM.vocabulary, graph, (), 7.0)
    return {f"{row.what} {row.name}": row for row in rows}


def sensors(path: Path, text: str, *heard: str) -> tuple[Readiness, ...]:
    sensing = read_sensing(written(path / "sensing.yaml", f"sensors:\n  - {text}"), PROBLEM.vocabulary)
    uses = [SensorUse(one, one.name, one.name in heard, None) for one in instances(sensing, PROBLEM.objects_by_type)]
    return tuple(sensor_readiness(uses, GRAPH))


def test_what_is_there_and_fits_is_ready(tmp_path: Path) -> None:
    rows = actions(tmp_path, COUNT, MEASURE)
    assert {name: row.state for name, row in rows.items()} == {"count /count": ReadyState.READY, "measure /measure": ReadyState.READY}
    assert rows["count /count"].type == FIBONACCI
    refuse_unfit(rows.values())


def test_a_server_for_each_robot_is_looked_for(tmp_path: Path) -> None:
    graph = GraphSnapshot({"/r_1/count": (FIBONACCI,), "/measure": (NESTED,)}, {}, {})
    rows = actions(tmp_path, 'count: {server: "/{r}/count", goal: {order: 3}}', MEASURE, graph=graph)
    assert rows["count /r_1/count"].state is ReadyState.READY
    absent = rows["count /r2/count"]
    assert (absent.state, absent.advice) == (ReadyState.ABSENT, "there is no action server /r2/count; similar are /r_1/count")
    assert absent.waits == "is waited for where it is needed, 7 s at most"


@pytest.mark.parametrize(
    ("binding", "advice"),
    [
        (f"count: {{type: {NESTED}}}", f"the action server /count has the type {FIBONACCI}, the binding says {NESTED}"),
        ("count: {server: new, type: spam_msgs/action/Eggs}", "the ROS type spam_msgs/action/Eggs is not installed; install"),
        (
            "count: {retries: 0}",
            "nothing here gives a value for order of its goal (parameters: r); expected 'goal: {order: …}' in the binding",
        ),
        ("count: {goal: {order: five}}", "field order needs int32 (-2147483648 to 2147483647), got 'five' (str)"),
        ("count: {goal: {order: '?r'}}", "field order, which is filled from ?r, needs int32"),
        ("count: {goal: {order: $r}}", "field order, which is filled from $r, needs int32"),
        ("count: {goal: {order: (lit)}}", "field order, which is filled from (lit), needs int32"),
        ("count: {goal: {order: '(home ?r)'}}", "field order, which is filled from (home ?r), needs int32"),
        ("count: {goal: {order: {of: '?r', table: {r-1: 1, r2: x}}}}", "field order of r2 needs int32"),
        ("count: {goal: {order: 3}, store: {numbers: n}}", "Fibonacci_Result has no field 'numbers'"),
        ("count: {server: measure, goal: {nested_field: {bool_value: (level)}}}", "filled from (level), needs bool"),
    ],
)
def test_what_can_never_work_is_unfit_and_refused_with_its_place(tmp_path: Path, binding: str, advice: str) -> None:
    rows = actions(tmp_path, binding, MEASURE)
    (row,) = [row for row in rows.values() if row.what == "count"]
    assert row.state is ReadyState.UNFIT
    assert advice in row.advice
    with pytest.raises(InputError) as refusal:
        refuse_unfit(rows.values())
    assert str(refusal.value) == f"{tmp_path}/bindings.yaml:2:10: {row.advice}"


@pytest.mark.parametrize(
    "binding",
    [
        "count: {goal: {order: (level)}}",
        "count: {goal: {}}",
        "count: {ask: {order: how many}}",
        "count: {goal: {order: $x}, store: {sequence: x}}",
    ],
)
def test_fields_may_be_left_out_on_purpose_asked_for_or_filled_from_what_is_stored(tmp_path: Path, binding: str) -> None:
    assert actions(tmp_path, binding, MEASURE)["count /count"].state is ReadyState.READY


def test_a_variable_that_nothing_gives_a_value_to_is_not_there_yet(tmp_path: Path) -> None:
    row = actions(tmp_path, "count: {goal: {order: $readin}}", "measure: {goal: {}, store: {nested_field: reading}}")["count /count"]
    reason = "nothing here gives a value to $readin, unless something does while it runs; did you mean 'reading'?"
    assert (row.state, row.advice) == (ReadyState.ABSENT, reason)


def test_a_server_that_is_still_to_come_may_return_what_another_needs(tmp_path: Path) -> None:
    graph = GraphSnapshot({"/count": (FIBONACCI,)}, {}, {})
    row = actions(tmp_path, "count: {retries: 0}", MEASURE, graph=graph)["count /count"]
    reason = "nothing here gives a value for order of its goal (parameters: r), unless a server that is not there yet returns it"
    assert row.state is ReadyState.ABSENT
    assert row.advice == f"{reason}; else expected 'goal: {{order: …}}' in the binding of count, which may leave fields out"
    row = actions(tmp_path, "count: {retries: 0}", OTHER, graph=graph)["count /count"]
    assert row.state is ReadyState.UNFIT, "of this server the type is known"


def test_a_server_has_one_type(tmp_path: Path) -> None:
    rows = actions(tmp_path, f"count: {{server: measure, type: {FIBONACCI}}}", OTHER)
    expected = (
        f"/measure is a {FIBONACCI} here, and a {NESTED} in the binding of measure ({tmp_path}/bindings.yaml:3:12); expected one type"
    )
    assert rows["count /measure"].advice.startswith(expected)
    with pytest.raises(InputError, match=r"bindings.yaml:2:10: [^\n]*\n[^\n]*bindings.yaml:3:12: "):
        refuse_unfit(rows.values())
    rows = actions(tmp_path, "count: {server: measure, goal: {nested_field: {int32_value: 1.5}}}", OTHER, graph=NOTHING)
    assert (rows["count /measure"].state, rows["count /measure"].type) == (ReadyState.UNFIT, NESTED)


def test_two_servers_of_one_name_are_said_unless_there_may_be_several(tmp_path: Path) -> None:
    graph = replace(GRAPH, processes={"/count": 2, "/measure": 1})
    rows = actions(tmp_path, COUNT, MEASURE, graph=graph)
    assert (rows["count /count"].state, rows["measure /measure"].state) == (ReadyState.SEVERAL, ReadyState.READY)
    assert rows["count /count"].advice.startswith("2 processes offer /count, unless one of them was killed lately")
    several = "count: {goal: {order: 3}, several_servers: true}"
    assert actions(tmp_path, several, MEASURE, graph=graph)["count /count"].state is ReadyState.READY


def test_two_types_under_one_name_are_to_become_one(tmp_path: Path) -> None:
    graph = GraphSnapshot({"/count": (FIBONACCI, NESTED), "/measure": (NESTED,)}, {}, {})
    row = actions(tmp_path, COUNT, MEASURE, graph=graph)["count /count"]
    assert row.state is ReadyState.ABSENT
    assert (
        row.advice == f"there are servers of several types under this name, {FIBONACCI}, {NESTED}; expected one, or a 'type' in the binding"
    )
    assert (
        actions(tmp_path, f"count: {{goal: {{order: 3}}, type: {FIBONACCI}}}", MEASURE, graph=graph)["count /count"].state
        is ReadyState.READY
    )


def test_sensors_are_heard_silent_or_not_there(tmp_path: Path) -> None:
    lamp = "{topic: /lamp, facts: [{fact: (lit), field: bool_value}]}"
    (row,) = sensors(tmp_path, lamp, "/lamp")
    assert (row.what, row.type, row.state) == ("(lit)", BASIC, ReadyState.READY)
    (row,) = sensors(tmp_path, lamp)
    assert (row.state, row.advice) == (ReadyState.SILENT, "nothing was heard on /lamp yet; until then its facts are unknown")
    sensing = read_sensing(written(tmp_path / "sensing.yaml", f"sensors:\n  - {lamp[:-1]}, stale: 2}}"), PROBLEM.vocabulary)
    (silent,) = (SensorUse(one, one.name, True, None, is_stale=True) for one in instances(sensing, PROBLEM.objects_by_type))
    (row,) = sensor_readiness([silent], GRAPH)
    assert (row.state, row.advice) == (ReadyState.STALE, "nothing was heard on /lamp for 2 s; its facts are unknown")
    (row,) = sensors(tmp_path, lamp.replace("/lamp", "/lamps"))
    assert (row.state, row.advice) == (ReadyState.ABSENT, "there is no topic /lamps; similar are /lamp")
    (row,) = sensors(tmp_path, "{service: /gaug, facts: [{number: (level), field: float64_value}]}")
    assert (row.state, row.advice) == (ReadyState.ABSENT, "there is no service /gaug; similar are /gauge")


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        (
            "{topic: /lamp, type: test_msgs/msg/Strings, facts: [{fact: (lit)}]}",
            f"/lamp has the type {BASIC}, the sensor says test_msgs/msg/Strings",
        ),
        ("{topic: /lamp, facts: [{fact: (lit), field: bool_valu}]}", "has no field 'bool_valu'; did you mean 'bool_value'?"),
        ("{topic: /lamp, facts: [{number: (level), field: percentage}]}", "BasicTypes has no field 'percentage'; it has bool_value, byte"),
        ("{topic: /lamp, facts: [{number: (level), field: bool_value}]}", "bool_value is a boolean; expected a number, or a table"),
        ("{topic: /lamp, facts: [{object: (home r2), field: int8_value}]}", "int8_value is a int8; expected a text, or a table"),
        ("{topic: /lamp, facts: [{fact: (lit), field: int8_value}]}", "int8_value is a int8; expected a boolean, or 'when' and how it"),
        (
            "{topic: /lamp, facts: [{fact: (lit), when: {not: {field: bool_value, eq: 1}}}]}",
            "bool_value is a boolean, which cannot be compared with 1",
        ),
        (
            "{topic: /lamp, facts: [{fact: (lit), when: {field: bool_value, contains: 1}}]}",
            "bool_value is a boolean, which contains nothing",
        ),
        ("{topic: /lamp, facts: [{number: (level), field: 'float64_value[0]'}]}", "float64_value is a double; only a list has an item 0"),
        ("{topic: /lamp, facts: [{number: (level), field: float64_value.x}]}", "double has no field 'x'; it has none"),
        ("{topic: /new, type: spam_msgs/msg/Eggs, facts: [{fact: (lit)}]}", "the ROS type spam_msgs/msg/Eggs is not installed"),
        ("{service: /gauge, request: {flaot64_value: 1}, facts: [{fact: (lit), field: bool_value}]}", "flaot64_value"),
        ("{service: /gauge, facts: [{number: (level), field: string_value}]}", "string_value is a string; expected a number"),
    ],
)
def test_sensors_that_can_never_work_are_refused_with_their_place(tmp_path: Path, text: str, advice: str) -> None:
    rows = sensors(tmp_path, text)
    assert [row.state for row in rows] == [ReadyState.UNFIT]
    with pytest.raises(InputError) as refusal:
        refuse_unfit(rows)
    assert advice in str(refusal.value)
    assert f"{tmp_path}/sensing.yaml:2:" in str(refusal.value)
