"""Files of faults: what is refused, with which words and where, and what is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange, ground_name, read_faults
from pnm.errors import Position
from pnm.files.yaml_nodes import Mapped
from tests.support.files import refused, written
from tests.support.runs.files import WORDS, error

BAD_INPUT = Path(__file__).with_name("refused")


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


def test_the_files_of_the_project_are_read(root: Path) -> None:
    bindings, faults = sorted(root.glob("domains/*/bindings.yaml")), sorted(root.glob("problems/*/faults.yaml"))
    assert bindings
    assert faults
    assert all(read_bindings(path).actions for path in bindings)
    assert all(read_faults(path) != Faults() for path in faults)


def test_an_absent_key_stands_where_its_mapping_does() -> None:
    top = Mapped("f", Position("f", 4, 2), {})
    assert (str(top.position("x")), top.plain("x"), top.string("x"), top.strings("x"), top.flag("x")) == ("f:4:2", None, None, [], False)
    assert (top.number("x", 1.5), top.whole("x", 3), top.section("x").nodes, top.sequence("x")) == (1.5, 3, {}, [])
