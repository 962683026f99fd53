"""Fixtures for the tests of this folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import Sensing
from tests.support.pddl.sensed_world import PROBLEM


@pytest.fixture
def sensing(tmp_path: Path) -> Callable[[str], Sensing]:
    def read(text: str) -> Sensing:
        (tmp_path / "sensing.yaml").write_text(text)
        return read_sensing(tmp_path / "sensing.yaml", PROBLEM.vocabulary)

    return read


@pytest.fixture
def sensors(begin) -> Callable[..., object]:
    return lambda *which: begin("sensors", *map(json.dumps, which))
