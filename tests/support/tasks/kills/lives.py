"""The lives of a scenario: processes that are killed one after the other, robots that go on, and a verdict on what was left."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from uuid import UUID

from planner_bridge.model.world import robots_of
from planner_bridge.tasks.result import TASKS
from pnm.actions.simulated_robots import RobotLog, SimulatedRobots
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.requests import Ended, OutcomeKind, Report, Request
from pnm.journal.records import Happened, Repetition, TaskOver
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from pnm.tasks import Code
from tests.support.tasks.kills.disks import Disk
from tests.support.tasks.kills.instants import AtMessage, AtTime, DiskFull, Instant
from tests.support.tasks.kills.node import live
from tests.support.tasks.kills.scenario import Scenario
from tests.support.tasks.kills.wire import Cancelled, Reattached, Sent, TaskTaken, Wire

LIFE: Final = 120.0
"""Seconds that a process may take for what is left; only one that hangs needs more."""
SPEED: Final = 300.0


@dataclass
class Verdict:
    """What was left when everything was over."""

    kills: int = 0
    wrong: list[str] = field(default_factory=list)
    """What is against the rules."""
    said: str = ""
    """What the processes have said on their standard error."""


@dataclass
class Robots(RobotLog):
    """Robots that are not killed, and their own log. The mutable state is what has a default."""

    robots: SimulatedRobots
    started: list[UUID] = field(default_factory=list)
    heard: dict[UUID, str] = field(default_factory=dict)
    """The calls of the requests that have come."""
    outcomes: dict[UUID, OutcomeKind] = field(default_factory=dict)
    taken: set[UUID] = field(default_factory=set)
    """The tasks whose clients were told that they are accepted."""
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.robots.log = self

    def began(self, request: Request) -> None:
        """Note what a robot begins with."""
        self.started.append(request.id)

    def hear(self, value: object, wire: Wire) -> None:
        """Do what a process wants."""

        def report(what: Report) -> None:
            if isinstance(what, Ended):
                self.outcomes[what.request] = what.outcome.kind
            wire.say(what)

        match value:
            case Sent(request):
                if request.id in self.heard:
                    self.wrong.append(f"{request.action} is sent twice")
                self.heard[request.id] = str(request.action)
                self.robots.send(request, report)
            case Reattached(request, accepted):
                self.heard[request.id] = str(request.action)
                self.robots.reattach(request, report, accepted=accepted)
            case Cancelled(request):
                self.robots.cancel(request)
            case TaskTaken(task):
                if task in self.taken:
                    self.wrong.append(f"the task {task} was accepted twice")
                self.taken.add(task)


def judged(scenario: Scenario, folder: Path, disk: Disk | None = None) -> Verdict:
    """Carry out a scenario in processes that are killed, and judge what is left; the journal is in the folder, or on the disk."""
    journal = (disk.folder if disk else folder) / "journal"
    verdict, loop = Verdict(), asyncio.new_event_loop()
    try:
        robots = Robots(robots_of(scenario.problem, scenario.settings.bindings, scenario.faults, speed=SPEED))
        for instant in (*scenario.deaths, None):
            status = _life(scenario, journal, folder / "log", loop, Attendance(robots, instant, disk))
            if status == -signal.SIGKILL:
                verdict.kills += 1
            else:
                verdict.wrong += [f"a process has ended with {status}"] if status else []
                break
        verdict.wrong += robots.wrong
        if not verdict.wrong:
            verdict.wrong += _complaints(scenario, journal, robots)
        robots.robots.close()
    finally:
        loop.close()
    log = folder / "log"
    verdict.said = log.read_text() if log.exists() else ""
    if verdict.said and (verdict.wrong or "Traceback" in verdict.said):
        verdict.wrong.append(verdict.said)
    return verdict


def _life(scenario: Scenario, journal: Path, log: Path, loop: asyncio.AbstractEventLoop, attendance: Attendance) -> int:
    """Start a process, and kill it; return its exit status, or the signal that has ended it as a negative number."""
    ours, theirs = socket.socketpair()
    process = os.fork()
    if process == 0:
        ours.close()
        live(scenario, journal, theirs, attendance.instant, log)
    theirs.close()
    loop.run_until_complete(attendance.attend(process, ours))
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


@dataclass(frozen=True)
class Attendance:
    """Robots that do what a process wants until it is dead, and see to it that it dies when it is to."""

    robots: Robots
    instant: Instant | None
    disk: Disk | None

    async def attend(self, process: int, end: socket.socket) -> None:
        """Do what the process wants; what it had sent when it died gets there as well."""
        later, instant, messages = asyncio.get_running_loop().call_later, self.instant, 0

        def free() -> None:
            assert self.disk is not None
            if isinstance(instant, DiskFull) and instant.is_killed:
                os.kill(process, signal.SIGKILL)
            self.disk.free(process)

        def hear(value: object) -> None:
            nonlocal messages
            messages += 1
            match instant:
                case AtMessage(message) if message == messages:
                    os.kill(process, signal.SIGKILL)
                case DiskFull(message, seconds, _) if message == messages and self.disk:
                    self.disk.fill(process)
                    later(seconds, free)
            self.robots.hear(value, wire)

        wire = Wire(end, hear)
        timers = [later(LIFE, os.kill, process, signal.SIGABRT)]
        if isinstance(instant, AtTime):
            timers.append(later(instant.seconds, os.kill, process, signal.SIGKILL))
        await wire.listen()
        for timer in timers:
            timer.cancel()


def _complaints(scenario: Scenario, journal: Path, robots: Robots) -> list[str]:
    """Compare the journal with what robots have done, and both with what was wanted."""
    replay, overs, reported, repetition = Replay(), Counter[UUID](), dict[UUID, OutcomeKind](), Repetition()
    for step in replay_steps(journal, TASKS, replay):
        is_again = repetition.has(step.record)
        match step.record:
            case TaskOver(task) if not is_again:
                overs[task] += 1
            case Happened(_, Ended(request, outcome)):
                if request in reported and reported[request] is not outcome.kind:
                    robots.wrong.append(f"{robots.heard.get(request)} has ended as {reported[request]} and as {outcome.kind}")
                reported[request] = outcome.kind
    truth, wrong = robots.robots.world.truth, list(robots.robots.clashes)
    wrong += [f"{robots.heard[id]} was started {count} times" for id, count in Counter(robots.started).items() if count > 1]
    wrong += [f"{call} is not in the journal" for id, call in robots.heard.items() if id not in replay.requests]
    wrong += [f"{robots.heard[request.id]} goes on" for request in robots.robots.at_work]
    wrong += [
        f"{robots.heard[id]} was {kind}, not {reported.get(id)}" for id, kind in robots.outcomes.items() if reported.get(id) is not kind
    ]
    known, true = replay.world.facts(), truth.facts()
    different = [fluent for fluent in known.keys() | true.keys() if known.get(fluent, False) != true.get(fluent, False)]
    wrong += [f"{fluent} is {true.get(fluent)}, known as {known.get(fluent)}" for fluent in different]
    for wanted in scenario.tasks:
        kept = replay.tasks.get(wanted.id)
        if kept is None or kept.ending is None or overs[wanted.id] != 1:
            wrong.append(f"{wanted.text} has ended {overs[wanted.id]} times")
        elif kept.ending.code is not Code.GOAL_REACHED or evaluate(scenario.read_goal(wanted.text), truth) is not True:
            wrong.append(f"{wanted.text} has ended: {kept.ending}")
    return wrong
