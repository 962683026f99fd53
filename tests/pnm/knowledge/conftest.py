"""Fixtures for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.logic.people import TerminalUser
from tests.support.pddl.sensed_world import SENSING


@pytest.fixture
def person() -> Iterator[TerminalUser]:
    somebody = TerminalUser()
    yield somebody
    somebody.leave()


@pytest.fixture
def everything():
    return SENSING
