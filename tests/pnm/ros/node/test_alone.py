"""Nodes of the same name."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

import pytest

from pnm.errors import RosError
from pnm.ros.node.lifecycle import check_alone
from pnm.ros.node.ros_thread import RosThread


@pytest.mark.parametrize("count", [2, 3])
def test_of_nodes_that_start_at_the_same_time_the_first_goes_on(count):
    async def main():
        with ExitStack() as cleanup:
            nodes = [RosThread("twin", namespace=f"twins{count}", managed=True) for _ in range(count)]
            for node in nodes:
                cleanup.callback(node.close)
            return await asyncio.gather(*(check_alone(node, ()) for node in nodes), return_exceptions=True)

    first, *others = asyncio.run(main())
    assert first is None
    assert [type(other) for other in others] == [RosError] * (count - 1)
    assert f"there is a node /twins{count}/twin already" in str(others[0])
