"""Fixtures for the tests of this folder."""

from __future__ import annotations

import pytest

from tests.support.yaml.original import RunOriginal


@pytest.fixture
def run() -> RunOriginal:
    return RunOriginal()
