"""The workshop's behaviour trees for BehaviorTree.CPP, on a world in this process: an interpreter of the nodes that they use.

A tree is read in the workshop's repository; it is not copied here. The workshop's executor ticks a tree all the time; here a node is
ticked until it has ended. What a `ReactiveSequence` asks first is asked again at every step of a drive, which is halted once it is not so.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from pyrobosim.core import World
from pyrobosim.utils.pose import Pose

from tests.support.e2e.household.simulator import asked, perform

ACTIONS: Final = {
    "Navigate": ("navigate", "target"),
    "Open": ("open", "target"),
    "Close": ("close", "target"),
    "PickObject": ("pick", "object"),
    "PlaceObject": ("place", "object"),
    "DetectObject": ("detect", "object"),
}
"""The type of each action, and the port for what it acts on."""
RENAMED: Final = {"hall_dining_closet": "hall_closet_dining"}
"""Hallways that PyRoboSim calls otherwise since version 5."""


class Halted(Exception):
    """An action that may not go on."""


class WorkshopTree:
    """The tree of a file, for the robot of a world."""

    def __init__(self, world: World, file: Path) -> None:
        self._world = world
        self._robot = robot = world.robots[0]
        self._trees = {tree.get("ID", ""): tree[0] for tree in ElementTree.parse(file).iter("BehaviorTree")}
        self._may_go_on: Callable[[], bool] = lambda: True
        set_pose = robot.set_pose

        def move(pose: Pose) -> None:
            robot.path_executor.cancel_execution = not self._may_go_on()
            set_pose(pose)

        robot.set_pose = move

    def run(self) -> bool:
        """Run the tree to its end and return whether it succeeds."""
        return self._tick(self._trees["MainTree"], {})

    def _tick(self, node: ElementTree.Element, board: dict[str, str]) -> bool:
        tick = partial(self._tick, board=board)
        ports = {key: board.get(text[1:-1], "") if text.startswith("{") else text for key, text in node.items()}
        match node.tag:
            case "Sequence":
                return all(map(tick, node))
            case "Fallback":
                return any(map(tick, node))
            case "RetryUntilSuccessful":
                return any(tick(node[0]) for _ in range(int(ports["num_attempts"])))
            case "IfThenElse":
                return tick(node[1] if tick(node[0]) else node[2])
            case "ReactiveSequence":
                before, self._may_go_on = self._may_go_on, lambda: all(map(tick, node[:-1]))
                try:
                    return tick(node[-1])
                except Halted:
                    return False
                finally:
                    self._may_go_on = before
            case "SubTree":
                return self._tick(self._trees[ports.pop("ID")], ports)
            case "IsBatteryFull":
                return bool(self._robot.battery_level >= float(ports["full_threshold"]))
            case "GetCurrentLocation":
                board[node.attrib["location"][1:-1]] = self._robot.location.name
                return True
            case action if action in ACTIONS:
                kind, port = ACTIONS[action]
                what = RENAMED.get(ports[port], ports[port])
                succeeds = self._may_go_on() and perform(self._world, asked(self._robot, kind, what)).is_success()
                if not succeeds and not self._may_go_on():
                    raise Halted
                return bool(succeeds)
        raise ValueError(f"the tree has a node {node.tag}, which this interpreter does not know")
