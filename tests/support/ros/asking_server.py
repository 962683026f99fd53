"""Action servers that ask for knowledge as their goals tell them to. Run as a module: NAME [THREADS]

The execute callback is a function for the server NAME, a coroutine for NAME_coroutine, a coroutine that waits for NAME_wrong. The
example of `pnm.ros.action_server.python_server` is there as well.

Of a GroundAction goal the action says what to do, and the arguments, each a JSON text, with what:

    query LAYER NAME [META [TIMEOUT]]
    update LAYER NAME VALUE [META [TIMEOUT]]
    raise, return (something that is no result)

The message of the result is what came of it as JSON: the value in a list, an empty list, or the text of an error. It is
printed, too.
"""

from __future__ import annotations

import json
import sys
import textwrap
from typing import Any

import rclpy
from pnm_interfaces.action import GroundAction
from rclpy.action import CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from pnm.core.logic.computed_values import MISSING, Layer
from pnm.ros.action_server import LIMIT, KnowledgeError, PnmActionServer, python_server
from tests.support.processes import say
from tests.support.ros.child_process import spin


class ExecuteCallbacks:
    """The execute callbacks of all kinds of servers, by kind."""

    server: Any

    def function(self, handle: Any) -> Any:
        if handle.request.action == "raise":
            raise RuntimeError("wheel came off")
        if handle.request.action == "return":
            return None
        does, rest, options = self.wanted(handle)
        try:
            return self.said(handle, does, getattr(self.server, f"{does}_kb")(handle, *rest, **options))
        except KnowledgeError as error:
            return self.said(handle, "error", str(error))

    async def wrong(self, handle: Any) -> Any:
        return self.function(handle)

    async def coroutine(self, handle: Any) -> Any:
        does, rest, options = self.wanted(handle)
        try:
            return self.said(handle, does, await getattr(self.server, f"{does}_kb_async")(handle, *rest, **options))
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


def serve(node: Any, name: str, kind: str) -> None:
    """Offer a server of a kind."""
    callbacks = ExecuteCallbacks()
    callbacks.server = PnmActionServer(
        node,
        GroundAction,
        name,
        getattr(callbacks, kind),
        cancel_callback=lambda _: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )


def example() -> Any:
    """The node of the documentation."""
    paragraphs = (python_server.__doc__ or "").split("\n\n")
    names: dict[str, Any] = {"Node": Node, "GroundAction": GroundAction, "PnmActionServer": PnmActionServer}
    exec(textwrap.dedent("\n\n".join(part for part in paragraphs if part.startswith("    "))), names)
    return names["Guide"]()


def main(name: str, threads: str = "1") -> None:
    rclpy.init()
    node = rclpy.create_node(f"knowing_{name}")
    serve(node, name, "function")
    for kind in ("coroutine", "wrong"):
        serve(node, f"{name}_{kind}", kind)
    spin(node, example(), threads=int(threads))


if __name__ == "__main__":
    main(*sys.argv[1:])
