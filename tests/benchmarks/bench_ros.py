"""Goals over ROS 2: ours beside a bare `rclpy.action.ActionClient`, as ratios. Not a test.

usage: python -m tests.benchmarks.bench_ros [rounds] [goals]

In turn, several times: a fresh server in a process of its own, a bare one of `rclpy` that succeeds at once; a client in another process
that keeps 1, 10 or 100 goals in flight. Goals a second, and CPU time of the client's process for each goal. The machine may be shared:
only the ratios count. ROS_DOMAIN_ID may be set.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from statistics import median
from typing import Any
from uuid import uuid4

import rclpy
from pnm_interfaces.action import GroundAction as Action
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, OutcomeKind, Report, Request
from pnm.ros.action_client.action_services import OtherGoals
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.node.ros_thread import RosThread
from tests.support.files import ROOT

RUN = (sys.executable, "-m", "tests.benchmarks.bench_ros")
IN_FLIGHT = (1, 10, 100)
WARM = 50
"""Goals before the clock starts: first contact, discovery."""
DEEP: dict[str, Any] = {f"{service}_service_qos_profile": QoSProfile(depth=1000) for service in ("goal", "result", "cancel")}
"""So that a hundred goals at once are not lost; by default services keep ten requests."""
PREFIX = b"node"
"""Of the ids of all goals of a node with a journal, which listens for those that it has forgotten."""


class Meter:
    """Counts the ends of goals, and what passes from the end of the first few to that of the last."""

    def __init__(self, goals: int) -> None:
        self.ended, self.sent, self._goals = 0, 0, goals
        self._begin = self._end = (0.0, 0.0)

    def end(self) -> None:
        self.ended += 1
        if self.ended == WARM:
            self._begin = time.perf_counter(), time.process_time()
        self._end = time.perf_counter(), time.process_time()

    def may_send(self) -> bool:
        """Return whether there is one more goal to send, and count it."""
        self.sent += 1
        return self.sent <= self._goals + WARM

    @property
    def is_over(self) -> bool:
        return self.ended >= self._goals + WARM

    def measured(self) -> tuple[float, float]:
        """Return goals a second, and milliseconds of CPU time for each."""
        seconds, cpu = (end - begin for begin, end in zip(self._begin, self._end, strict=True))
        return self._goals / seconds, 1000 * cpu / self._goals


def bare(server: str, in_flight: int, meter: Meter) -> None:
    rclpy.init()
    node = rclpy.create_node("bare")
    client, executor = ActionClient(node, Action, server, **DEEP), SingleThreadedExecutor()
    executor.add_node(node)
    client.wait_for_server()
    goal = Action.Goal(action="succeed")

    def send() -> None:
        if meter.may_send():
            client.send_goal_async(goal).add_done_callback(accepted)

    def accepted(future: Any) -> None:
        future.result().get_result_async().add_done_callback(ended)

    def ended(future: Any) -> None:
        assert future.result().status == 4
        meter.end()
        send()

    for _ in range(in_flight):
        send()
    while not meter.is_over:
        executor.spin_once()
    print(json.dumps(meter.measured()), flush=True)
    os._exit(0)


async def ours(server: str, in_flight: int, meter: Meter) -> None:
    async with RosThread("ours") as ros:
        others = OtherGoals(ros, PREFIX)
        client, over = (
            Ros2ActionClient(ros, Bindings({"act": Binding(server=server)}), asyncio.get_running_loop(), others=others),
            asyncio.Event(),
        )
        await client.prepare([GroundAction("act")], 30.0)
        await ros.settled()

        def send() -> None:
            if meter.may_send():
                client.send(Request(uuid4(), GroundAction("act"), {"action": "succeed"}), hear)

        def hear(report: Report) -> None:
            if isinstance(report, Ended):
                assert report.outcome.kind is OutcomeKind.SUCCEEDED, report
                meter.end()
                send()
                if meter.is_over:
                    over.set()

        for _ in range(in_flight):
            send()
        await over.wait()
        print(json.dumps(meter.measured()), flush=True)
        client.close()


def serve(name: str) -> None:
    rclpy.init()
    node = rclpy.create_node("server")

    def succeed(handle: Any) -> Any:
        handle.succeed()
        return Action.Result()

    ActionServer(node, Action, name, succeed, **DEEP)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    executor.spin()


def measured(who: str, in_flight: int, goals: int) -> tuple[float, float]:
    """Return what one client of a fresh server achieves."""
    name = f"server{uuid4().hex[:8]}"
    server = subprocess.Popen([*RUN, "serve", name], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        client = [*RUN, who, name, str(in_flight), str(goals)]
        rate, cpu = json.loads(subprocess.run(client, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=300).stdout)
        return rate, cpu
    finally:
        server.kill()
        server.wait()


def compared(rounds: int, goals: int) -> None:
    print(f"in flight  {'goals a second':^34}  {'ms CPU a goal':^34}")
    for in_flight in IN_FLIGHT:
        pairs = [(measured("bare", in_flight, goals), measured("ours", in_flight, goals)) for _ in range(rounds)]
        cells = []
        for number in (0, 1):
            rival, own = (median(pair[side][number] for pair in pairs) for side in (0, 1))
            ratio = median(pair[1][number] / pair[0][number] for pair in pairs)
            cells.append(f"bare {rival:6.2f}  ours {own:6.2f}  {ratio:5.2f} ×")
        print(f"{in_flight:9}  {'  '.join(cells)}", flush=True)


def main(arguments: list[str]) -> None:
    match arguments:
        case ["serve", name]:
            serve(name)
        case ["bare", name, in_flight, goals]:
            bare(name, int(in_flight), Meter(int(goals)))
        case ["ours", name, in_flight, goals]:
            asyncio.run(ours(name, int(in_flight), Meter(int(goals))))
        case ["measured", who, in_flight, goals]:
            print(json.dumps(measured(who, int(in_flight), int(goals))))
        case _:
            rounds, goals = (*map(int, arguments), 5, 500)[:2] if len(arguments) < 2 else map(int, arguments)
            compared(rounds, goals)


if __name__ == "__main__":
    main(sys.argv[1:])
