"""A newcomer's own fleet, from the built wheel: two robots with three servers each, a door and batteries, and all that goes wrong.

Wrong names are found before anything moves; lies, a shut door, a flat battery and an unplugged robot while the fleet works.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.e2e.deployment import RosDomain
from tests.support.e2e.newcomer.installed import Installed, installed
from tests.support.processes import Program, ros_domain

DOMAIN = """
(define (domain mine)
  (:requirements :adl :durative-actions :numeric-fluents)
  (:types robot place)
  (:predicates (at ?r - robot ?p - place) (free ?r - robot) (has_sample ?r - robot) (lab_door))
  (:functions (battery ?r - robot))
  (:durative-action navigate
    :parameters (?robot - robot ?from ?to - place)
    :duration (= ?duration 1)
    :condition (and (at start (free ?robot)) (at start (at ?robot ?from)) (at start (not (= ?to lab)))
      (over all (> (battery ?robot) 0.2)))
    :effect (and (at start (not (free ?robot))) (at start (not (at ?robot ?from))) (at end (free ?robot)) (at end (at ?robot ?to))))
  (:durative-action enter
    :parameters (?robot - robot)
    :duration (= ?duration 1)
    :condition (and (at start (free ?robot)) (at start (at ?robot hall)) (over all (lab_door)) (over all (> (battery ?robot) 0.2)))
    :effect (and (at start (not (free ?robot))) (at start (not (at ?robot hall))) (at end (free ?robot)) (at end (at ?robot lab))))
  (:durative-action grip
    :parameters (?robot - robot)
    :duration (= ?duration 1)
    :condition (and (at start (free ?robot)) (over all (at ?robot lab)))
    :effect (and (at start (not (free ?robot))) (at end (free ?robot)) (at end (has_sample ?robot)))))
""".replace("(:types robot place)", "(:types robot place)\n  (:constants store hall lab - place)")
PROBLEM = """
(define (problem first)
  (:domain mine)
  (:objects r1 r2 - robot)
  (:init (free r1) (free r2))
  (:goal (exists (?r - robot) (has_sample ?r))))
"""
ROW = "{header: {frame_id: map}, pose: {position: {x: %s, y: %s}, orientation: {w: 1.0}}}"
BINDINGS = f"""
actions:
  navigate:
    server: "/{{robot}}/navigate"
    type: porter_msgs/action/NavigateToPose
    goal: {{pose: {{of: "?to", table: {{store: {ROW % (0, 0)}, hall: {ROW % (4, 0)}, lab: {ROW % (8, 2)}}}}}}}
    success: {{field: error_code, eq: NONE}}
    reason: error_msg
    timeout: 30
  enter:
    server: "/{{robot}}/enter"
    type: porter_msgs/action/NavigateToPose
    goal: {{pose: {ROW % (8, 2)}}}
    success: {{field: error_code, eq: NONE}}
    reason: error_msg
    timeout: 30
  grip:
    server: "/{{robot}}/gripper"
    type: porter_msgs/action/Grip
    goal: {{object: sample, close: true}}
    success: {{field: code, eq: DONE}}
    reason: message
    timeout: 30
"""
SENSING = """
sensors:
  - topic: /{robot}/place
    type: std_msgs/msg/String
    for: {robot: robot}
    stale: 10
    lag: 2
    facts:
      - fact: (at ?robot ?value)
        field: data
  - topic: /{robot}/battery
    type: std_msgs/msg/Float32
    for: {robot: robot}
    stale: 10
    facts:
      - number: (battery ?robot)
        field: data
  - topic: /lab_door
    type: std_msgs/msg/Bool
    stale: 10
    facts:
      - fact: (lab_door)
        when: {field: data, eq: true}
"""
LINES = f"""
actions:
  navigate:
    goal:
      pose:
        of: "?to"   # where it goes
        table:
          store: {ROW % (1, 1)}   # by the door
          hall:  {ROW % (4, 0)}
# the end
"""
FILES = {"domain.pddl": DOMAIN, "problem.pddl": PROBLEM, "bindings.yaml": BINDINGS, "sensing.yaml": SENSING}
READ = ["domain.pddl", "problem.pddl", "--sensing", "sensing.yaml"]


@dataclass
class Newcomer:
    """A person with two robots of a domain of their own."""

    project: Installed
    domain: RosDomain
    world: Path

    def pnm(self, *arguments: str) -> Any:
        return self.project.pnm(*arguments, environment=self.domain.environment)

    def run(self) -> tuple[int, dict[str, Any]]:
        done = self.pnm("run", *READ, "--actions", "ros2", "--json", "--replans", "6")
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout.splitlines()[-1])

    def robots(self, **told: Any) -> list[Program]:
        """Turn both robots on, in the store, in a world where this happens."""
        self.world.write_text(json.dumps({name.replace("_", "/", 1): value for name, value in told.items()}))
        started = [self.domain.start(Program(["-m", PROGRAM, name, str(self.world)], self.domain.environment)) for name in ("r1", "r2")]
        return [robot.ready() for robot in started]


PROGRAM = "tests.support.e2e.newcomer.fleet"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return installed(tmp_path_factory.mktemp("installed"))


@pytest.fixture
def newcomer(project: Installed, tmp_path: Path) -> Iterator[Newcomer]:
    for name, text in FILES.items():
        (project.folder / name).write_text(text)
    with ros_domain() as number:
        domain = RosDomain(tmp_path, number, quick=True)
        try:
            yield Newcomer(project, domain, tmp_path / "world.json")
        finally:
            domain.close()


def named(result: dict[str, Any]) -> str:
    """All that is said of failures."""
    return json.dumps(result)


def test_the_demonstration_and_a_template_run_outside_of_the_source_tree(project: Installed) -> None:
    assert project.pnm("demo").returncode == 0
    assert project.pnm("init", "world", "--template", "two-robots-door-battery").returncode == 0
    done = project.pnm("run", "world/domain.pddl", "world/problem.pddl", "--improve", "0")
    assert (done.returncode, "goal     holds" in done.stdout) == (0, True), done.stdout + done.stderr


def test_the_fleet_is_found_described_checked_and_reaches_its_goal(newcomer: Newcomer) -> None:
    newcomer.robots()
    found = newcomer.pnm("init", "found")
    assert found.returncode == 0, found.stderr
    bindings = (newcomer.project.folder / "found" / "bindings.yaml").read_text()
    assert {f'server: "/{{robot}}/{name}"' in bindings for name in ("navigate", "enter", "gripper")} == {True}
    ready = newcomer.pnm("check", *READ)
    assert ready.returncode == 0, ready.stdout + ready.stderr
    status, result = newcomer.run()
    assert (status, result["goal_reached"], result["failures"]) == (0, True, []), result


def test_poses_come_from_where_the_robot_is_and_from_a_file_with_a_map(newcomer: Newcomer) -> None:
    newcomer.robots()
    folder = newcomer.project.folder
    (folder / "poses.yaml").write_text(LINES)
    several = newcomer.pnm("pose", "add", "depot", "--bindings", "poses.yaml")
    assert (several.returncode, "/r1/amcl_pose, /r1/pose, /r2/amcl_pose" in several.stderr) == (2, True), several.stderr
    added = newcomer.pnm("pose", "add", "depot", "--topic", "/r1/pose", "--bindings", "poses.yaml")
    assert added.returncode == 0, added.stderr
    row = "{header: {frame_id: map}, pose: {position: {x: 0.000, y: 0.000}, orientation: {z: 0.0000, w: 1.0000}}}"
    assert (folder / "poses.yaml").read_text() == LINES.replace("# the end", f"          depot: {row}\n# the end")
    latched = newcomer.pnm("pose", "add", "store", "--topic", "/r2/amcl_pose", "--bindings", "poses.yaml")
    assert latched.returncode == 0, latched.stderr
    assert f"store: {row}   # by the door\n" in (folder / "poses.yaml").read_text()
    (folder / "map.pgm").write_bytes(b"P5\n# a comment\n200 100\n255\n")
    (folder / "map.yaml").write_text("image: map.pgm\nresolution: 0.1\norigin: [-1.0, -1.0, 0.0]\n")
    (folder / "places.yaml").write_text("hall: [4.0, 0.0, 1.5708]\nlab: {pixel: [90, 69]}\n")
    assert newcomer.pnm("init", "posed", "--poses", "places.yaml", "--map", "map.yaml").returncode == 0
    texts = {name: (folder / "posed" / name).read_text() for name in ("bindings.yaml", "problem.pddl")}
    assert "hall: {header: {frame_id: map}, pose: {position: {x: 4.000, y: 0.000}, orientation: {z: 0.7071" in texts["bindings.yaml"]
    assert "lab: {header: {frame_id: map}, pose: {position: {x: 8.050, y: 2.050}" in texts["bindings.yaml"]
    assert "hall lab - place" in texts["problem.pddl"]
    assert newcomer.pnm("check", "posed/domain.pddl", "posed/problem.pddl").returncode == 0


def test_wrong_names_types_and_fields_are_found_before_anything_moves(newcomer: Newcomer) -> None:
    robots = newcomer.robots()
    wrong = {
        "  enter:": ("  entre:", "enter"),
        "/{robot}/gripper": ("/{robot}/griper", "/r1/gripper"),
        "action/Grip\n": ("action/Gripp\n", "Gripp"),
        "object: sample": ("objekt: sample", "object"),
        "eq: DONE": ("eq: DOEN", "DONE"),
    }
    for right, (written, said) in wrong.items():
        (newcomer.project.folder / "bindings.yaml").write_text(BINDINGS.replace(right, written))
        checked = newcomer.pnm("check", *READ)
        assert checked.returncode in (1, 2), right
        assert said in checked.stdout + checked.stderr, checked.stdout + checked.stderr
    (newcomer.project.folder / "bindings.yaml").write_text(BINDINGS)
    assert [robot.objects() for robot in robots] == [[], []]


def test_the_other_robot_goes_where_one_lies_or_has_no_battery(newcomer: Newcomer) -> None:
    robots = newcomer.robots(r1_lies=True)
    status, result = newcomer.run()
    assert (status, result["goal_reached"]) == (0, True), result
    assert not any(event.get("grips") for event in robots[0].objects())
    assert any(event.get("grips") for event in robots[1].objects())
    if any(event["is"] != event["says"] for event in robots[0].objects() if "says" in event):  # it was asked at all
        assert "effects_missing" in named(result)


def test_a_flat_battery_and_a_shut_door_are_named_as_what_is_in_the_way(newcomer: Newcomer) -> None:
    robots = newcomer.robots(door=False, r1_battery=0.1)
    status, result = newcomer.run()
    assert (status, result["goal_reached"]) == (1, False)
    assert "(lab_door)" in named(result)
    newcomer.world.write_text(json.dumps({"r1/battery": 0.1}))
    assert newcomer.run()[0] == 0
    assert not robots[0].objects(), "the robot with the flat battery"


def test_a_door_that_shuts_cancels_who_enters_and_the_end_has_a_name(newcomer: Newcomer) -> None:
    robots = newcomer.robots(r1_shut=True, r2_shut=True)
    status, result = newcomer.run()
    assert (status, result["goal_reached"]) == (1, False)
    assert "(lab_door)" in named(result)
    assert not [event for robot in robots for event in robot.objects() if event.get("is") == "lab"]


def test_an_unplugged_robot_is_noticed_and_the_other_one_has_the_goal(newcomer: Newcomer) -> None:
    newcomer.robots(r1_unplug=True, r2_unplug=False)
    status, result = newcomer.run()
    assert (status, result["goal_reached"]) == (0, True), result
