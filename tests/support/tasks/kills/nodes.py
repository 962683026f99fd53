"""`pnm serve` over ROS 2, killed again and again while three goals are under way; its robots, and its clients, are in other processes."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from math import inf
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from planner_bridge.tasks.result import TASKS
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from pnm.tasks import Code
from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.processes import LIMIT, clashes, ros_domain, until
from tests.support.tasks.kills.campaign import Campaign, forks
from tests.support.tasks.kills.instants import AtCommit, AtMessage, AtTime, Instant, die_in_journals
from tests.support.tasks.kills.lives import Verdict
from tests.support.tasks.kills.scenario import PLACES, ROBOTS, TEXTS

BINDINGS: Final = """
actions:
  move: {resources: ["{r}"]}
  pick: {resources: ["{r}"]}
  drop: {resources: ["{r}"]}
assumed: [moves, picks]
"""


def _pnm(arguments: list[str], environment: Mapping[str, str], out: Path, instant: Instant | None) -> None:
    """Be `pnm`, as a copy of a process that has loaded everything."""
    os.environ.update(environment)
    descriptor = os.open(out, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(descriptor, stream.fileno())
    if isinstance(instant, AtCommit):
        die_in_journals(instant)
    from planner_bridge.cli.commands import app  # here, where it is loaded already

    app(arguments, prog_name="pnm")


@dataclass
class Node:
    """A node with robots and clients. The mutable state is what has a default.

    Args:
        deployment: its ROS domain.
        rng: draws goals, and when it is killed.
        kills: how often it is killed at least.
    """

    deployment: ProblemDeployment
    rng: random.Random
    kills: int
    verdict: Verdict = field(default_factory=Verdict)
    goals: int = 0
    process: ForkServerProcess | None = None
    _processes: list[ForkServerProcess] = field(default_factory=list)
    _numbers: Callable[[], int] = field(default_factory=lambda: partial(next, count()))

    def carried_out(self) -> Verdict:
        """Kill it so often, in rounds of three goals, and judge what is left."""
        robots = self.deployment.simulate().ready()
        while self.verdict.kills < self.kills:
            self._pursue_goals(robots)
        last = self._replace(None)
        self._until(lambda: self._says("ready"))
        last.terminate()
        last.join(LIMIT)
        self.verdict.wrong += [f"the node has ended with {last.exitcode}"] if last.exitcode else []
        replay = Replay()
        for _ in replay_steps(self._journal, TASKS, replay):  # of all segments, for what was sent in any of them counts
            pass
        self.verdict.wrong += _complaints(self.deployment.truth(robots).facts(), replay, robots, self.goals)
        self.verdict.wrong += [text for file in self.deployment.folder.glob("*.out") if "Traceback" in (text := file.read_text())]
        robots.stop()
        return self.verdict

    @property
    def _journal(self) -> Path:
        return self.deployment.folder / "tasks.journal"

    def _replace(self, instant: Instant | None) -> ForkServerProcess:
        """Kill the node, if it is not dead yet, and start another one."""
        if self.process:
            self.process.kill()
            self.process.join(LIMIT)
            self.verdict.kills += self.process.exitcode == -signal.SIGKILL
        options = ["--bindings", str(self.deployment.folder / "bindings.yaml"), "--journal", str(self._journal), "--improve", "0"]
        self._out = self.deployment.folder / f"node{self._numbers()}.out"
        self.process = self._start(["serve", *self.deployment.files, *options], self._out, instant)
        return self.process

    def _says(self, text: str) -> int:
        """Return how often the node has said something on its terminal."""
        return self._out.read_text().count(text) if self._out.exists() else 0

    def _start(self, arguments: list[str], out: Path, instant: Instant | None = None) -> ForkServerProcess:
        process = forks().Process(target=_pnm, args=(arguments, self.deployment.environment, out, instant), daemon=True)
        process.start()
        self._processes.append(process)
        return process

    def _until(self, happens: Callable[[], object]) -> None:
        """Wait for something that the node, its clients or its robots do; if it does not happen, show what they have said."""
        try:
            until(happens)
        except AssertionError as error:
            said = [f"--- {file.name}\n{file.read_text()}" for file in sorted(self.deployment.folder.glob("*.out"))]
            raise AssertionError("\n".join((str(error), *said))) from error

    def close(self) -> None:
        """Kill what is still alive: the ROS domain belongs to others soon."""
        for process in self._processes:
            process.kill()
            process.join(LIMIT)

    def _pursue_goals(self, robots: SimulationProgram) -> None:
        """Have three clients send a goal each, and kill the node until all of these are reached."""
        node = self._replace(None)
        self._until(lambda: self._says("ready"))
        targets = [f"(in p{parcel} a{self.rng.randrange(PLACES)})" for parcel in range(ROBOTS)]
        files = [self.deployment.folder / f"client{self._numbers()}.out" for _ in targets]
        clients = [self._start(["goal", target], file) for target, file in zip(targets, files, strict=True)]
        self._until(lambda: self._says("  goal    ") == len(clients))
        self.goals += len(clients)
        instants = self._instants()
        instant: Instant = AtMessage(1)  # the first node has all three goals under way
        while not self._comes(instant, node, robots, clients):
            instant = next(instants)
            node = self._replace(instant)
        for client, file in zip(clients, files, strict=True):
            if client.exitcode:
                self.verdict.wrong.append(f"a client has ended with {client.exitcode}: {file.read_text()}")

    def _instants(self) -> Iterator[Instant]:
        """Draw when it is killed: of three times twice while it starts, or a few commits later, and then when it has done something.

        Once it was killed often enough it may live.
        """
        while self.verdict.kills < self.kills:
            yield AtCommit(self.rng.randrange(1, 8), before=self.rng.random() < 0.5)
            yield AtTime(self.rng.uniform(0.2, 6.0))
            yield AtMessage(self.rng.randrange(2, 6))
        yield AtMessage(sys.maxsize)

    def _comes(self, instant: Instant, node: ForkServerProcess, robots: SimulationProgram, clients: list[ForkServerProcess]) -> bool:
        """Wait until the node is dead or to be killed; return whether all clients have their results instead."""

        def are_over() -> bool:
            return not node.is_alive() or not any(client.is_alive() for client in clients)

        if isinstance(instant, AtTime):
            node.join(instant.seconds)
        else:
            self._until(lambda: are_over() or self._says("ready"))
            events, least = len(robots.objects()), instant.message if isinstance(instant, AtMessage) else inf
            self._until(lambda: are_over() or len(robots.objects()) - events >= least)
        return not any(client.is_alive() for client in clients)


def _complaints(true: Mapping[Fluent, Value | Unknown], replay: Replay, robots: SimulationProgram, goals: int) -> list[str]:
    """Compare the journal with what the robots have done, and with what was wanted."""
    events = robots.objects()
    started, sent = (
        Counter(event["action"] for event in events if event["event"] == "start"),
        Counter(str(request.action) for request in replay.requests.values()),
    )
    wrong = [
        f"{action} was started {started[action]} times, sent {sent[action]} times"
        for action in started | sent
        if started[action] > sent[action]
    ]
    wrong += [json.dumps(event) for event in events if event["event"] == "clash" or event.get("outcome", "succeeded") != "succeeded"]
    wrong += [f"{one} and {other} at the same time" for one, other in clashes(events)]
    known = replay.world.facts()
    different = [fluent for fluent in known.keys() | true.keys() if known.get(fluent, False) != true.get(fluent, False)]
    wrong += [f"{fluent} is {true.get(fluent)}, known as {known.get(fluent)}" for fluent in different]
    endings = [task.ending for task in replay.tasks.values()]
    wrong += [str(ending) for ending in endings if ending is None or ending.code is not Code.GOAL_REACHED]
    wrong += [f"{len(endings)} tasks of {goals}"] if len(endings) != goals else []
    return wrong


def _carried_out(number: int, kills: int) -> Verdict:
    with TemporaryDirectory() as folder, ros_domain() as domain:
        deployment = ProblemDeployment("", Path(folder), domain, bindings=BINDINGS, speed="2", quick=True, texts=TEXTS)
        node = Node(deployment, random.Random(number), kills)
        try:
            return node.carried_out()
        finally:
            node.close()
            deployment.close()


def node_kills(kills: int, nodes: int, first: int = 0) -> Campaign:
    """Kill nodes so often altogether; so many are there side by side, each in a ROS domain of its own: they mostly wait."""
    campaign, each = Campaign(), -(-kills // nodes)
    with ThreadPoolExecutor(nodes) as pool:
        for number, verdict in enumerate(pool.map(lambda number: _carried_out(number, each), range(first, first + nodes)), first):
            campaign.add(f"node {number}", verdict)
    return campaign
