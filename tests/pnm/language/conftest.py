"""Fixtures for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from pnm.language import HandWrittenPlan, read_plans
from tests.support.yaml.plan_reading import Read, ReadAll


@pytest.fixture
def read_all(tmp_path: Path) -> ReadAll:
    def read(text: str) -> dict[str, HandWrittenPlan]:
        path = tmp_path / "plan.yaml"
        path.write_text(text)
        return read_plans(path)

    return read


@pytest.fixture
def read(read_all: ReadAll) -> Read:
    def read(text: str) -> HandWrittenPlan:
        (plan,) = read_all(text).values()
        return plan

    return read
