"""Execution backends: simulated robots in this process, or the action servers of ROS 2 (`pnm.ros.backend`).

A backend is opened with the knowledge base that it keeps up to date, and closed when the task is over.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from math import inf
from typing import Final, Protocol

from pnm.actions.simulated_robots import SimulatedRobots, report_changes
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.domain import Vocabulary
from pnm.core.logic.effects import TimedChange
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import ActionClient
from pnm.core.readiness import Readiness, ReadyState, refuse_unfit
from pnm.knowledge.source import FindKnowledge, Source

_log = logging.getLogger(__name__)
_EACH: Final = 3
"""So many servers that are not there have a line each; more are named together."""


class Backend(Protocol):
    """An execution backend: performs actions and reports on the state of the world."""

    @property
    def client(self) -> ActionClient:
        """The action client that requests are sent to."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and begin to bring the knowledge up to date with state reports."""

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Let action servers query the knowledge of the run whose requests' ids begin with `mark`, and what `source` answers beside it."""

    async def check(
        self, actions: Iterable[GroundAction] = (), wait: float = 0.0, known: Vocabulary | None = None
    ) -> tuple[Readiness, ...]:
        """Return the readiness of the servers of all declared actions and of these, and of all sensors.

        What is not there yet is waited for, for `wait` seconds. `known` has other declared names than those that are in use.
        """
        return ()

    async def refresh(self) -> None:
        """Ask for what is reported only when it is asked for: the knowledge is to be up to date for a plan."""

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Look for the servers of these actions; return the names of those that are not there yet."""
        return ()

    @property
    def missing(self) -> frozenset[str]:
        """The action servers that were waited for in vain, and are not there yet, by the names that bindings give them."""
        return frozenset()

    async def busy_elsewhere(self) -> tuple[str, ...]:
        """Return the action servers that are at work on what this process has not asked for, as far as that is known."""
        return ()

    async def close(self) -> None:
        """Disconnect."""


async def check_ready(backend: Backend, actions: Iterable[GroundAction] = (), known: Vocabulary | None = None) -> None:
    """Log what is not ready yet of what the backend needs; raise an `InputError` if something can never work."""
    rows = await backend.check(actions, known=known)
    refuse_unfit(rows)
    rows = tuple(row for row in rows if row.state is not ReadyState.OPEN)
    awaited = [row for row in rows if row.waits]
    if len(awaited) > _EACH:
        names = ", ".join(dict.fromkeys(row.name for row in awaited))
        _log.warning("not there yet (`pnm check` says more): %s; each %s", names, awaited[0].waits)
    for row in rows:
        if row.state is not ReadyState.READY and not (row.waits and len(awaited) > _EACH):
            _log.warning("%s%s", row, f"; it {row.waits}" if row.waits else "")


def schedule(knowledge: KnowledgeBase, timed: Iterable[TimedChange], began: float, after: float = -inf) -> Callable[[], None]:
    """Schedule the timed changes after `after` that no sensor reports, of a plan begun at `began`; return a function that cancels them."""
    timers: list[asyncio.TimerHandle] = []
    for change in (change for change in timed if began + change.time >= after):
        assumed = {fluent: value for fluent, value in change.changes.items() if not knowledge.is_sensed(fluent)}
        timers.append(asyncio.get_running_loop().call_at(began + change.time, knowledge.update, assumed))

    def stop() -> None:
        for timer in timers:
            timer.cancel()

    return stop


class ClientBackend(Backend):
    """The backend of one action client of the caller in this process: nothing reports on the world, so all effects are assumed."""

    def __init__(self, client: ActionClient) -> None:
        self._client = client

    @property
    def client(self) -> ActionClient:
        """The client, which finds its servers itself."""
        return self._client

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Do nothing: the client is ready."""

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Do nothing: what the client carries out queries nothing."""

    async def refresh(self) -> None:
        """Do nothing: nothing has to be asked for."""

    async def close(self) -> None:
        """Do nothing: the client belongs to the caller."""


class SimulatedBackend(ClientBackend):
    """The backend of simulated robots in this process; under virtual time a run takes no time at all."""

    def __init__(self, robots: SimulatedRobots, assumed: frozenset[str] = frozenset()) -> None:
        super().__init__(robots)
        self.robots = robots
        self._assumed = assumed

    @property
    def missing(self) -> frozenset[str]:
        """The servers that have gone away, which do not come back."""
        return frozenset(self.robots.lost)

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Start the world's clock and its state reports."""
        report_changes(self.robots.world, knowledge, self._assumed)
        self.robots.begin()

    async def close(self) -> None:
        """Stop the world."""
        self.robots.close()
