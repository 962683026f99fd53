"""The example of `pnm.ros.action_server.python_server` as a process. Run as a module; prints "ready" once it serves."""

from __future__ import annotations

import textwrap
from contextlib import suppress
from typing import Any

import rclpy
from pnm_interfaces.action import GroundAction
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from pnm.ros.action_server import python_server as action_server
from tests.support.processes import say


def main() -> None:
    paragraphs = (action_server.__doc__ or "").split("\n\n")
    names: dict[str, Any] = {"Node": Node, "GroundAction": GroundAction, "PnmActionServer": action_server.PnmActionServer}
    exec(textwrap.dedent("\n\n".join(part for part in paragraphs if part.startswith("    "))), names)
    rclpy.init()
    guide = names["Guide"]()
    say("ready")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(guide)


if __name__ == "__main__":
    main()
