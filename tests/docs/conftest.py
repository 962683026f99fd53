"""Fixtures for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.yaml.original import Run


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path)
