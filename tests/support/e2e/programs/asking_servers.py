"""Action servers that ask, and change, what the run knows that has called them. Run as a module.

remember  stores its value as the local variable ``spam`` and the global one ``eggs``, and answers with what it then finds there
alarm     stores the local variable ``alarm``, and goes on until it is cancelled, or nobody has done that for 20 s
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

import rclpy
from pnm_interfaces.action import EstimateTime
from rclpy.action import CancelResponse
from rclpy.node import Node

from pnm.ros.action_server import KnowledgeError, PnmActionServer
from tests.support.processes import say_event
from tests.support.ros.child_process import spin


class KnowingServers(Node):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__("knowing_workers")
        accept = CancelResponse.ACCEPT
        self.server = PnmActionServer(self, EstimateTime, "remember", self.remember, cancel_callback=lambda _: accept)
        self.other = PnmActionServer(self, EstimateTime, "alarm", self.alarm, cancel_callback=lambda _: accept)

    def remember(self, goal: Any) -> Any:
        value = goal.request.value
        say_event("start", server="remember", value=value)
        self.server.update_kb(goal, PnmActionServer.UPDATE_LOCAL, "spam", value)
        self.server.update_kb(goal, PnmActionServer.UPDATE_GLOBAL, "eggs", value + 100)
        local = self.server.query_kb(goal, PnmActionServer.QUERY_ALL, "spam")
        shared = self.server.query_kb(goal, PnmActionServer.QUERY_GLOBAL, "eggs")
        say_event("found", server="remember", value=[local, shared])
        goal.succeed()
        return EstimateTime.Result(time=local)

    def alarm(self, goal: Any) -> Any:
        say_event("start", server="alarm", value=goal.request.value)
        with suppress(KnowledgeError):  # the goal may be cancelled before we hear that it is stored
            self.other.update_kb(goal, PnmActionServer.UPDATE_LOCAL, "alarm", True)
        pause = threading.Event()
        for _ in range(400):
            if goal.is_cancel_requested:
                say_event("cancelled", server="alarm", value=goal.request.value)
                goal.canceled()
                return EstimateTime.Result()
            pause.wait(0.05)
        say_event("end", server="alarm", value=goal.request.value)
        goal.succeed()
        return EstimateTime.Result()


def main() -> None:
    rclpy.init()
    spin(KnowingServers())


if __name__ == "__main__":
    main()
