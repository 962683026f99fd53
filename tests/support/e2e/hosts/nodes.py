"""Two hosts with a node each, one with their database, and one with the robots and the clients."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.hosts.lan import HostsDeployment, Lan, lan
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.e2e.plan_deployment import ClientProgram, Serving
from tests.support.files import written
from tests.support.processes import LIMIT, Program, clashes

DOMAIN: Final = """
(define (domain patrol)
  (:requirements :typing :durative-actions)
  (:types robot place)
  (:predicates (at ?r - robot ?p - place) (way ?from ?to - place))
  (:durative-action drive
    :parameters (?r - robot ?from ?to - place)
    :duration (= ?duration 4)
    :condition (and (at start (at ?r ?from)) (at start (way ?from ?to)))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to)))))
"""
PROBLEM: Final = """
(define (problem patrol-there-and-back)
  (:domain patrol)
  (:objects r1 r2 r3 - robot a b c d - place)
  (:init (at r1 a) (at r2 a) (at r3 a) (way a b) (way b c) (way c d) (way d c) (way c b) (way b a))
  (:goal (and (at r1 d) (at r2 d) (at r3 d))))
"""
GOALS: Final = ("(and (at r1 d) (at r2 d) (at r3 d))", "(and (at r1 a) (at r2 a) (at r3 a))")
"""There and back."""
CALLS: Final = 9
"""Calls of the plan for one of them, each of which is another one."""
LAST: Final = 3
"""The last ones, side by side."""
HOSTS: Final = ("one", "two")
"""The hosts that have a node."""
FENCED: Final = 3
"""The exit status of a node whose journal another one has taken over."""


class FleetNode(Serving):
    """A node of the fleet."""

    @property
    def stands_by(self) -> bool:
        """Whether it waits for the journal."""
        return any(line.startswith("stands by") for line in self.out)


class Fleet(HostsDeployment):
    """Two nodes, of which one serves, with robots that drive to and fro.

    Args:
        lan: has the hosts.
        postgres: the server of the journal.
        folder: for the files.
        lease: of the journal, in seconds.
        speed: how many times faster than real time the robots are.
    """

    def __init__(self, lan: Lan, postgres: PostgresServer, folder: Path, *, lease: float = 3.0, speed: str = "4") -> None:
        super().__init__(lan, folder)
        self.lease = lease
        self.journal = f"{postgres.url()}?name=fleet"
        self._files = (str(written(folder / "domain.pddl", DOMAIN)), str(written(folder / "problem.pddl", PROBLEM)))
        options = ["--speed", speed, "--log", "/dev/stdout"]
        self.robots = self._started(SimulationProgram, "robots", "planner_bridge", "simulate", *self._files, *options).ready()
        self.nodes: dict[str, FleetNode] = {}

    def serve(self, host: str) -> FleetNode:
        """Start the node of a host."""
        options = ["--journal", self.journal, "--lease", str(self.lease), "--improve", "0"]
        node = self.nodes[host] = self._started(FleetNode, host, "planner_bridge", "serve", *self._files, *options)
        return node

    def send(self, goal: str) -> ClientProgram:
        """Have a client on the host of the robots send a goal."""
        return self._started(ClientProgram, "robots", "tests.support.e2e.programs.client", "goals", goal)

    def records(self) -> list[dict[str, Any]]:
        """Replay the journal, and return its records; there must be no difference."""
        replay = self._started(Program, "database", "planner_bridge", "replay", self.journal, "--json")
        assert replay.ended() == 0, str(replay)
        return replay.objects()

    def history(self) -> list[dict[str, Any]]:
        """Return the tasks of the journal."""
        history = self._started(Program, "database", "planner_bridge", "history", self.journal, "--json")
        assert history.ended() == 0, str(history)
        return [json.loads(line) for line in history.out]

    def starts(self, since: int = 0) -> Counter[str]:
        """Return how often the robots have begun each call, by their own log from this event on."""
        return Counter(event["action"] for event in self.robots.objects()[since:] if event["event"] == "start")

    def clashes(self, since: int = 0) -> set[tuple[str, str]]:
        """Return the pairs of calls that a robot has carried out at the same time."""
        return clashes(self.robots.objects()[since:])

    def __str__(self) -> str:
        return "\n\n".join(map(str, (self.robots, *self._programs[-4:])))

    def forget(self, killed: Program) -> None:
        """Wait for the end of a program that was killed."""
        killed.process.wait(LIMIT)


@contextmanager
def fleet(folder: Path, *, lease: float = 3.0) -> Iterator[Fleet]:
    """Have a fleet, all of which is gone at the end."""
    with lan("robots", "database", *HOSTS) as hosts:
        postgres = PostgresServer("10.0.0.2", hosts.host("database"))
        try:
            deployment = Fleet(hosts, postgres, folder, lease=lease)
            try:
                yield deployment
            finally:
                deployment.close()
        finally:
            postgres.close()
