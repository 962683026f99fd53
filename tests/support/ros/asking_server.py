"""An action server that asks for knowledge as its goals tell it to. Run as a module.

Of a GroundAction goal the action says what to do, and the arguments, each a JSON text, with what:

    query LAYER NAME [META [TIMEOUT]]
    update LAYER NAME VALUE [META [TIMEOUT]]
    raise, return (something that is no result)

The message of the result is what came of it as JSON: the value in a list, an empty list, or the text of an error. It is
printed, too. Prints "ready" once it serves.
"""

from __future__ import annotations

import argparse
import json
from contextlib import suppress
from typing import Any

import rclpy
from pnm_interfaces.action import GroundAction
from rclpy.action import CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor

from pnm.core.logic.computed_values import MISSING, Layer
from pnm.ros.action_server import LIMIT, KnowledgeError, PnmActionServer, PnmSimpleActionServer
from tests.support.processes import say


class ExecuteCallbacks:
    """The execute callbacks of all kinds of servers."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.server: Any = None

    @property
    def callback(self) -> Any:
        return self.awaiting if self.kind == "coroutine" else self.wrong if self.kind == "wrong" else self.plain

    def plain(self, handle: Any) -> Any:
        own = () if self.kind == "simple" else (handle,)
        return self.end(handle, lambda does, *rest, **options: getattr(self.server, f"{does}_kb")(*own, *rest, **options))

    async def wrong(self, handle: Any) -> Any:
        return self.plain(handle)

    async def awaiting(self, handle: Any) -> Any:
        does, rest, options = self.wanted(handle)
        try:
            return self.said(handle, does, await getattr(self.server, f"{does}_kb_async")(handle, *rest, **options))
        except KnowledgeError as error:
            return self.said(handle, "error", str(error))

    def end(self, handle: Any, ask: Any) -> Any:
        if handle.request.action == "raise":
            raise RuntimeError("wheel came off")
        if handle.request.action == "return":
            return None
        does, rest, options = self.wanted(handle)
        try:
            return self.said(handle, does, ask(does, *rest, **options))
        except KnowledgeError as error:
            return self.said(handle, "error", str(error))

    def wanted(self, handle: Any) -> tuple[str, list[Any], dict[str, Any]]:
        layer, name, *rest = map(json.loads, handle.request.arguments)
        split = 0 if handle.request.action == "query" else 1
        options = dict(zip(("meta", "timeout"), rest[split:], strict=False))
        options["timeout"] = options.get("timeout", LIMIT)
        layers = [layer if isinstance(layer, int) else Layer(layer)]
        return handle.request.action, [*layers, name, *rest[:split]], options

    def said(self, handle: Any, does: str, found: Any) -> Any:
        message = json.dumps(found if does == "error" else [] if found is MISSING else [found])
        say(message)
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return GroundAction.Result(message=message)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("--kind", choices=("function", "coroutine", "simple", "wrong"), default="function")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node(f"knowing_{options.name}")
    knowing = ExecuteCallbacks(options.kind)
    kind = PnmSimpleActionServer if options.kind == "simple" else PnmActionServer
    knowing.server = kind(
        node,
        GroundAction,
        options.name,
        knowing.callback,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )
    executor = SingleThreadedExecutor() if options.threads == 1 else MultiThreadedExecutor(options.threads)
    executor.add_node(node)
    say("ready")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(0.5)  # `spin` sometimes sleeps through the signal that is to end it


if __name__ == "__main__":
    main()
