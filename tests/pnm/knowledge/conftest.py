"""Fixtures for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.logic.people import TerminalUser


@pytest.fixture
def person() -> Iterator[TerminalUser]:
    somebody = TerminalUser()
    yield somebody
    somebody.leave()
