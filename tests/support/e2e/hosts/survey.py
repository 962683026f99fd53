"""A rover on the one host and a drone on the other survey places; whoever wants it done is on the rover's host."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tests.support.e2e.deployment import RunProgram, SimulationProgram
from tests.support.e2e.hosts.lan import HostsDeployment, Lan
from tests.support.files import written
from tests.support.processes import Program

DOMAIN = """
(define (domain survey)
  (:requirements :typing :durative-actions)
  (:types rover drone place)
  (:predicates (standing ?r - rover ?p - place) (road ?from ?to - place) (above ?d - drone ?p - place) (surveyed ?p - place))
  (:durative-action drive
    :parameters (?robot - rover ?from ?to - place)
    :duration (= ?duration 10)
    :condition (and (at start (road ?from ?to)) (at start (standing ?robot ?from)))
    :effect (and (at start (not (standing ?robot ?from))) (at end (standing ?robot ?to))))
  (:durative-action fly
    :parameters (?robot - drone ?from ?to - place)
    :duration (= ?duration 8)
    :condition (at start (above ?robot ?from))
    :effect (and (at start (not (above ?robot ?from))) (at end (above ?robot ?to))))
  (:durative-action look_around
    :parameters (?robot - rover ?place - place)
    :duration (= ?duration 4)
    :condition (over all (standing ?robot ?place))
    :effect (at end (surveyed ?place)))
  (:durative-action look_down
    :parameters (?robot - drone ?place - place)
    :duration (= ?duration 4)
    :condition (over all (above ?robot ?place))
    :effect (at end (surveyed ?place))))
"""
PROBLEM = """
(define (problem survey-of-places)
  (:domain survey)
  (:objects {robots} base north south - place)
  (:init (road base south) (road south north) {init})
  (:goal {goal})
  (:metric minimize (total-time)))
"""
ROBOTS = {"rover": ("r1 - rover", "(standing r1 base)"), "drone": ("d1 - drone", "(above d1 base)")}
BINDINGS = """
actions:
  drive: {{server: "/{{robot}}/navigate", timeout: 60, retries: 0}}
  fly: {{server: "/{{robot}}/navigate", timeout: 60, retries: 0}}
  look_around: {{server: "/{{robot}}/camera", retries: 0}}
  look_down: {{server: "/{{robot}}/camera", retries: 0}}
assumed: [{assumed}]
"""
SENSED = {"rover": "standing", "drone": "above"}
"""What the sensors of each kind of robot see; that a place is surveyed nobody senses."""


class Survey(HostsDeployment):
    """Robots of two kinds, each on a host that is called like its kind.

    Args:
        lan: has the hosts.
        folder: for the files.
        speed: how many times faster than real time the robots are.
    """

    def __init__(self, lan: Lan, folder: Path, *, speed: str = "4") -> None:
        super().__init__(lan, folder)
        self._speed = speed
        self._domain = str(written(folder / "domain.pddl", DOMAIN))

    def _problem(self, name: str, kinds: Sequence[str], goal: str) -> str:
        robots, init = (" ".join(ROBOTS[kind][part] for kind in kinds) for part in (0, 1))
        return str(written(self.folder / f"{name}.pddl", PROBLEM.format(robots=robots, init=init, goal=goal)))

    def robot(self, kind: str, faults: str = "faults: []") -> SimulationProgram:
        """Start the robot of this kind on its host; its world has no other, and its sensors see only where it is."""
        unseen = [name for other, name in SENSED.items() if other != kind]
        files = [self._domain, self._problem(kind, [kind], "(and)")]
        bindings = str(written(self.folder / f"{kind}.yaml", BINDINGS.format(assumed=", ".join((*unseen, "surveyed")))))
        options = ["--bindings", bindings, "--faults", str(written(self.folder / f"{kind}_faults.yaml", faults))]
        arguments = ("planner_bridge", "simulate", *files, *options, "--speed", self._speed, "--log", "/dev/stdout")
        return self._started(SimulationProgram, kind, *arguments)

    def run(self, goal: str, *, kinds: Sequence[str] = ("rover", "drone")) -> RunProgram:
        """Start a run on the rover's host."""
        files = [self._domain, self._problem("run", kinds, goal)]
        bindings = str(written(self.folder / "run.yaml", BINDINGS.format(assumed="surveyed")))
        return self._started(RunProgram, "rover", "planner_bridge", "run", *files, "--bindings", bindings, "--actions", "ros2", "--json")

    def run_plan(self, text: str) -> Program:
        """Start a plan that was written by hand on the rover's host."""
        plan = str(written(self.folder / "plan.yaml", text))
        return self._started(Program, "rover", "planner_bridge", "run", "--plan", plan, "--actions", "ros2")
