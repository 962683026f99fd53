"""A fake fleet and the network before it: messages are late, overtake each other, come twice or not at all; servers restart and lie."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from contextvars import Context
from dataclasses import dataclass
from functools import partial
from typing import Final
from uuid import UUID

from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.actions.simulated_robots import RobotLog, SimulatedRobots, SimulatedWorld
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Report, Reporter, Request
from tests.support.runs.simulation.plans import CALM, SERVERS, Scenario
from tests.support.runs.simulation.processes import Process, ProcessLoop
from tests.support.runs.simulation.story import Began, CancelSent, Finished, Heard, Lied, Sent, Story, Suffered

LAG: Final = 0.3
"""Seconds that reports of sensors are late at most."""


@dataclass(frozen=True, slots=True)
class Weather:
    """How likely it is for a message, or for a request, that something goes wrong."""

    late: float = 0.0
    lost: float = 0.0
    twice: float = 0.0
    fails: float = 0.0
    """That a server aborts, rejects, hangs, does nothing, or is slow."""
    lies: float = 0.0

    @staticmethod
    def drawn(rng: random.Random) -> Weather:
        """Draw how bad it is."""
        if rng.random() < 0.2:
            return Weather()
        bad = partial(rng.choice, [0.0, 0.02, 0.1])
        return Weather(bad(), rng.choice([0.0, 0.0, 0.01, 0.05]), bad(), rng.choice([0.0, 0.05, 0.2]), rng.choice([0.0, 0.0, 0.05, 0.2]))


def faults(rng: random.Random, weather: Weather) -> Faults:
    """Draw what goes wrong by itself."""
    kinds = [FaultKind.ABORT, FaultKind.ABORT, FaultKind.REJECT, FaultKind.HANG, FaultKind.NO_EFFECT, FaultKind.SLOW]
    failing = tuple(Fault(name, rng.choice(kinds), chance=weather.fails) for name in SERVERS if weather.fails)
    storms = [(at, at + rng.uniform(0.5, 6.0)) for at in sorted(rng.uniform(0.0, 10.0) for _ in range(rng.choice([0, 0, 1, 2])))]
    changes = tuple(HiddenChange({CALM: calm}, at=at) for storm in storms for at, calm in zip(storm, (False, True), strict=True))
    return Faults(failing, changes, rng.randrange(1 << 30))


def robots_of(scenario: Scenario, rng: random.Random, weather: Weather) -> SimulatedRobots:
    """Return the robots of a scenario, with what goes wrong by itself."""
    world = SimulatedWorld(KnowledgeBase({CALM: True}), {*scenario.sensed, *scenario.bindings.assumed, "busy"})
    return SimulatedRobots(world, faults(rng, weather), scenario.bindings, capacities=scenario.capacities)


class Fleet(RobotLog):
    """The servers of all robots, and the network before them.

    The mutable state is what it knows of requests, how often servers were restarted, and when messages arrive.
    """

    def __init__(self, robots: SimulatedRobots, loop: ProcessLoop, rng: random.Random, story: Story, weather: Weather) -> None:
        self.loop = loop
        self.rng = rng
        self.story = story
        self.weather = weather
        self.robots = robots
        robots.log, robots.clashes = self, story.clashes
        self._known: dict[UUID, tuple[Request, Reporter]] = {}
        """What servers have received, and where they report on it."""
        self._said: dict[UUID, Outcome] = {}
        """Ends that are lies."""
        self._denied: set[UUID] = set()
        """Requests whose success will be denied."""
        self._ever: set[UUID] = set()
        """What any server has received: no message arrives a second time after a restart."""
        self._lives = Counter[str]()
        self.carried_out: list[tuple[UUID, GroundAction]] = []
        """What robots have begun."""
        self._arrivals: dict[UUID, float] = {}
        """When the last message with a goal arrives at its server."""

    # --- the servers ----------------------------------------------------------------------------

    def receive(self, request: Request, report: Reporter) -> None:
        """Have a server take a goal on, unless it has it already."""
        if request.id not in self._ever:
            self._take(request, report)
            if request.id not in self._said:
                self.robots.send(request, partial(self._report, request))

    def find(self, request: Request, report: Reporter, *, accepted: bool) -> None:
        """Have a server say what has become of a goal."""
        is_new = request.id not in self._known
        self._ever.add(request.id)
        if is_new and not accepted:
            self._take(request, report)
        else:
            self._known[request.id] = request, report
        if request.id in self._said:
            if not is_new:
                report(Ended(request.id, self._said[request.id]))
            return
        self.robots.reattach(request, partial(self._report, request), accepted=accepted)

    def cancel(self, request: UUID) -> None:
        """Have the server of a goal stop it."""
        self.robots.cancel(request)

    def restart(self, server: str) -> None:
        """Have a server forget all goals; its clients may notice that it was away."""
        notices = self.rng.random() < 0.5
        self.story.moments.append(Suffered(self.loop.time(), server, f"restarted{', and that is noticed' if notices else ''}"))
        self._lives[server] += 1
        going_on = {request.id for request in self.robots.at_work}
        self.robots.restart(server)
        for request, report in [*self._known.values()]:
            if self.robots.bindings.server(request.action) == server:
                del self._known[request.id]
                self._said.pop(request.id, None)
                if notices and request.id in going_on:
                    report(Ended(request.id, Outcome(OutcomeKind.LOST, message="the server went away")))

    def _take(self, request: Request, report: Reporter) -> None:
        self._ever.add(request.id)
        self._known[request.id] = request, report
        if self.rng.random() >= self.weather.lies:
            return
        if self.rng.random() < 0.5:
            self._denied.add(request.id)
            return
        self._said[request.id] = Outcome(OutcomeKind.SUCCEEDED, message="nothing was done")
        self.story.moments.append(Lied(self.loop.time(), request.id, str(request.action), OutcomeKind.SUCCEEDED))
        if self.rng.random() < 0.5:
            report(Accepted(request.id))
        report(Ended(request.id, self._said[request.id]))

    def _report(self, request: Request, report: Report) -> None:
        if isinstance(report, Ended) and report.outcome.kind is OutcomeKind.SUCCEEDED and request.id in self._denied:
            self.story.moments.append(Lied(self.loop.time(), request.id, str(request.action), OutcomeKind.ABORTED))
            self._denied.discard(request.id)
            self._said[request.id] = Outcome(OutcomeKind.ABORTED, message="nothing was done")
            report = Ended(request.id, self._said[request.id])
        self._known[request.id][1](report)

    # --- the log of the robots ------------------------------------------------------------------

    def began(self, request: Request) -> None:
        self.carried_out.append((request.id, request.action))
        life = self._lives[self.robots.bindings.server(request.action)]
        self.story.moments.append(Began(self.loop.time(), request.id, str(request.action), life))

    def ended(self, request: Request, outcome: Outcome) -> None:
        self.story.moments.append(Finished(self.loop.time(), request.id, outcome.kind))

    # --- the network ----------------------------------------------------------------------------

    def carry(self, deliver: Callable[[], object], goal: UUID | None = None) -> None:
        """Carry a message: at once, late, twice, or not at all; those with the same goal never overtake each other.

        Where they did, a server could say that it does not know a goal, and begin it afterwards: nothing that a client does helps.
        """
        rng, weather, now = self.rng, self.weather, self.loop.time()
        if rng.random() < weather.lost:
            return
        for _ in range(2 if rng.random() < weather.twice else 1):
            delay = rng.choice([0.2, 1.0, 4.0, 12.0, 40.0]) * rng.random() if rng.random() < weather.late else 0.001 + 0.01 * rng.random()
            at = now + delay
            if goal is not None:
                at = self._arrivals[goal] = max(at, self._arrivals.get(goal, 0.0) + 1e-6)
            self.loop.call_at(at, deliver, context=Context())


class Connection:
    """What a process reaches the servers by, for one of its tasks. It has no state of its own."""

    def __init__(self, process: Process, fleet: Fleet, task: UUID) -> None:
        self._process = process
        self._fleet = fleet
        self._task = task

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return self._fleet.robots.goal_fields(action)

    def send(self, request: Request, report: Reporter, /) -> None:
        self._note(Sent(self._fleet.loop.time(), self._process.name, self._task, request.id, str(request.action)))
        self._carry(partial(self._fleet.receive, request, partial(self._reported, report)), request.id)

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        self._note(Sent(self._fleet.loop.time(), self._process.name, self._task, request.id, str(request.action), is_again=True))
        self._carry(partial(self._fleet.find, request, partial(self._reported, report), accepted=accepted), request.id)

    def cancel(self, request: UUID, /) -> None:
        self._note(CancelSent(self._fleet.loop.time(), self._process.name, request))
        self._carry(partial(self._fleet.cancel, request))

    def _note(self, moment: Sent | CancelSent) -> None:
        if not self._process.is_dead:
            self._fleet.story.moments.append(moment)

    def _carry(self, deliver: Callable[[], object], goal: UUID | None = None) -> None:
        if not self._process.is_dead:
            self._fleet.carry(deliver, goal)

    def _reported(self, report: Reporter, what: Report) -> None:
        self._fleet.carry(partial(self._process.do, self._hear, report, what))

    def _hear(self, report: Reporter, what: Report) -> None:
        kind = what.outcome.kind if isinstance(what, Ended) else None
        self._fleet.story.moments.append(Heard(self._fleet.loop.time(), self._process.name, what.request, type(what).__name__, kind))
        report(what)
