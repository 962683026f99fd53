"""PyRoboSim's simulator without a window: its worlds, what it says of them, and its task actions, as plain data."""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import yaml
from pyrobosim.core import Robot, World
from pyrobosim.core.yaml_utils import WorldYamlLoader
from pyrobosim.navigation import execution, rrt
from pyrobosim.planning.actions import ExecutionResult, TaskAction
from pyrobosim.utils.pose import Pose

WORLDS: Final = Path(__file__).parent / "worlds"
CHANCES_AND_USAGES: Final = {
    "navigate": (0.9, 0.5),
    "pick": (0.5, 5.0),
    "place": (0.5, 5.0),
    "open": (0.75, 8.0),
    "close": (0.75, 8.0),
    "detect": (0.8, 0.0),
}
"""How likely each action succeeds, and how much of the battery it uses; navigating, for a metre."""
AT_ONCE: Final = -1.0
"""The real-time factor of a robot that does not take its time."""


def load_world(problem: int, seed: int, folder: Path | None = None) -> World:
    """Load the world of a problem, in which everything that happens by chance follows from the seed.

    Args:
        folder: with the workshop's own worlds, world1.yaml and so on; by default the house of this project.
    """
    for name in ("pyrobosim", "robot", "house", f"delib_ws_problem_{problem}"):
        logging.getLogger(name).disabled = True
    np.random.seed(seed)
    world = WorldYamlLoader().from_file(folder / f"world{problem}.yaml") if folder else WorldYamlLoader().from_yaml(_house(problem), WORLDS)
    for robot in world.robots:
        for position, options in enumerate(robot.action_execution_options.values()):
            options.rng = np.random.default_rng([seed, position])
    return world


def _house(problem: int) -> dict[str, Any]:
    """Return the house as it is in a problem: doors are shut in the second, chance comes with the third, a battery with the fourth."""
    house = yaml.safe_load((WORLDS / "house.yaml").read_text(encoding="utf-8"))
    if problem > 1:
        for hallway in house["hallways"]:
            hallway["is_open"] = {hallway["room_start"], hallway["room_end"]} in ({"dining", "office"}, {"dining", "kitchen"})
        for furniture in house["locations"]:
            furniture["is_open"] = furniture["name"] not in ("dumpster", "fridge", *(("pantry",) if problem > 2 else ()))
    if problem > 2:
        for robot in house["robots"]:
            robot["action_execution_options"] = {
                action: {"success_probability": chance, "battery_usage": usage if problem > 3 else 0.0}
                for action, (chance, usage) in CHANCES_AND_USAGES.items()
            }
    return house


def drive_times(problem: int, folder: Path | None = None, *, rounds: int) -> dict[tuple[str, str], float]:
    """Return the mean seconds of so many drives there and back between the places of a problem's world, dining room doors open.

    Paths are found by chance, so one drive may take half as long again as another. Shut doors are left out: from these, it depends on the
    side where the robot stands.
    """
    world = load_world(problem, 0, folder)
    (robot,) = world.robots
    for options in robot.action_execution_options.values():
        options.success_probability, options.battery_usage = 1.0, 0.0
    for hallway in world.hallways:
        if "dining" in hallway.name and not hallway.is_open:
            world.open_location(hallway)
    work, times, doors = counted(world), dict[tuple[str, str], float](), [hallway for hallway in world.hallways if hallway.is_open]
    with without_waiting():
        for one, other in combinations([place.name for place in (*world.rooms, *doors, *world.locations)], 2):
            perform(world, asked(robot, "navigate", one))
            before = work.driving
            for place in (other, one) * rounds:
                perform(world, asked(robot, "navigate", place))
            times[one, other] = times[other, one] = (work.driving - before) / (2.0 * rounds)
    return times


@contextmanager
def without_waiting() -> Iterator[None]:
    """Have robots not wait while they drive, and plan their paths without copies of whole trees. What happens is the same."""
    execution.time = SimpleNamespace(time=time.time, sleep=lambda seconds: None)
    rrt.copy = SimpleNamespace(deepcopy=copy.copy)  # of a node that is given another parent at once; its old one is not looked at
    try:
        yield
    finally:
        execution.time, rrt.copy = time, copy


def perform(world: World, action: Mapping[str, Any], realtime_factor: float = AT_ONCE) -> ExecutionResult:
    """Have a robot perform an action, given the fields of a `pyrobosim_msgs/msg/TaskAction`."""
    robot = world.get_robot_by_name(action["robot"])
    wanted = {name: action.get(name) or None for name in ("robot", "object", "room", "source_location", "target_location")}
    return robot.execute_action(TaskAction(action["type"], **wanted), realtime_factor)


def asked(robot: Robot, kind: str, what: str) -> dict[str, str]:
    """Return the fields of an action of a robot with a place or a thing."""
    return {"robot": robot.name, "type": kind, "object": what, "target_location": what}


@dataclass
class Work:
    """What the robots of a world have done since somebody keeps count.

    Attributes:
        actions: how many, attempts that failed included.
        driving: seconds at the speed of each robot, whatever the clock says.
        battery: the lowest that one of them ever had, in per cent.
    """

    actions: int = 0
    driving: float = 0.0
    battery: float = 100.0


def counted(world: World) -> Work:
    """Keep count of what the robots of a world do from now on."""
    work = Work()

    def keep_count(robot: Robot) -> None:
        execute_action, set_pose = robot.execute_action, robot.set_pose

        def act(action: TaskAction, realtime_factor: float = 1.0) -> ExecutionResult:
            result = execute_action(action, realtime_factor)
            work.actions += 1
            work.battery = min(work.battery, robot.battery_level)
            return result

        def move(pose: Pose) -> None:
            work.driving += robot.get_pose().get_linear_distance(pose) / robot.path_executor.linear_velocity
            set_pose(pose)

        robot.execute_action, robot.set_pose = act, move

    for robot in world.robots:
        keep_count(robot)
    return work


def robot_state(robot: Robot) -> dict[str, Any]:
    """Return the state of a robot, in the fields of a `pyrobosim_msgs/msg/RobotState` but for its pose."""
    return {
        "name": robot.name,
        "battery_level": float(robot.battery_level),
        "executing_action": robot.executing_action,
        "holding_object": robot.manipulated_object is not None,
        "manipulated_object": robot.manipulated_object.name if robot.manipulated_object else "",
        "last_visited_location": robot.location.name if robot.location else "",
    }


def world_state(world: World) -> dict[str, Any]:
    """Return the state of a world, in the fields of a `pyrobosim_msgs/msg/WorldState` but for poses."""
    return {
        "robots": [robot_state(robot) for robot in world.robots],
        "locations": [
            {
                "name": location.name,
                "category": location.category,
                "spawns": [spawn.name for spawn in location.children],
                "parent": location.get_room_name(),
                "is_open": location.is_open,
                "is_locked": location.is_locked,
            }
            for location in world.locations
        ],
        "hallways": [
            {
                "name": hallway.name,
                "room_start": hallway.room_start.name,
                "room_end": hallway.room_end.name,
                "is_open": hallway.is_open,
                "is_locked": hallway.is_locked,
            }
            for hallway in world.hallways
        ],
        "objects": [{"name": item.name, "category": item.category, "parent": item.parent.name} for item in world.objects],
    }


def has_reached(world: World, problem: int) -> bool:
    """Return whether the goal of the workshop's problem is so, by the simulator's own state."""

    def is_in(place: str, *items: str) -> bool:
        return all(world.get_object_by_name(item).parent.name == place for item in items)

    def is_shut(*places: str) -> bool:
        return not any(world.get_location_by_name(place).is_open for place in places)

    is_tidy = is_in("dumpster_disposal", "waste0", "waste1") and is_shut("dumpster")
    is_laid = is_in("table_tabletop", "bread0", "butter0") and is_shut("fridge", "pantry")
    is_powered = all(robot.battery_level > 0 for robot in world.robots)
    return {1: is_in("table_tabletop", "snacks0"), 2: is_tidy, 3: is_laid, 4: is_tidy and is_laid and is_powered}[problem]
