"""Files of bindings and faults: what is refused, with which words and where, and what is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange, ground_name, read_faults
from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.declared_names import Vocabulary
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings, goal_data
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError, Position
from pnm.files.text import read_text
from pnm.files.yaml_loader import MAX_DEPTH, MAX_NODES
from pnm.files.yaml_nodes import MAX_BYTES, Mapped, load_yaml
from tests.support.files import written
from tests.support.refusals import refused

BAD_INPUT = Path(__file__).with_name("refused")


def error(read: Callable[[Path], object], path: Path) -> str:
    """The message of the refusal, with FILE for the path."""
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.position is not None
    return str(caught.value).replace(str(path), "FILE")


# --- no YAML, or not plain data ---------------------------------------------------------------

AT_LIMIT = "a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH
BOMB = "a: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 20))

BAD_YAML = [
    *refused(BAD_INPUT / "plain_data.yaml"),
    ("", "FILE:1:1: the file is empty; expected a mapping"),
    ("a: 1\nb: {x: 1\n", "FILE:3:1: not YAML: expected ',' or '}', but got '<stream end>'"),
    ("\n  text", "FILE:2:3: expected a mapping (key: value)"),
    ("a: \x07", "FILE:1:1: not YAML: unacceptable character #x0007: special characters are not allowed"),
    ("a: 1" + "0" * 5000, f"FILE:1:4: cannot be read as int: '1{'0' * 39}'"),
    ("a: " + "[" * 20_000, f"FILE:1:1: nested deeper than {MAX_DEPTH}"),
    (b"a: 1\nb: \xff\xfe", "FILE:2:4: not a text file: byte 0xff is not UTF-8"),
    (b"\x7fELF\x00\x00", "FILE:1:1: not a text file: it contains zero bytes"),
]


def everything(path: Path) -> dict[str, object]:
    top = load_yaml(path)
    return {key: top.plain(key) for key in top.nodes}


@pytest.mark.parametrize(("content", "message"), BAD_YAML)
def test_what_is_not_plain_yaml_is_refused(tmp_path: Path, content: str | bytes, message: str) -> None:
    assert error(everything, written(tmp_path, content)) == message


def test_an_alias_bomb_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, BOMB)
    assert error(load_yaml, path).endswith(f"more than {MAX_NODES} values")


def test_missing_files_folders_and_huge_files_are_refused(tmp_path: Path) -> None:
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    assert error(load_yaml, tmp_path / "nowhere.yaml") == "FILE:1:1: cannot be read: No such file or directory"
    assert error(load_yaml, tmp_path) == "FILE:1:1: cannot be read: it is not a regular file"
    assert error(load_yaml, huge) == f"FILE:1:1: the file has more than {MAX_BYTES} bytes; no more are read"
    assert read_text(written(tmp_path, "four"), 4) == "four"
    assert error(lambda path: read_text(path, 3), written(tmp_path, "four")) == "FILE:1:1: the file has more than 3 bytes; no more are read"


PLAIN = [
    ("a: 1", 1),
    ("\ufeffa: 0x1F", 31),
    ("a: [1.5, -2, true, no, ~, '1', text]", [1.5, -2, True, False, None, "1", "text"]),
    ("a: {on: on, 1: one, ~: none}", {"on": True, "1": "one", "~": "none"}),
    ("a: 2024-02-30", "2024-02-30"),
    ("a: [&x {b: c}, *x]", [{"b": "c"}, {"b": "c"}]),
    ("a: |\n  two\n  lines\n", "two\nlines\n"),
    ("a: ''", ""),
    ("a:", None),
    ("a: größer 🤖", "größer 🤖"),
]


@pytest.mark.parametrize(("content", "value"), PLAIN, ids=[content for content, _ in PLAIN])
def test_plain_data_is_read_and_keys_stay_text(tmp_path: Path, content: str, value: object) -> None:
    assert everything(written(tmp_path, content)) == {"a": value}


def test_the_deepest_nesting_is_read(tmp_path: Path) -> None:
    assert everything(written(tmp_path, AT_LIMIT)).keys() == {"a"}


@given(st.one_of(st.text("ab: -[]{}&*!'\"|>#%@\n?,~<=0.", max_size=40), st.binary(max_size=40)))
@example("a: !!timestamp x")
@example("a: 0x_")
@example("a: 9:99:99")
def test_anything_is_read_or_refused_with_a_position(tmp_path_factory: pytest.TempPathFactory, content: str | bytes) -> None:
    path = written(tmp_path_factory.getbasetemp(), content)
    try:
        everything(path)
    except InputError as refused:
        position = refused.position
    else:
        position = Position(str(path), 1, 1)
    assert position is not None
    assert position.file == str(path)


# --- bindings ---------------------------------------------------------------------------------


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
    assert Bindings().of("move") == Binding(server=None, type=None, goal=None, store={}, timeout=None, accept=15.0, cancel=5.0, retries=1)


MOVE = GroundAction("move", ("r1", "hall", "lab"), ("robot", "from", "to"), duration=12.0)


WORDS = Vocabulary(
    {"move": MOVE.parameters, "wait": ()}, frozenset({"at", "battery", "near"}), frozenset({"r1", "lab"}), derived=frozenset({"near"})
)


@pytest.mark.parametrize(("content", "message"), refused(BAD_INPUT / "bindings_with_unknown_names.yaml"))
def test_bindings_of_what_the_domain_does_not_have_are_refused(tmp_path: Path, content: str, message: str) -> None:
    path = written(tmp_path, content)
    assert error(lambda path: read_bindings(path, WORDS), path) == message
    assert read_bindings(path) != Bindings()


def test_bindings_of_what_the_domain_has_are_read(tmp_path: Path) -> None:
    content = "actions: {move: {server: '{robot}', goal: {a: '?to', b: 'to', c: 1, d: $x}}}"
    assert read_bindings(written(tmp_path, content), Vocabulary({"move": MOVE.parameters})).of("move").server == "{robot}"


@pytest.mark.parametrize(
    ("pattern", "server"),
    [(None, "move"), ("drive", "drive"), ("/{robot}/move", "/r1/move"), ("{to}/{robot}/{to}", "lab/r1/lab"), ("/{{x}}", "/{x}")],
)
def test_the_server_is_named_after_arguments(pattern: str | None, server: str) -> None:
    assert Bindings({"move": Binding(server=pattern)}).server(MOVE) == server


def test_a_server_named_after_no_parameter_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        Bindings({"move": Binding(server="/{robto}/move")}).server(MOVE)
    assert str(caught.value) == "the server '/{robto}/move' of move names {robto}, which is not a parameter (robot, from, to)"


@pytest.mark.parametrize(("given", "duration", "timeout"), [(None, 12.0, 24.0), (None, 1.0, 10.0), (None, None, 60.0), (3.0, 12.0, 3.0)])
def test_the_time_limit_follows_from_the_duration(given: float | None, duration: float | None, timeout: float) -> None:
    assert Bindings({"wait": Binding(timeout=given)}).timeout(GroundAction("wait", duration=duration)) == timeout


# --- goals ------------------------------------------------------------------------------------

EVERYTHING = {"action": "move", "arguments": ["r1", "hall", "lab"], "duration": 12.0, "robot": "r1", "from": "hall", "to": "lab"}
KNOWN = Layered(
    KnowledgeBase(
        {("x", "lab"): 4.5, ("at", "r1"): True, ("unsure",): UNKNOWN, ("ready", "move"): False},
        variables={"pose": "global", "speed": "global", "robot": "global", "nothing": None},
    ),
    KnowledgeBase(variables={"pose": "local", "to": "local"}),
)

Goal = Mapping[str, object] | None
Names = tuple[str, ...]


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


# --- faults -----------------------------------------------------------------------------------


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
        (
            Fault("move", FaultKind.SLOW),
            Fault("move(r1, hall)", FaultKind.ABORT, after=1, times=2, message="blocked", ignores_cancel=True),
        ),
        (
            HiddenChange(changes, at=2.0),
            HiddenChange({("p",): True}, moment="start", what="move(r1, hall)"),
            HiddenChange({("p",): True}, moment="end", what="move"),
        ),
    )
    assert read_faults(written(tmp_path, "faults:\nchanges:\n")) == Faults()


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


def test_a_fault_concerns_an_action_or_one_call_of_it() -> None:
    move, other = GroundAction("move", ("r1",)), GroundAction("move", ("r2",))
    assert [Fault("move", FaultKind.HANG).concerns(one) for one in (move, other)] == [True, True]
    assert [Fault("move(r1)", FaultKind.HANG).concerns(one) for one in (move, other)] == [True, False]
    change = HiddenChange({("p",): True}, moment="end", what="move(r1)")
    assert [change.follows("end", move), change.follows("start", move), change.follows("end", other)] == [True, False, False]


# --- the examples of the project --------------------------------------------------------------


def test_the_files_of_the_project_are_read(root: Path) -> None:
    bindings, faults = sorted(root.glob("domains/*/bindings.yaml")), sorted(root.glob("problems/*/faults.yaml"))
    assert bindings
    assert faults
    assert all(read_bindings(path).actions for path in bindings)
    assert all(read_faults(path) != Faults() for path in faults)


def test_an_absent_key_stands_where_its_mapping_does() -> None:
    top = Mapped("f", Position("f", 4, 2), {})
    assert (str(top.position("x")), top.plain("x"), top.string("x"), top.strings("x"), top.flag("x")) == ("f:4:2", None, None, [], False)
    assert (top.number("x", 1.5), top.whole("x", 3), top.mapping("x"), top.sequence("x")) == (1.5, 3, {}, [])
