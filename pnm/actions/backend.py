"""Where actions are carried out: simulated robots in this process, or action servers of ROS 2.

A site is opened with the knowledge it shall keep up to date, and closed when the task is over.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Final, Protocol
from uuid import UUID

from pnm.actions.simulated_robots import SimulatedRobots, sense
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import TimedChange
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import ActionClient
from pnm.knowledge.sources.source import FindKnowledge, Source

DISCOVERY: Final = 10.0
"""Seconds that robots may take to appear which are started together with us; later, who is missing fails by name."""


class Backend(Protocol):
    """Carries out actions and reports about the world."""

    @property
    def client(self) -> ActionClient:
        """What requests are sent to."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and bring the knowledge up to date with what is observed."""

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Let whoever carries out a request ask, and change, what the run knows that has sent it.

        Args:
            mark: what the identities of all requests begin with.
            find: finds the knowledge by the identity of the request.
            source: asked for what runs do not know themselves.
        """

    def over(self, request: UUID, /) -> None:
        """Note that a request is over: nobody needs to know anything for it any more."""

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Get ready to carry out these actions; return the names of servers that are not there yet."""

    async def close(self) -> None:
        """Disconnect."""


def schedule(knowledge: KnowledgeBase, timed: Iterable[TimedChange], began: float) -> Callable[[], None]:
    """Let those facts change by themselves that nobody reports, so many seconds after the beginning; return what stops that."""
    loop = asyncio.get_running_loop()
    timers: list[asyncio.TimerHandle] = []
    for change in timed:
        assumed = {fluent: value for fluent, value in change.changes.items() if not knowledge.is_sensed(fluent)}
        timers.append(loop.call_at(began + change.time, knowledge.update, assumed))

    def stop() -> None:
        for timer in timers:
            timer.cancel()

    return stop


class SimulatedBackend:
    """Simulated robots in this process; under virtual time a run takes no time at all."""

    def __init__(self, robots: SimulatedRobots, assumed: frozenset[str] = frozenset()) -> None:
        self.robots = robots
        self._assumed = assumed

    @property
    def client(self) -> ActionClient:
        """The robots."""
        return self.robots

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Start the world's clock and let knowledge be told of everything that is sensed."""
        sense(self.robots.world, knowledge, self._assumed)
        self.robots.begin()

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Do nothing: simulated robots ask for nothing."""

    def over(self, request: UUID, /) -> None:
        """Do nothing."""

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Do nothing: simulated robots are always ready."""
        return ()

    async def close(self) -> None:
        """Stop the world."""
        self.robots.close()
