"""Robots that people take over and give back at random moments while goals are pursued over ROS 2, judged by the robots' own log.

usage: python -m tests.support.tasks.kills.interventions [--interventions 20] [--first 0] [--kills 1]

The seed draws which robot, after which commands of the robots, and for how long, told by what others do meanwhile; so many times the
node is killed by SIGKILL while somebody has a robot, and started again. The exit status is 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from planner_bridge.model.grounding import initial_knowledge
from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.conditions import evaluate
from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.e2e.plan_deployment import Serving
from tests.support.pddl.problems import read_goal
from tests.support.processes import Program, ros_domain, say, until

ROBOTS = ("r1", "r2")
GOALS = ("(and (at r1 kitchen) (at r2 store))", "(and (at r1 yard) (at r2 kitchen))", "(and (at r1 store) (at r2 hall))")
SPEED = "3"


@dataclass
class Interventions:
    """What people did, and what is wrong. The mutable state is all of it."""

    deployment: ProblemDeployment
    seed: int
    count: int = 0
    commands: int = 0
    """Those that robots got while nobody had them."""
    goals: int = 0
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.draw = random.Random(self.seed)
        self.file = self.deployment.folder / "robots.log"
        self.robots = self.deployment.pnm(
            SimulationProgram, "simulate", *self.deployment.files, "--speed", SPEED, "--log", str(self.file)
        ).ready()
        self.node = self._serve()

    def log(self) -> list[dict[str, Any]]:
        """Return what the robots have written by now: a command is there before anybody hears that it was accepted."""
        return [json.loads(line) for line in self.file.read_text().splitlines(keepends=True) if line.endswith("\n")]

    def begun(self, *robots: str) -> list[str]:
        """Return the commands that robots have begun with."""
        return [one["action"] for one in self.log() if one["event"] == "start" and any(f"({name}," in one["action"] for name in robots)]

    def pursue(self, goal: str, interventions: int, kills: int) -> None:
        """Have a goal pursued, and robots taken over meanwhile; complain about an end that is not right."""
        client = self.deployment.pnm(Program, "goal", goal)
        client.until(lambda: any(" sent " in line for line in client.out) or client.process.poll() is not None)
        for number in range(interventions):
            self.intervene(client, is_killed=number < kills)
        status = client.ended()
        self.goals += 1
        if status != 0 or not self._holds(goal):
            self.wrong.append(f"{goal} has ended with {status}, and holds: {self._holds(goal)}\n{client}")

    def intervene(self, client: Program, *, is_killed: bool) -> None:
        """Take a robot over after some more commands, and give it back when something has happened meanwhile, or at once."""
        robot = self.draw.choice(ROBOTS)
        wanted = len(self.begun(*ROBOTS)) + self.draw.randrange(0, 3)
        until(lambda: len(self.begun(*ROBOTS)) >= wanted or client.process.poll() is not None)
        self._say("take", robot, "--reason", "a trial", "--by", "ada")
        before = self.begun(robot)
        if is_killed:
            self.node.kill()
            self.node = self._serve()
        moment = self.draw.choice(("at once", "somebody else has begun", "the task waits"))
        others = self.begun(*(name for name in ROBOTS if name != robot))
        if moment == "somebody else has begun":
            until(lambda: self.begun(*(name for name in ROBOTS if name != robot)) != others or self._waits(robot) or not self._tasks())
        elif moment == "the task waits":
            until(lambda: self._waits(robot) or not self._tasks())
        hands = [hand["name"] for hand in result(pnm("status", "--json"))["hands"]]
        if hands != [robot]:
            self.wrong.append(f"{robot} was taken over, and in hands are {hands}")
        if meanwhile := self.begun(robot)[len(before) :]:
            self.wrong.append(f"{robot} was in a person's hands, and has begun {', '.join(meanwhile)}")
        self._say("give", robot)
        self.count += 1

    def close(self) -> None:
        """End the node and the robots."""
        self.commands = len(self.begun(*ROBOTS))
        self.node.stop()
        self.robots.stop()
        self.wrong += [str(one) for one in self.log() if one["event"] == "clash"]

    def _serve(self) -> Serving:
        journal = str(self.deployment.folder / "journal")
        return self.deployment.pnm(Serving, "serve", *self.deployment.files, "--journal", journal).ready()

    def _say(self, *command: str) -> None:
        done = pnm(*command)
        if done.returncode != 0:
            self.wrong.append(f"{' '.join(command)}: {done.output}")

    def _tasks(self) -> list[dict[str, Any]]:
        return [task for task in result(pnm("status", "--json"))["tasks"] if task["state"] != "over"]

    def _waits(self, robot: str) -> bool:
        return any(f"{robot} is in the hands of ada" in task["reason"] for task in self._tasks())

    def _holds(self, goal: str) -> bool:
        world = initial_knowledge(self.deployment.problem)
        for one in self.log():
            if one["event"] == "change":
                world.update(dict(map(parse_statement, one["facts"])))
        return evaluate(read_goal(self.deployment.problem, goal), world) is True


def campaign(deployment: ProblemDeployment, seed: int, interventions: int, kills: int) -> Interventions:
    """Have people intervene so often, in goals one after the other; return what came of it."""
    with patch.dict(os.environ, deployment.environment):
        course = Interventions(deployment, seed)
        while course.count < interventions and not course.wrong:
            now = min(course.draw.randrange(1, 4), interventions - course.count)
            course.pursue(GOALS[course.goals % len(GOALS)], now, kills)
            kills = 0
        course.close()
    return course


def main() -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.support.tasks.kills.interventions", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--interventions", type=int, default=20, help="how often a robot is taken over and given back")
    parser.add_argument("--first", type=int, default=0, help="the seed")
    parser.add_argument("--kills", type=int, default=1, help="how often the node is killed meanwhile")
    given = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        deployment = ProblemDeployment("delivery/p01", folder, stack.enter_context(ros_domain()), quick=True)
        stack.callback(deployment.close)
        done = campaign(deployment, given.first, given.interventions, given.kills)
    say("\n".join(done.wrong) or "nothing is wrong")
    say(f"{done.count} interventions in {done.goals} goals, {done.commands} commands outside of them; load {os.getloadavg()[0]:.1f}")
    return int(bool(done.wrong))


if __name__ == "__main__":
    sys.exit(main())
