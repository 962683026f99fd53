"""Fixtures for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.yaml.original import RunOriginal


@pytest.fixture
def run(tmp_path: Path) -> RunOriginal:
    return RunOriginal(tmp_path)
