"""The parts of a fleet, carried out by processes that are killed; the robots are in the process that kills them."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import random
import signal
import socket
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Final, NoReturn

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.node.fleet import DealtRobots, FleetManager
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend
from pnm.actions.faults import NO_FAULTS
from pnm.clock import run_async
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.bindings import Binding, Bindings
from pnm.files.database.place import ServerUrl
from pnm.journal.fleet import Fleet, Part
from pnm.journal.kept import JournalChoice
from pnm.journal.records import SharedBegan
from pnm.journal.resume import stand_by
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.tasks.kills.campaign import forks
from tests.support.tasks.kills.lives import Robots
from tests.support.tasks.kills.wire import DistantRobots, Wire

_BINDINGS: Final = Bindings({name: Binding(resources=("{r}",)) for name in ("move", "pick", "drop")})
_LOOK: Final = 0.05
_KEPT: Final = 86400.0


@dataclass(frozen=True)
class FleetScenario:
    """What the nodes of a fleet are to do.

    Args:
        problem: of robots, of the type ``robot``.
        tasks: what is wanted; the first comes in at the first part, and so on in turn.
        parts: how many there are.
        kills: how many processes are killed.
        speed: of the robots.
        lease: of a part, in seconds.
        active: how many tasks go on in a part at the same time.
        is_fleet: whether there is a fleet; otherwise the only part is carried out as a node does that has all robots.
        seconds: until everything must be over.
    """

    problem: Problem
    tasks: Sequence[Wanted]
    parts: int
    kills: int = 0
    seed: int = 0
    speed: float = 20.0
    lease: float = 3.0
    active: int = 1000
    is_fleet: bool = True
    seconds: float = 100.0


@dataclass
class FleetVerdict:
    """What was left.

    Args:
        wrong: what is against the rules.
        kills: the processes that were killed.
        requests: the commands of robots.
        seconds: from the first goal to the last ending.
        used: the seconds of processor time of each process that was not killed, from its birth.
        shared: the tasks that each part has carried out.
    """

    wrong: list[str] = field(default_factory=list)
    kills: int = 0
    requests: int = 0
    seconds: float = 0.0
    used: list[float] = field(default_factory=list)
    shared: list[int] = field(default_factory=list)


def fleet_judged(scenario: FleetScenario, url: str, folder: Path) -> FleetVerdict:
    """Carry out a scenario in processes of their own, and judge what is left."""
    with ProcessPoolExecutor(1, mp_context=forks(), initializer=gc.freeze) as pool:
        return pool.submit(_judged, scenario, url, folder).result()


def _judged(scenario: FleetScenario, url: str, folder: Path) -> FleetVerdict:
    return asyncio.run(_Nodes(scenario, ServerUrl.of(url), folder / "log").carried_out())


class _Nodes:
    """The processes of a fleet, two for each part if they are killed. The mutable state is these, and the verdict."""

    def __init__(self, scenario: FleetScenario, place: ServerUrl, log: Path) -> None:
        self._scenario = scenario
        self._place = place
        self._log = log
        self._robots = Robots(robots_of(scenario.problem, _BINDINGS, NO_FAULTS, speed=scenario.speed))
        self._alive: dict[int, tuple[int, asyncio.Task[None], socket.socket]] = {}
        self._verdict = FleetVerdict()

    async def carried_out(self) -> FleetVerdict:
        """Start the processes, kill some, and wait until all is over."""
        scenario, verdict, rng = self._scenario, self._verdict, random.Random(self._scenario.seed)
        began = monotonic()
        for part in range(1, scenario.parts + 1):
            for _ in range(2 if scenario.kills else 1):
                self._start(part)
        while (over := self._over()) < len(scenario.tasks):
            if monotonic() > began + scenario.seconds:
                verdict.wrong.append(f"{over} of {len(scenario.tasks)} tasks are over after {scenario.seconds:g} s")
                break
            if verdict.kills < scenario.kills and self._robots.started:
                await asyncio.sleep(rng.uniform(0.0, scenario.lease / scenario.parts))
                process = rng.choice([*self._alive])
                os.kill(process, signal.SIGKILL)
                verdict.kills += 1
                await self._alive[process][1]
            for process, (part, listening, _) in [*self._alive.items()]:
                if listening.done():  # it was killed, or another one has taken over its part, where this machine is slow
                    await self._wait(process)
                    self._start(part)
            await asyncio.sleep(_LOOK)
        verdict.seconds = monotonic() - began
        for process in [*self._alive]:
            with suppress(OSError):  # it has ended by itself
                self._alive[process][2].shutdown(socket.SHUT_RDWR)
            verdict.used.append(await self._wait(process))
        self._robots.robots.close()
        verdict.wrong += self._complaints()
        verdict.requests = len(self._robots.started)
        return verdict

    def _start(self, part: int) -> None:
        ours, theirs = socket.socketpair()
        process = os.fork()
        if process == 0:
            for _, _, other in self._alive.values():
                other.close()
            ours.close()
            _live(self._scenario, Part(part, self._scenario.parts), self._place, theirs, self._log)
        theirs.close()
        wire = Wire(ours, lambda value: self._robots.hear(value, wire))
        self._alive[process] = part, asyncio.ensure_future(wire.listen()), ours

    async def _wait(self, process: int) -> float:
        """Wait for the end of a process; return the processor time that it has used."""
        await self._alive.pop(process)[1]
        ended = await asyncio.to_thread(os.wait4, process, 0)
        if (status := os.waitstatus_to_exitcode(ended[1])) not in (0, -signal.SIGKILL):
            self._verdict.wrong.append(f"a process has ended with {status}: {self._log.read_text() if self._log.exists() else ''}")
        return ended[2].ru_utime + ended[2].ru_stime

    def _over(self) -> int:
        with suppress(Exception):  # before the first process has made the table
            table = "goals WHERE ending <> ''" if self._scenario.is_fleet else "pnm_1.tasks WHERE is_over = 1"
            return int(str(self._select(f"SELECT count(*) FROM {table}")[0][0]))
        return 0

    def _select(self, sql: str) -> list[list[object]]:
        from pg8000.native import Connection

        place = self._place
        with closing(Connection(place.user, host=place.host, port=place.port, database=place.database)) as connection:
            connection.run(f"SET search_path TO {place.name}")
            return list(connection.run(sql) or [])

    def _complaints(self) -> list[str]:
        """Compare what robots have done with what was wanted."""
        robots, scenario = self._robots, self._scenario
        heard = Counter(robots.heard[request] for request in robots.started)
        wrong = [*robots.wrong, *robots.robots.clashes]
        wrong += [f"{robots.heard[id]} was started {count} times" for id, count in Counter(robots.started).items() if count > 1]
        wrong += [f"{robots.heard[id]} was {kind}, of {heard}" for id, kind in robots.outcomes.items() if kind.value != "succeeded"]
        wrong += [f"{robots.heard[request.id]} goes on" for request in robots.robots.at_work]
        begun = Counter(
            str(task) for part in range(1, scenario.parts + 1) for (task,) in self._select(f"SELECT task FROM pnm_{part}.tasks")
        )
        wrong += [f"the task {task} is in {count} journals" for task, count in begun.items() if count > 1]
        if scenario.is_fleet:
            rows = self._select("SELECT part, count(*) FROM goals GROUP BY part ORDER BY part")
            self._verdict.shared = [int(str(count)) for _, count in rows]
        truth = robots.robots.world.truth
        world = SharedWorld(scenario.problem, truth)
        for wanted in scenario.tasks:
            if wanted.id.hex not in begun:
                wrong.append(f"{wanted.text} was never begun")
            elif evaluate(world.read_goal(wanted.text), truth) is not True:
                wrong.append(f"{wanted.text} does not hold")
        return wrong


async def _serve(scenario: FleetScenario, part: Part, place: ServerUrl, end: socket.socket) -> None:
    """Be the node of a part, or stand by, until the other end of the wire is closed."""
    dealt = DealtRobots(scenario.problem, "robot", part, {})
    choice = JournalChoice(part.journal(place), is_durable=False, lease=scenario.lease, node="")
    taking = asyncio.ensure_future(stand_by(choice, TASKS, str(part), lambda _: None))
    loop = asyncio.get_running_loop()
    while not taking.done():
        await asyncio.wait((taking,), timeout=_LOOK)
        with suppress(BlockingIOError):
            if not end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                os._exit(0)  # it has stood by to the end
    taken = taking.result()
    robots = DistantRobots(end)
    listening = asyncio.ensure_future(robots.wire.listen())
    journal, replay = taken.write(lambda why: os._exit(0)), taken.replay
    if replay:
        loop.continue_from(replay.now)  # type: ignore[attr-defined]
    knowledge = replay.world if replay else initial_knowledge(dealt.problem)
    runner = PlanRunner({}, ClientBackend(robots), knowledge, None, journal, replay)
    runner.prefix = part.number.to_bytes(len(runner.prefix) or 4)
    if replay is None:
        journal.begin(knowledge, runner.resources, began=SharedBegan(runner.resources.capacities, runner.prefix, str(part)))
    settings, limits = Settings(improve=0.0, bindings=_BINDINGS), TaskLimits(active=scenario.active, queue=10_000)
    fleet = Fleet(place, TASKS, part, "world", _KEPT) if scenario.is_fleet else None
    make = partial(FleetManager, dealt, fleet) if fleet else TaskManager
    manager = make(dealt.problem, runner, settings, SharedWorld(dealt.problem, knowledge).read_goal, limits=limits)
    if replay:
        manager.restore(replay)
    known = {wanted.id for wanted, _ in manager.go_on()} if isinstance(manager, FleetManager) else set()
    for wanted in scenario.tasks[part.number - 1 :: part.count]:
        if wanted.id not in known:  # its client was not told that it is accepted, and asks again
            manager.begin(wanted)
    attending = asyncio.ensure_future(manager.attend() if isinstance(manager, FleetManager) else listening)
    await asyncio.wait((listening, attending), return_when=asyncio.FIRST_COMPLETED)
    if attending.done():
        attending.result()


def _live(scenario: FleetScenario, part: Part, place: ServerUrl, end: socket.socket, log: Path) -> NoReturn:
    status = 1
    try:
        asyncio.events._set_running_loop(None)  # that of the process of which this one is a copy
        with log.open("ab") as file:
            os.dup2(file.fileno(), 2)
        logging.getLogger().setLevel(logging.ERROR)
        run_async(_serve(scenario, part, place, end))
        status = 0
    except BaseException:
        with log.open("a") as text:
            text.write(traceback.format_exc())
    finally:
        os._exit(status)
