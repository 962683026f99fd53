"""Fixtures for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pnm.ros.node.ros_thread import RosThread
from tests.support.ros.serving_node import NUMBERS


@pytest.fixture
def two() -> Iterator[tuple[RosThread, RosThread]]:
    """A node and another for its client, in a namespace that nobody else has: what was there before is remembered for a while."""
    namespace = f"tasks{next(NUMBERS)}"
    threads = RosThread("pnm", namespace=namespace), RosThread("client", namespace=namespace)
    yield threads
    assert all(thread.close() for thread in threads)
