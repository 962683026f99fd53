"""Nodes that serve a fleet at the same time, each a part of it, and are killed: nothing is done twice, and nothing is left undone."""

from __future__ import annotations

import json
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.e2e.plan_deployment import Serving
from tests.support.processes import Program, overlaps, ros_domain

DOMAIN = """
(define (domain patrol)
  (:requirements :typing :durative-actions)
  (:types robot place bridge)
  (:predicates (at ?r - robot ?p - place) (way ?from ?to - place) (joins ?b - bridge ?from ?to - place)
    (free ?b - bridge) (raised))
  (:durative-action drive
    :parameters (?r - robot ?from ?to - place)
    :duration (= ?duration 4)
    :condition (and (at start (at ?r ?from)) (at start (way ?from ?to)))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to))))
  (:durative-action cross
    :parameters (?r - robot ?b - bridge ?from ?to - place)
    :duration (= ?duration 4)
    :condition (and (at start (at ?r ?from)) (at start (joins ?b ?from ?to)) (at start (free ?b)))
    :effect (and (at start (not (at ?r ?from))) (at start (not (free ?b))) (at end (at ?r ?to)) (at end (free ?b))))
  (:durative-action raise
    :parameters (?r - robot ?p - place)
    :duration (= ?duration 1)
    :condition (and (over all (at ?r ?p)) (at start (way ?p ?p)))
    :effect (and (at end (raised)))))
"""
PROBLEM = """
(define (problem patrol-there)
  (:domain patrol)
  (:objects r1 r2 r3 r4 - robot a b c d - place bc - bridge)
  (:init (at r1 a) (at r2 a) (at r3 a) (at r4 a) (way a b) (joins bc b c) (way c d) (way d d) (free bc))
  (:goal (at r1 d)))
"""
BINDINGS = """
actions:
  drive: {server: "/{r}/drive", resources: ["{r}"]}
  cross: {server: "/{r}/cross", resources: ["{r}"]}
  raise: {server: "/{r}/raise", resources: ["{r}"]}
"""
ROBOTS = ("r1", "r2", "r3", "r4")
CALLS = 3


class Parts(ProblemDeployment):
    """Robots, and the nodes of the parts of their fleet."""

    def __init__(self, folder: Path, domain: int, journal: str) -> None:
        super().__init__("", folder, domain, bindings=BINDINGS, speed="4", quick=True, texts=(DOMAIN, PROBLEM))
        self.database = journal
        self.robots: SimulationProgram = self.simulate().ready()

    def serve(self, part: int, *more: str, count: int = 2) -> Serving:
        options = [*self._bindings, "--journal", self.database, "--lease", "2", "--improve", "0", "--part", f"{part}/{count}", *more]
        names = ["--ros-args", "-r", f"__ns:=/part{part}"]
        return self.start(Serving(["-m", "planner_bridge", "serve", *self.files, *options, *names], self.environment))

    def send(self, part: int, goal: str) -> Program:
        """Send a goal at the door of a part."""
        return self.start(Program(["-m", "planner_bridge", "goal", goal, "-n", f"/part{part}"], self.environment))

    def starts(self) -> Counter[str]:
        """Return how often the robots have begun each call, by their own log."""
        return Counter(event["action"] for event in self.robots.objects() if event["event"] == "start")

    def history(self, part: int) -> list[dict[str, object]]:
        """Return the tasks of the journal of a part."""
        history = self.start(Program(["-m", "planner_bridge", "history", f"{self.database}?name=pnm_{part}", "--json"], self.environment))
        assert history.ended() == 0, str(history)
        return [json.loads(line) for line in history.out]


@pytest.fixture
def parts(tmp_path: Path, postgres: PostgresServer) -> Iterator[Parts]:
    with ros_domain() as domain:
        deployment = Parts(tmp_path, domain, postgres.database())
        try:
            yield deployment
        finally:
            deployment.close()


def test_goals_are_carried_out_once_by_the_parts_that_have_their_robots_while_nodes_are_killed(parts: Parts) -> None:
    first, second = parts.serve(1), parts.serve(2)
    first.ready()
    second.ready()
    heir = parts.serve(1)
    heir.until(lambda: any(line.startswith("stands by") for line in heir.out))
    clients = [parts.send(door, f"(at {robot} d)") for door, robot in zip((1, 1, 2, 2), ROBOTS, strict=True)]
    parts.robots.until(lambda: len(parts.starts()) >= 3)
    first.process.kill()
    parts.robots.until(lambda: len(parts.starts()) >= 6)
    second.process.kill()
    heir.ready()
    parts.serve(2).ready()
    for client in clients:
        assert client.ended() == 0, f"{client}\n{heir}"
    assert sorted(parts.starts().values()) == [1] * len(ROBOTS) * CALLS
    events = parts.robots.objects()
    both = {frozenset(pair) for pair in overlaps(events)}
    assert not [pair for pair in both if len({action.partition("(")[2].partition(",")[0] for action in pair}) == 1]
    assert not [pair for pair in both if all(action.startswith("cross") for action in pair)]
    assert {event.get("outcome", "succeeded") for event in events} == {"succeeded"}
    assert [{task["goal"] for task in parts.history(part)} for part in (1, 2)] == [{"(at r1 d)", "(at r3 d)"}, {"(at r2 d)", "(at r4 d)"}]


def test_a_goal_about_no_robot_is_carried_out_by_one_part_and_any_is_cancelled_where_it_came_in(parts: Parts) -> None:
    nodes = [parts.serve(1).ready(), parts.serve(2).ready()]
    assert parts.send(1, "(raised)").ended() == 0
    begun = parts.starts()
    assert sorted(name.partition("(")[0] for name in begun) == ["cross", "drive", "drive", "raise"]
    for door in (1, 2):
        assert parts.send(door, "(raised)").ended() == 0, "\n".join(map(str, nodes))
    assert parts.starts() == begun
    refused = parts.send(1, "(and (at r1 b) (at r2 b))")
    assert refused.ended() != 0
    assert "robots of the parts 1, 2" in str(refused)
    number = next(number for number, robot in enumerate(ROBOTS) if not any(f"({robot}," in name for name in begun))
    client = parts.send(2 - number % 2, f"(at {ROBOTS[number]} d)")  # which is not the part of the robot
    parts.robots.until(lambda: len(parts.starts()) > len(begun))
    client.process.send_signal(signal.SIGINT)
    assert client.ended() != 0
    assert "its client has cancelled it" in str(client), str(client)
    assert [task["code"] for task in parts.history(number % 2 + 1)][-1] == "cancelled"
