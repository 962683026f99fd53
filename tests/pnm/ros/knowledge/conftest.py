"""Fixtures for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.support.ros.child_process import ChildProcess


@pytest.fixture(scope="module")
def server(names: Callable[[], str]) -> Iterator[str]:
    """A server whose callback is a function and whose executor has one thread."""
    name = names()
    process = ChildProcess("asking_server", name)
    yield name
    process.kill()
