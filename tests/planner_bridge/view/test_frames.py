"""Frames: whoever applies them one by one has the whole state, whatever was done, and wherever they begin."""

from __future__ import annotations

import copy
import json
import random
from pathlib import Path
from typing import Any

import pytest

from planner_bridge.view.app import frame
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import View, view_of
from pnm.journal import journal as journal_module
from tests.support.tasks.scenarios.random_scenarios import run_scenario


def applied(state: dict[str, Any], received: dict[str, Any]) -> dict[str, Any]:
    """Apply a frame as the page does."""
    parts: dict[str, dict[str, Any]] = {} if received["is_whole"] else copy.copy(state["parts"])
    for part, changes in received["parts"].items():
        things = {**parts.get(part, {}), **changes}
        parts[part] = {key: thing for key, thing in things.items() if thing is not None}
    return {**received, "is_whole": True, "parts": {part: things for part, things in parts.items() if things}}


def views(journal: Path) -> list[View]:
    """The views after every record."""
    reader = Reader(journal)
    found = [reader.at(number, view_of) for number in range(1, reader.newest().number + 1)]
    return [view for view in found if view is not None]


@pytest.mark.parametrize("number", [1, 3, 34])  # in the last one runs succeed others
def test_frames_one_by_one_are_the_whole_state_after_every_record(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", 60)  # so that segments begin now and then
    run_scenario(number, journal=tmp_path / "journal")
    shown = views(tmp_path / "journal")
    assert len(shown) > 10
    state, seen = {"parts": dict[str, Any]()}, None
    slow = random.Random(number).choices(shown, k=20)  # one that misses most of them, and goes back and forth
    for view in (*shown, *slow):
        state = applied(state, json.loads(json.dumps(frame(seen, view), allow_nan=False)))
        assert state == json.loads(json.dumps(frame(None, view)))
        seen = view
    # what is shown after a record does not depend on what was read before
    assert Reader(tmp_path / "journal").newest() == shown[-1]
    for view in slow[:6]:
        assert Reader(tmp_path / "journal").at(view.number, view_of) == view
