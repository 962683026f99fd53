"""Poses of places: from files and maps, and into the table of a file of bindings, of which all else stays as it is."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, strategies as st

from pnm.actions.bindings_file import read_bindings
from pnm.actions.pose_table import NavMap, Pose, read_map, read_poses, with_row
from pnm.core.machine.bindings import Table
from pnm.errors import InputError
from tests.support.files import input_error, written

BINDINGS = """# mine
actions:
  drive:
    goal:
      pose:
        of: "?to"
        table:   # decide
          hall: {pose: {position: {x: 1}}}   # the big one
          dock: {pose: {position: {x: 2}}}
    timeout: 60   # seconds
  grip: {goal: {object: "?c"}}
"""
ROW = Pose.turned(3.0, 4.0, math.pi).row


def test_a_row_is_put_last_or_in_place_of_that_there_is() -> None:
    added = with_row(BINDINGS, "b.yaml", "shelf", ROW)
    assert added == BINDINGS.replace("    timeout", f"          shelf: {ROW}\n    timeout")
    changed = with_row(BINDINGS, "b.yaml", "hall", ROW)
    assert changed == BINDINGS.replace("hall: {pose: {position: {x: 1}}}", f"hall: {ROW}"), "its comment stays"
    assert with_row(added, "b.yaml", "shelf", ROW) == added


def test_what_is_written_is_read_as_the_pose(tmp_path: Path) -> None:
    bindings = read_bindings(written(tmp_path / "b.yaml", with_row(BINDINGS, "b.yaml", "shelf", ROW)))
    table = (bindings.of("drive").goal or {})["pose"]
    assert isinstance(table, Table)
    assert table.rows["shelf"] == {
        "header": {"frame_id": "map"},
        "pose": {"position": {"x": 3.0, "y": 4.0}, "orientation": {"z": 1.0, "w": 0.0}},
    }


@pytest.mark.parametrize(
    ("text", "action", "said"),
    [
        (BINDINGS, "grip", "no goal field has a table of poses"),
        (BINDINGS, "drvie", "there is no binding of drvie; expected one of drive, grip"),
        ("actions: {go: {goal: {p: {of: '?to', table: {a: {pose: {}}, b: {pose: {}}}}}}}", "", "expected a line for each row"),
        ("actions:\n  go: {goal: {p: {of: '?to', table: {b: {pose: {}}}}}}", "", "expected a line for each row"),
    ],
)
def test_a_table_that_cannot_be_changed_line_by_line_is_refused(text: str, action: str, said: str) -> None:
    error = input_error(lambda: with_row(text, "b.yaml", "a", ROW, action))
    assert error is not None
    assert said in error.message


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3), st.integers(0, 199), st.integers(0, 99))
def test_the_middle_of_every_pixel_is_on_the_map_and_none_beside_it(x: float, y: float, yaw: float, column: int, row: int) -> None:
    found = NavMap(0.05, (x, y, yaw), 200, 100)
    assert found.has(*found.at(column, row))
    assert not found.has(*found.at(column + 200, row))
    assert not found.has(*found.at(column, row - 100))


def test_the_lower_left_pixel_is_at_the_origin() -> None:
    assert NavMap(0.1, (-1.0, 2.0, 0.0), 20, 10).at(0, 9) == pytest.approx((-0.95, 2.05))


PNG = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + struct.pack(">II", 20, 10)


@pytest.mark.parametrize("image", [b"P5\n# by SLAM\n20 10\n255\n", b"P2 20 10 255\n", PNG])
def test_maps_of_nav2_are_read(tmp_path: Path, image: bytes) -> None:
    written(tmp_path / "m.img", image)
    file = written(tmp_path / "m.yaml", "image: m.img\nresolution: 0.5\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n")
    assert read_map(file) == NavMap(0.5, (0.0, 0.0, 0.0), 20, 10)


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        ("shelf: [1.0]", "1:8: expected 2 or 3 numbers"),
        ("shelf: [1.0, near]", "1:8: expected 2 or 3 numbers"),
        ("shelf: [100, 1]", "1:8: shelf, at 100 m and 1 m, is not on the map"),
        ("shelf: {pixl: [1, 2]}", "unknown key 'pixl'; did you mean 'pixel'?"),
    ],
)
def test_a_pose_that_cannot_be_is_refused(tmp_path: Path, poses: str, said: str) -> None:
    file = written(tmp_path / "p.yaml", poses)
    with pytest.raises(InputError) as error:
        read_poses(file, NavMap(0.5, (0.0, 0.0, 0.0), 20, 10))
    assert said in str(error.value)


def test_a_pixel_needs_a_map(tmp_path: Path) -> None:
    error = input_error(lambda: read_poses(written(tmp_path / "p.yaml", "a: {pixel: [1, 2]}"), None))
    assert error is not None
    assert "expected --map" in error.message


@pytest.mark.parametrize("wrong", [{"x": math.nan}, {"y": math.inf}, {"frame": "map}}}\n dock: {"}, {"frame": "\x1b[31m"}, {"frame": ""}])
def test_what_is_no_pose_is_not_written(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected a pose"):
        Pose(**{"x": 0.0, "y": 0.0, **wrong})


def test_a_name_that_is_a_word_of_yaml_stays_a_name() -> None:
    assert yaml.safe_load(Pose(0.0, 0.0, frame="yes").row)["header"] == {"frame_id": "yes"}
    assert yaml.safe_load(Pose(0.0, 0.0, frame="0001").row)["header"] == {"frame_id": "0001"}
    text = "actions:\n  go:\n    goal:\n      pose:\n        of: to\n        table:\n          a: " + Pose(0.0, 0.0).row + "\n"
    written = yaml.safe_load(with_row(text, "b.yaml", "No", Pose(1.0, 0.0).row))
    assert [*written["actions"]["go"]["goal"]["pose"]["table"]] == ["a", "No"]
