"""The action client of `rclpy`, as an oracle for ours."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from pnm_interfaces.action import GroundAction
from rclpy.action import ActionClient

from pnm.core.machine.requests import OutcomeKind
from pnm.ros.action_client.goal import OVER
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from tests.support.processes import LIMIT


class StockClient:
    """Sends GroundAction goals to one server that is there; what `rclpy` hears of them is awaited."""

    def __init__(self, ros: RosThread, server: str) -> None:
        self._ros = ros
        self._client: Any = ros.wait(lambda: ActionClient(ros.node, GroundAction, server))

    async def there(self) -> None:
        async with asyncio.timeout(LIMIT):
            while not await self._ros.ask(self._client.server_is_ready):  # noqa: ASYNC110 - the graph has no event
                await asyncio.sleep(0.02)

    async def outcome(self, goal: Mapping[str, Any], *, cancel: bool) -> tuple[bool, OutcomeKind, str]:
        """Send a goal, and cancel it when it is accepted; return whether it was accepted, and how it ended."""
        handle = await self._heard(lambda: self._client.send_goal_async(GroundAction.Goal(**goal)))
        if not handle.accepted:
            return False, OutcomeKind.REJECTED, ""
        if cancel:
            await self._heard(handle.cancel_goal_async)
        response = await self._heard(handle.get_result_async)
        return True, OVER[response.status], response.result.message

    async def _heard(self, ask: Callable[[], Any]) -> Any:
        loop = asyncio.get_running_loop()
        heard: asyncio.Future[Any] = loop.create_future()
        await self._ros.ask(lambda: ask().add_done_callback(lambda future: call_on_loop(loop, heard.set_result, future.result())))
        return await asyncio.wait_for(heard, LIMIT)

    def destroy(self) -> None:
        self._ros.wait(self._client.destroy)
