"""The course of a simulation: everything that happens in it is drawn from its seed."""

from __future__ import annotations

import asyncio
import logging
import random
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import Context
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final
from unittest.mock import patch

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import PlanGraph
from pnm.executor import Executor
from pnm.journal import replay
from tests.support.runs.simulation.disk import DiskPlan, Fate, Folder
from tests.support.runs.simulation.fleet import Fleet, Weather, robots_of
from tests.support.runs.simulation.node import Node, machines
from tests.support.runs.simulation.plans import SERVERS, SHAPES, Job, scenario
from tests.support.runs.simulation.processes import Process, ProcessLoop, run_processes
from tests.support.runs.simulation.story import Story, Suffered

LIMIT: Final = 3000.0
"""Virtual seconds within which everything must be over."""
_REST: Final = 100.0
"""Virtual seconds within which a run that is held comes to rest, as long as its process goes on: all limits of its calls are shorter."""
_SEARCH: Final = 3.0
"""Virtual seconds for which it is held besides."""
_FAST: Final = Path("/dev/shm")


def simulate(seed: int) -> Story:
    """Return what happens in the simulation of this seed; the same whenever it is simulated."""
    number = random.Random(f"{seed}/shape").randrange(SHAPES)
    story = Story(scenario(number))
    with tempfile.TemporaryDirectory(dir=_FAST if _FAST.is_dir() else None) as folder, quiet(), generated_once(number):
        files = Folder(Path(folder) / "journal", is_leased=random.Random(f"{seed}/lease").random() < 0.7)
        run_processes(lambda loop: Course(seed, number, loop, files, story).run())
        story.read(files.journal)
    return story


@contextmanager
def generated_once(number: int) -> Iterator[None]:
    """Have replays take the machines of a scenario in place of generating them again: that would be a fifth of the time."""

    def generated(plan: PlanGraph, bindings: Bindings, *, on_failure: OnFailure, capacities: Mapping[str, int]) -> PetriNetMachine:
        known = (machine for machine in machines(number) if machine.plan == plan and machine.on_failure is on_failure)
        return next(known, None) or generate(plan, bindings, on_failure=on_failure, capacities=capacities)

    with patch.object(replay, "generate", generated):
        yield


@contextmanager
def quiet() -> Iterator[None]:
    """Log nothing meanwhile: much goes wrong."""
    disabled = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(disabled)


@dataclass(frozen=True, slots=True)
class Life:
    """What a process is going to meet, and when another one goes on in its place.

    Args:
        plan: what happens at its commits.
        dies: when it is killed, in seconds from its beginning; None if it is not.
        stops: when it is stopped, and for how long.
        cut: when it is cut off from its journal, and for how long.
        pause: seconds until the next one is started, once it is due.
    """

    plan: DiskPlan = field(default_factory=DiskPlan)
    dies: float | None = None
    stops: tuple[float, float] | None = None
    cut: tuple[float, float] | None = None
    pause: float = 0.5


def lives(rng: random.Random) -> Iterator[Life]:
    """Yield the lives of processes, one after the other; all but the first few go on to the end, unless others take over."""
    for _ in range(rng.choice([0, 1, 1, 2, 2, 3, 4])):
        pause, opening = rng.choice([0.0, 0.5, 2.0]), rng.choice([0.0, 0.0, 0.0, 1.5])
        first = rng.randrange(2, 20)
        full = range(first, first + rng.choice([1, 1, 3, 12])) if rng.random() < 0.2 else range(0)
        kind, seconds = rng.random(), rng.uniform(1.0, 30.0)
        if kind < 0.6:
            plan = DiskPlan(int(1 + 30 * rng.random() ** 2), rng.choice(FATES), seconds, full, rng.random(), opening)
            yield Life(plan, pause=pause)
            continue
        plan, at = DiskPlan(full=full, opening=opening), 12.0 * rng.random() ** 2
        if kind < 0.75:
            yield Life(plan, dies=at, pause=pause)
        elif kind < 0.88:
            yield Life(plan, stops=(at, seconds), pause=pause)
        else:
            yield Life(plan, cut=(at, seconds), pause=pause)
    while True:
        first = rng.randrange(2, 10)
        yield Life(DiskPlan(full=range(first, first + 3) if rng.random() < 0.1 else range(0)))


FATES: Final = (Fate.DIES_BEFORE, Fate.DIES_DURING, Fate.DIES_AFTER, Fate.DIES_AFTER, Fate.SLEEPS_BEFORE, Fate.SLEEPS_AFTER)


class Course:
    """One simulation. The mutable state is the processes so far, and what waits for runs that are held."""

    def __init__(self, seed: int, number: int, loop: ProcessLoop, folder: Folder, story: Story) -> None:
        self._rng = random.Random(f"{seed}/course")
        self._holds = random.Random(f"{seed}/holds")
        self._number = number
        self._loop = loop
        self._folder = folder
        self._story = story
        chance = random.Random(f"{seed}/fleet")
        weather = Weather.drawn(chance)
        self._fleet = Fleet(robots_of(story.scenario, chance, weather), loop, chance, story, weather)
        self._nodes: list[Node] = []
        self._held: list[asyncio.Task[None]] = []
        self._done = asyncio.Event()

    async def run(self) -> None:
        """Start processes one after the other until everything is done."""
        story = self._story
        self._begin_world()
        try:
            async with asyncio.timeout(LIMIT):
                for life in lives(self._rng):
                    await self._live(life)
                    if self._done.is_set():
                        break
            # Of two that came to the end, the later one has written after the other.
            story.beliefs = next(node.beliefs for node in reversed(self._nodes) if node.beliefs is not None)
        except TimeoutError:
            story.failures.append(f"not over within {LIMIT:g} s")
        story.truth = KnowledgeBase(self._fleet.robots.world.truth.facts())
        self._fleet.robots.close()
        for node in self._nodes:
            node.close()
            node.process.kill()
            if node.disk is not None:
                node.disk.close()

    async def _live(self, life: Life) -> None:
        """Start a process, and return when everything is done or when another one is to go on in its place."""
        loop, process = self._loop, Process(self._loop, f"p{len(self._nodes)}", lambda error: node.failed(error))
        node = Node(process, self._number, self._fleet, self._folder, life.plan, self._story, self._done)
        self._nodes.append(node)
        process.start(node.main())
        timers = []
        if life.dies is not None:
            timers.append(loop.call_later(life.dies, self._kill, node))
        if life.stops is not None:
            timers.append(loop.call_later(life.stops[0], self._stop, node, life.stops[1]))
        if life.cut is not None:
            timers.append(loop.call_later(life.cut[0], self._cut, node, life.cut[1]))
        waits = [asyncio.ensure_future(event.wait()) for event in (process.over, node.replaced, self._done)]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for entry in (*waits, *timers):
            entry.cancel()
        if process.is_dead:
            node.close()
        if not self._done.is_set():
            await asyncio.sleep(life.pause)

    def _kill(self, node: Node) -> None:
        self._suffer(node.process.name, "is killed")
        node.process.kill()

    def _stop(self, node: Node, seconds: float) -> None:
        self._suffer(node.process.name, f"is stopped for {seconds:.1f} s")
        node.process.stop(seconds)
        node.replaced.set()

    def _cut(self, node: Node, seconds: float) -> None:
        disk = node.disk
        if disk is not None:
            self._suffer(node.process.name, f"is cut off from its journal for {seconds:.1f} s")
            disk.is_cut_off = True
            self._loop.call_later(seconds, setattr, disk, "is_cut_off", False)
        node.replaced.set()

    def _begin_world(self) -> None:
        """Have servers restart and operators interfere, by and by."""
        rng, loop = self._rng, self._loop
        loop.call_soon(self._fleet.robots.begin, context=Context())
        for _ in range(rng.choice([0, 0, 0, 1, 2])):
            loop.call_later(12.0 * rng.random(), self._fleet.restart, rng.choice(SERVERS), context=Context())
        for _ in range(rng.choice([0, 0, 1, 2])):
            job, at = rng.choice(self._story.scenario.jobs), 10.0 * rng.random()
            if rng.random() < 0.3:
                loop.call_later(at, self._tell, job, "stop")
            else:
                loop.call_later(at, self._tell, job, rng.choice(["pause", "pause at once"]))
                for again in range(20):  # until one of the processes has it in its journal
                    loop.call_later(at + 5.0 + 40.0 * again, self._tell, job, "resume")

        for _ in range(self._holds.choice([0, 1, 2])):
            job, at = self._holds.choice(self._story.scenario.jobs), 12.0 * self._holds.random()
            loop.call_later(at, self._tell, job, "hold")
            for again in range(20):  # as another process does, that finds it held back
                loop.call_later(at + 2.0 * _REST + 40.0 * again, self._tell, job, "resume")

    def _tell(self, job: Job, what: str) -> None:
        """Have an operator say something about a task to the process that carries it out."""
        working = [node for node in self._nodes if job.task in node.executors and not node.process.is_dead]
        for node in working[-1:]:
            executor = node.executors[job.task]
            deed = {
                "stop": executor.stop,
                "pause": executor.pause,
                "pause at once": partial(executor.pause, at_once=True),
                "hold": partial(self._hold, executor),
            }
            node.process.do(deed.get(what, executor.resume))
            if what != "resume":
                self._suffer(f"t{self._story.scenario.jobs.index(job)}", what)

    def _hold(self, executor: Executor) -> None:
        """Hold a run as it is held while its plan is looked at again: it comes to rest before a new one is looked for, and after it."""
        executor.pause()

        async def held() -> None:
            try:
                async with asyncio.timeout(_REST):
                    await executor.at_rest()
                    await asyncio.sleep(_SEARCH)
                    await executor.at_rest()
            except TimeoutError:
                self._story.failures.append(f"{executor.run} is held for ever")
            executor.resume()

        self._held.append(asyncio.ensure_future(held()))

    def _suffer(self, who: str, what: str) -> None:
        self._story.moments.append(Suffered(self._loop.time(), who, what))
