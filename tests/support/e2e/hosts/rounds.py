"""Rounds with a fleet: a goal is under way, its node is killed, cut off or stopped, and the other one goes on with it."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from enum import Enum
from random import Random

from tests.support.e2e.hosts.nodes import CALLS, FENCED, GOALS, HOSTS, LAST, Fleet, FleetNode


class Harm(Enum):
    """What is done to the node that serves."""

    KILL = "killed"
    CUT = "cut off"
    STOP = "stopped"


class Rounds:
    """Rounds with a fleet. The mutable state is the number of the next one, and the node that serves.

    Args:
        fleet: with no nodes yet.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._random = Random(0)
        self._number = 0
        self._host, self._other = HOSTS
        fleet.serve(self._host).ready()

    def play(self, harm: Harm) -> None:
        """Play a round; `AssertionError` if anything is done twice, or not at all."""
        fleet, robots = self._fleet, self._fleet.robots
        other = fleet.nodes.get(self._other)
        if other is None or other.process.poll() is not None:
            other = fleet.serve(self._other)
        other.until(lambda: other.stands_by)
        since = len(robots.objects())
        after = self._random.randint(1, CALLS - LAST)  # two seconds before the end: a busy machine is late with the harm
        client = fleet.send(GOALS[self._number % 2])
        client.hears("answered", accepted=True)
        robots.until(lambda: sum(fleet.starts(since).values()) >= after)
        node = fleet.nodes[self._host]
        undo = self._do(harm, node)
        other.ready()
        heals_early = self._random.random() < 0.5
        if heals_early:
            undo()
        reached = self._number + 1
        fleet.nodes[self._other].until(lambda: any(" reached " in line for line in other.out))
        if not heals_early:
            undo()
        if harm is Harm.KILL:
            fleet.forget(node)
        else:
            assert node.ended() == FENCED, str(node)
        starts = fleet.starts(since)
        assert sorted(starts.values()) == [1] * CALLS, f"{harm}: {starts}\n{node}\n{other}"
        assert not fleet.clashes(since), f"{harm}: {fleet.clashes(since)}\n{node}\n{other}"
        tasks = fleet.history()
        assert [task["code"] for task in tasks] == ["goal_reached"] * reached, f"{tasks}\n{node}\n{other}"
        client.process.kill()  # or each round would have one more in the ROS graph
        fleet.forget(client)
        self._number, self._host, self._other = reached, self._other, self._host

    def _do(self, harm: Harm, node: FleetNode) -> Callable[[], object]:
        """Harm a node; return what ends that."""
        host = self._host
        match harm:
            case Harm.KILL:
                node.process.kill()
                return lambda: None
            case Harm.CUT:
                self._fleet.lan.cut(host)
                return lambda: self._fleet.lan.heal(host)
            case Harm.STOP:
                node.process.send_signal(signal.SIGSTOP)
                return lambda: node.process.send_signal(signal.SIGCONT)

    def check(self) -> None:
        """Check the whole journal: it replays without a difference, and each task has ended once."""
        endings: dict[str, set[str]] = {}
        segment: set[str] = set()
        for record in (entry["record"] for entry in self._fleet.records()):
            if record["@"] == "SharedBegan":  # which is followed by copies of the last endings
                segment = set()
            elif record["@"] == "TaskOver":
                task = record["task"]
                assert task not in segment, f"{task} has ended twice"
                segment.add(task)
                endings.setdefault(task, set()).add(json.dumps(record["ending"]))
        assert [len(ending) for ending in endings.values()] == [1] * self._number, endings
