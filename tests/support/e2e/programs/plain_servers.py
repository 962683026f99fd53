"""Action servers that know nothing of this project: plain `rclpy`. Run as a module, with the names of those wanted.

    dummy_server  answers with the time that it was given as a value
    add_one       answers with one more than the value
    broken        aborts
    wait          waits; until it is cancelled if that takes longer than a minute
    stubborn      the same, but cannot be cancelled
    four_waits    is called wait, too, and lets its goals go when four of them are there at the same time

Each says what it does: what servers say of goals is the truth.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from pnm_interfaces.action import EstimateTime, Wait
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup

from tests.support.processes import say_event
from tests.support.ros.child_process import spin


def answering(server: str, more: int) -> Callable[[Any], Any]:
    def execute(handle: Any) -> Any:
        say_event("start", server=server, value=handle.request.value)
        say_event("end", server=server, value=handle.request.value)
        handle.succeed()
        return EstimateTime.Result(time=handle.request.value + more)

    return execute


def broken(handle: Any) -> Any:
    say_event("start", server="broken", value=handle.request.value)
    handle.abort()
    return EstimateTime.Result(time=99)


class Waiting:
    """Goals that wait, each for its own time."""

    def __init__(self, server: str) -> None:
        self.server = server

    def __call__(self, handle: Any) -> Any:
        time = handle.request.time
        say_event("start", server=self.server, value=time)
        pause = threading.Event()
        for _ in range(int(time / 0.05) if time <= 60 else 10**6):
            if handle.is_cancel_requested:
                say_event("cancelled", server=self.server, value=time)
                handle.canceled()
                return Wait.Result()
            pause.wait(0.05)
        say_event("end", server=self.server, value=time)
        handle.succeed()
        return Wait.Result()


class FourWaits:
    """Goals that meet."""

    def __init__(self) -> None:
        self.all_there = threading.Barrier(4)

    def __call__(self, handle: Any) -> Any:
        say_event("start", server="wait", value=handle.request.time)
        self.all_there.wait(60.0)
        say_event("end", server="wait", value=handle.request.time)
        handle.succeed()
        return Wait.Result()


KNOWN: dict[str, tuple[str, Any, Callable[[Any], Any]]] = {
    "dummy_server": ("dummy_server", EstimateTime, answering("dummy_server", 0)),
    "add_one": ("add_one", EstimateTime, answering("add_one", 1)),
    "broken": ("broken", EstimateTime, broken),
    "wait": ("wait", Wait, Waiting("wait")),
    "stubborn": ("stubborn", Wait, Waiting("stubborn")),
    "four_waits": ("wait", Wait, FourWaits()),
}


def accept(_: Any) -> CancelResponse:
    return CancelResponse.ACCEPT


def refuse(_: Any) -> CancelResponse:
    return CancelResponse.REJECT


def main(*names: str) -> None:
    rclpy.init()
    node = rclpy.create_node(f"workers_{'_'.join(names)}")
    group = ReentrantCallbackGroup()
    for wanted in names:
        name, kind, execute = KNOWN[wanted]
        ActionServer(node, kind, name, execute, callback_group=group, cancel_callback=refuse if name == "stubborn" else accept)
    spin(node, threads=8)


if __name__ == "__main__":
    main(*sys.argv[1:])
