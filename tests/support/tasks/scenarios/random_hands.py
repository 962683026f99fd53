"""Random tasks while people take robots over, carry them elsewhere, and give them back: judged by the log of the robots themselves."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass, field
from pathlib import Path

from pnm.actions.simulated_robots import RobotLog
from pnm.core.machine.requests import Request
from pnm.tasks import TaskRefused
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import LAZY, USUAL
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

ROBOTS = 3
PLACES = 4


@dataclass
class HandsOff(RobotLog):
    """Sees that no robot that a person has begins with anything. The mutable state is what people have, and what was wrong."""

    taken: set[str] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    begun: int = 0

    def began(self, request: Request) -> None:
        self.begun += 1
        self.wrong += [f"{request.action} begins, and a person has {name}" for name in self.taken.intersection(request.action.arguments)]


def run_hands(number: int, times: int, journal: Path | None = None) -> HandsOff:
    """Have people take robots over and give them back so often; return the log of the robots."""
    rng, log = random.Random(f"{number}/hands"), HandsOff()

    async def course(simulation: TaskSimulation) -> None:
        robots, tasks = simulation.backend.robots, simulation.master
        robots.log = log
        wanted = [simulation.want(_goal(rng)) for _ in range(3)]
        for _ in range(times):
            await asyncio.sleep(rng.choice([0.0, 0.0, rng.uniform(0.0, 2.0), rng.uniform(0.0, 9.0)]))
            wanted += [simulation.want(_goal(rng)) for _ in range(rng.choice([0, 1, 1, 2]))]
            name = rng.choice([f"r{rng.randrange(ROBOTS)}"] * 9 + [f"p{rng.randrange(4)}"])
            if name in log.taken:
                if name.startswith("r") and rng.random() < 0.5:
                    _carry(simulation, name, f"a{rng.randrange(PLACES)}")
                log.taken.discard(name)
                await tasks.give(name)
            else:
                assert await tasks.take(name) == "", "every robot confirms"
                log.taken.add(name)
                assert not [job.request.action for job in robots._jobs.values() if name in job.request.action.arguments]
            if rng.random() < 0.1:
                await _pause(simulation, rng)
        for name in sorted(log.taken):
            log.taken.discard(name)
            await tasks.give(name)
        await simulation.reaches(*wanted)

    simulate_tasks(course, fleet(ROBOTS, places=PLACES), chosen=rng.choice([USUAL, LAZY]), journal=journal)
    assert not log.wrong, log.wrong
    return log


def _goal(rng: random.Random) -> str:
    parcel = f"(in p{rng.randrange(4)} a{rng.randrange(PLACES)})"
    robot = f"(at r{rng.randrange(ROBOTS)} a{rng.randrange(PLACES)})"
    return rng.choice([parcel, parcel, robot, f"(and {parcel} {robot})"])


def _carry(simulation: TaskSimulation, robot: str, place: str) -> None:
    places = (f"a{number}" for number in range(PLACES))
    simulation.backend.robots.world.change({("at", robot, one): one == place for one in places})


async def _pause(simulation: TaskSimulation, rng: random.Random) -> None:
    going_on = [task for task in simulation.goals if task not in simulation.endings]
    try:
        chosen = rng.choice([None, *going_on])
        await simulation.master.pause(chosen, at_once=rng.random() < 0.5)
        await asyncio.sleep(rng.uniform(0.0, 3.0))
        await simulation.master.resume(None)
    except TaskRefused:  # it is over meanwhile
        pass
