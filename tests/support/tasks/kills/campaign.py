"""A campaign: many scenarios, several at a time, until enough processes were killed."""

from __future__ import annotations

import gc
import multiprocessing
import tempfile
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from itertools import count
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Final

from tests.support.tasks.kills.disks import Disk
from tests.support.tasks.kills.instants import AtCommit
from tests.support.tasks.kills.lives import Verdict, judged
from tests.support.tasks.kills.scenario import Scenario, random_scenario

_EVERY: Final = 7
"""The number of the scenario whose processes are killed at every commit, none of whose robots fails."""

_ROS: Final = (
    *("rclpy", "rclpy.action", "rclpy.executors", "pnm_interfaces.action", "pnm_interfaces.msg", "pnm_interfaces.srv", "std_msgs.msg"),
    *("pnm.ros.node.ros_thread", "pnm.ros.node.lifecycle", "pnm.ros.tasks.task_node", "pnm.ros.tasks.executor_topics"),
    *("pnm.ros.node_client", "pnm.ros.action_client.action_services", "planner_bridge.cli.running_node", "planner_bridge.cli.running_node"),
)
"""What a node loads besides, and loads late."""


@dataclass
class Campaign:
    """What was done so far."""

    scenarios: int = 0
    kills: int = 0
    wrong: list[str] = field(default_factory=list)

    def add(self, name: str, verdict: Verdict) -> None:
        """Count a scenario."""
        self.scenarios += 1
        self.kills += verdict.kills
        if verdict.wrong:
            self.wrong.append("\n  ".join((name, *verdict.wrong)))


def random_kills(kills: int, jobs: int, first: int = 0) -> Campaign:
    """Carry out random scenarios, from this number on, until so many processes were killed."""
    campaign, numbers = Campaign(), count(first)
    with _pool(jobs) as pool:
        going_on: dict[Future[Verdict], int] = {}
        while going_on or campaign.kills < kills:
            while campaign.kills < kills and len(going_on) < 2 * jobs:
                number = next(numbers)
                going_on[pool.submit(_carried_out, random_scenario(number))] = number
            for future in wait(going_on, return_when=FIRST_COMPLETED).done:
                campaign.add(f"scenario {going_on.pop(future)}", future.result())
    return campaign


def kills_at_every_commit(jobs: int) -> Campaign:
    """Carry out one scenario again and again: its process dies before the first commit, after it, before the second, and so on."""
    campaign, scenario = Campaign(), random_scenario(_EVERY)
    with _pool(jobs) as pool:
        for first in count(1, jobs):
            scenarios = [replace(scenario, deaths=(AtCommit(commit, before=before),)) for commit, before in _boundaries(first, jobs)]
            verdicts = [*pool.map(_carried_out, scenarios)]
            for one, verdict in zip(scenarios, verdicts, strict=True):
                campaign.add(str(one.deaths[0]), verdict)
            if not any(verdict.kills for verdict in verdicts):  # the scenario has fewer commits
                return campaign
    raise AssertionError("it has a last commit")


def _boundaries(first: int, commits: int) -> Iterator[tuple[int, bool]]:
    for commit in range(first, first + commits):
        yield commit, True
        yield commit, False


def carried_out_on_a_disk(scenario: Scenario, folder: Path, disk: Disk) -> Verdict:
    """Carry out a scenario whose journal is on a disk."""
    with _pool(1) as pool:
        return pool.submit(judged, scenario, folder, disk).result()


def _carried_out(scenario: Scenario) -> Verdict:
    with tempfile.TemporaryDirectory() as folder:
        return judged(scenario, Path(folder))


def _pool(jobs: int) -> ProcessPoolExecutor:
    """Return processes that have loaded everything, and have no threads: the processes that are killed are copies of them."""
    return ProcessPoolExecutor(jobs, mp_context=forks(), initializer=gc.freeze)


def forks() -> ForkServerContext:
    """Return what makes copies of a process that has loaded everything."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "planner_bridge.cli.commands", "planner_bridge.node.serve", *_ROS])
    return context
