"""Files of bindings and of faults: what is refused, with which words and where, and what is read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange, ground_name, read_faults
from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.domain import FluentKind, Signature, Vocabulary
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings, goal_data
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Mapped
from tests.support.files import refused, written
from tests.support.runs.files import MOVE, WORDS, error

BAD_INPUT = Path(__file__).with_name("refused")


# --- bindings ---


@pytest.mark.parametrize(("content", "message"), refused(BAD_INPUT / "bindings.yaml"))
def test_bad_bindings_are_refused(tmp_path: Path, content: str, message: str) -> None:
    assert error(read_bindings, written(tmp_path, content)) == message


def test_bindings_are_read(tmp_path: Path) -> None:
    content = """
assumed: [holding, tidy]
lag: 2
actions:
  wait:
  move:
    server: /{robot}/navigate
    type: nav2_msgs/action/NavigateToPose
    goal: {pose: {x: '(x ?to)', frame: map}, on: true}
    store: {total_distance: distance}
    timeout: 30
    accept: 1.5
    cancel: 0
    retries: 3
    resources: ["{robot}/base", arm]
"""
    move = Binding(
        server="/{robot}/navigate",
        type="nav2_msgs/action/NavigateToPose",
        goal={"pose": {"x": "(x ?to)", "frame": "map"}, "on": True},
        store={"total_distance": "distance"},
        timeout=30.0,
        accept=1.5,
        cancel=0.0,
        retries=3,
        resources=("{robot}/base", "arm"),
    )
    assert read_bindings(written(tmp_path, content)) == Bindings({"wait": Binding(), "move": move}, frozenset({"holding", "tidy"}), 2.0)
    assert read_bindings(written(tmp_path, "{}")) == Bindings()
    assert Bindings().of("move") == Binding(server=None, type=None, goal=None, store={}, timeout=None, accept=20.0, cancel=5.0, retries=1)


@pytest.mark.parametrize(("content", "message"), refused(BAD_INPUT / "bindings_with_unknown_names.yaml"))
def test_bindings_of_what_the_domain_does_not_have_are_refused(tmp_path: Path, content: str, message: str) -> None:
    path = written(tmp_path, content)
    assert error(lambda path: read_bindings(path, WORDS), path) == message
    assert read_bindings(path) != Bindings()


def test_bindings_of_what_the_domain_has_are_read(tmp_path: Path) -> None:
    content = "actions: {move: {server: '{robot}', goal: {a: '?to', b: 'to', c: 1, d: $x}, seconds: '(temperature ?to)'}}"
    assert read_bindings(written(tmp_path, content), WORDS).of("move").seconds == ("temperature", "?to")
    content = content.replace("'(temperature ?to)'", "2")
    assert read_bindings(written(tmp_path, content)).of("move").seconds == 2.0
    assert (
        read_bindings(written(tmp_path, content), Vocabulary({"move": dict.fromkeys(MOVE.parameters, ())})).of("move").server == "{robot}"
    )


@pytest.mark.parametrize(
    ("pattern", "server"),
    [(None, "move"), ("drive", "drive"), ("/{robot}/move", "/r1/move"), ("{to}/{robot}/{to}", "lab/r1/lab"), ("/{{x}}", "/{x}")],
)
def test_the_server_is_named_after_arguments(pattern: str | None, server: str) -> None:
    assert Bindings({"move": Binding(server=pattern)}).server(MOVE) == server


def test_a_server_named_after_no_parameter_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        Bindings({"move": Binding(server="/{robto}/move")}).server(MOVE)
    graph, bindings = PlanGraph((ActionCall(0, MOVE),), ()), Bindings({"move": Binding(server="/{robto}/move")})
    with pytest.raises(InputError, match=re.escape(str(caught.value))):
        generate(graph, bindings)
    assert str(caught.value) == "the server '/{robto}/move' of move names {robto}, which is not a parameter (robot, from, to)"


@pytest.mark.parametrize(("given", "duration", "timeout"), [(None, 12.0, 24.0), (None, 1.0, 10.0), (None, None, 60.0), (3.0, 12.0, 3.0)])
def test_the_time_limit_follows_from_the_duration(given: float | None, duration: float | None, timeout: float) -> None:
    assert Bindings({"wait": Binding(timeout=given)}).timeout(GroundAction("wait", duration=duration)) == timeout


EVERYTHING = {"action": "move", "arguments": ["r1", "hall", "lab"], "duration": 12.0, "robot": "r1", "from": "hall", "to": "lab"}


@pytest.mark.parametrize(
    ("of", "rows", "message"),
    [
        ("?to", "{hall: 1}", "FILE:1:47: the table has no row for lab, which ?to of move may be"),
        ("(home ?robot)", "{lab: 1}", "FILE:1:57: the table has no row for hall, which (home ?robot) of move may be"),
        ("(home ?robot)", "{hall: 1, lab: 2, r1: 3}", "FILE:1:75: (home ?robot) of move cannot be r1; expected one of hall, lab"),
        ("?to", "{hall: 1, lab: 2, attic: 3}", ""),
        ("(level)", "{1: low}", ""),
        ("$place", "{anything: 1}", ""),
    ],
)
def test_tables_have_a_row_for_every_object(tmp_path: Path, of: str, rows: str, message: str) -> None:
    place = frozenset({"place"})
    home, level = Signature(FluentKind.OBJECT, (("robot",),), ("place",)), Signature(FluentKind.NUMBER)
    known = Vocabulary(
        {"move": {"robot": ("robot",), "from": ("place",), "to": ("place",)}},
        signatures={"home": home, "level": level},
        types_of={"hall": place, "lab": place, "r1": frozenset({"robot"})},
    )
    file = written(tmp_path, f"actions: {{move: {{goal: {{x: {{of: '{of}', table: {rows}}}}}}}}}")
    if message:
        assert error(lambda path: read_bindings(path, known), file) == message
    else:
        assert read_bindings(file, known).of("move").goal


KNOWN = Layered(
    KnowledgeBase(
        {("x", "lab"): 4.5, ("at", "r1"): True, ("unsure",): UNKNOWN, ("ready", "move"): False},
        variables={"pose": "global", "speed": "global", "robot": "global", "nothing": None},
    ),
    KnowledgeBase(variables={"pose": "local", "to": "local"}),
)
Goal = Mapping[str, object] | None
Names = tuple[str, ...]


# --- goals ---


@pytest.mark.parametrize(
    ("goal", "fields", "filled", "missing"),
    [
        (None, ("robot", "to"), {"robot": "r1", "to": "lab"}, ()),
        (None, ("action", "arguments"), {"action": "move", "arguments": ["r1", "hall", "lab"]}, ()),
        (None, ("pose", "speed", "nothing"), {"pose": "local", "speed": "global", "nothing": None}, ()),
        (None, ("robot", "frame", "colour"), {"robot": "r1"}, ("frame", "colour")),
        (None, (), {}, ()),
        (None, None, EVERYTHING, ()),
        ({}, ("robot", "frame"), {"robot": "r1"}, ()),
        ({"to": "?from"}, ("to", "robot"), {"to": "hall", "robot": "r1"}, ()),
        ({"a": "?to", "b": "$to", "c": "$pose", "d": "$speed"}, (), {"a": "lab", "b": "lab", "c": "local", "d": "global"}, ()),
        ({"a": "map", "b": 3, "c": True, "d": None, "e": ""}, (), {"a": "map", "b": 3, "c": True, "d": None, "e": ""}, ()),
        ({"x": "(x ?to)", "here": "(at ?robot)", "ready": "(ready ?action)"}, (), {"x": 4.5, "here": True, "ready": False}, ()),
        ({"x": "(x ?from)", "y": "(unsure)", "z": "(x ?nobody)"}, (), {}, ("x", "y", "z")),
        ({"a": "?nobody", "b": "$nobody", "c": "?pose"}, (), {}, ("a", "b", "c")),
        ({"pose": {"p": {"x": "(x ?to)"}, "of": ["?robot", 1]}}, (), {"pose": {"p": {"x": 4.5}, "of": ["r1", 1]}}, ()),
        ({"pose": {"x": "$nobody", "y": 1}, "list": [1, "?nobody"], "ok": [None]}, (), {"ok": [None]}, ("pose", "list")),
    ],
)
def test_goal_fields_are_filled_by_name(goal: Goal, fields: Names | None, filled: Mapping[str, object], missing: Names) -> None:
    assert goal_data(MOVE, Binding(goal=goal), fields, EvaluationContext(KNOWN)) == (filled, missing)


# --- faults ---


@pytest.mark.parametrize(("content", "message"), refused(BAD_INPUT / "faults.yaml"))
def test_bad_faults_are_refused(tmp_path: Path, content: str, message: str) -> None:
    assert error(read_faults, written(tmp_path, content)) == message


def test_faults_are_read(tmp_path: Path) -> None:
    content = """
faults:
- {action: move, do: slow}
- {call: '(move r1 hall)', do: abort, after: 1, times: 2, message: blocked, ignores_cancel: true}
changes:
- {at: 2, set: [(open door), (not (at r1 hall)), (= (battery r1) 5)]}
- on: start of move( r1,hall )
  set:
  - (p)
- {on: end of move, set: [(p)]}
"""
    changes = {("open", "door"): True, ("at", "r1", "hall"): False, ("battery", "r1"): 5.0}
    assert read_faults(written(tmp_path, content)) == Faults(
        (Fault("move", FaultKind.SLOW), Fault("move(r1, hall)", FaultKind.ABORT, after=1, times=2, message="blocked", ignores_cancel=True)),
        (
            HiddenChange(changes, at=2.0),
            HiddenChange({("p",): True}, moment="start", what="move(r1, hall)"),
            HiddenChange({("p",): True}, moment="end", what="move"),
        ),
    )
    assert read_faults(written(tmp_path, "faults:\nchanges:\n")) == Faults()


def test_capitals_do_not_matter_as_in_pddl(tmp_path: Path) -> None:
    content = """
faults: [{call: '(MOVE R1 Lab LAB)', do: abort}]
changes: [{on: end of Move, set: [(not (AT r1 LAB))]}]
"""
    read = read_faults(written(tmp_path, content), WORDS)
    assert read == read_faults(written(tmp_path, content.lower()), WORDS)
    assert [fault.what for fault in read.faults] == ["move(r1, lab, lab)"]
    assert [dict(change.changes) for change in read.changes] == [{("at", "r1", "lab"): False}]


@pytest.mark.parametrize(("content", "message"), refused(BAD_INPUT / "faults_with_unknown_names.yaml"))
def test_faults_of_what_the_domain_does_not_have_are_refused(tmp_path: Path, content: str, message: str) -> None:
    path = written(tmp_path, content)
    assert error(lambda path: read_faults(path, WORDS), path) == message
    assert read_faults(path) != Faults()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("move", "move"),
        (" move ", "move"),
        ("move(r1, hall)", "move(r1, hall)"),
        ("move( r1,hall )", "move(r1, hall)"),
        ("(move r1 hall)", "move(r1, hall)"),
        ("wait()", "wait()"),
        ("(wait)", "wait()"),
    ],
)
def test_calls_may_be_written_in_several_ways(text: str, name: str) -> None:
    assert ground_name(text) == name


# --- the examples of the project ---


def test_an_absent_key_stands_where_its_mapping_does() -> None:
    top = Mapped("f", Position("f", 4, 2), {})
    assert (str(top.position("x")), top.plain("x"), top.string("x"), top.strings("x"), top.flag("x")) == ("f:4:2", None, None, [], False)
    assert (top.number("x", 1.5), top.whole("x", 3), top.section("x").nodes, top.sequence("x")) == (1.5, 3, {}, [])
