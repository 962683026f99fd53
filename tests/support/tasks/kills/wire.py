"""The wire between a process that is killed and robots in another: Python values, one after the other, each whole or not there at all."""

from __future__ import annotations

import asyncio
import pickle
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final
from uuid import UUID

from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Report, Reporter, Request


@dataclass(frozen=True)
class Sent:
    """A request is sent."""

    request: Request


@dataclass(frozen=True)
class Reattached:
    """What has become of a request of another process is asked for."""

    request: Request
    accepted: bool


@dataclass(frozen=True)
class Cancelled:
    """A request is to be cancelled."""

    request: UUID


@dataclass(frozen=True)
class TaskTaken:
    """A client is told that its task is accepted."""

    task: UUID


_SIZE: Final = 4
"""Bytes that give the length of a value."""


class Wire:
    """One end of the wire.

    Args:
        end: a socket.
        hear: is called with every value that comes from the other end.
    """

    def __init__(self, end: socket.socket, hear: Callable[[object], None]) -> None:
        self._end = end
        self._end.setblocking(False)
        self._hear = hear
        self._unheard = b""

    async def listen(self) -> None:
        """Take in values until the other end is closed."""
        loop = asyncio.get_running_loop()
        with suppress(ConnectionError):
            while data := await loop.sock_recv(self._end, 1 << 16):
                self._unheard += data
                while len(self._unheard) >= _SIZE + (size := int.from_bytes(self._unheard[:_SIZE])):
                    text, self._unheard = self._unheard[_SIZE : _SIZE + size], self._unheard[_SIZE + size :]
                    self._hear(pickle.loads(text))
        self._end.close()

    def say(self, value: object) -> None:
        """Send a value; it is lost if the other end is closed."""
        text = pickle.dumps(value)
        with suppress(OSError):
            self._end.sendall(len(text).to_bytes(_SIZE) + text)


class DistantRobots:
    """The action client of a process whose robots are at the other end of a wire."""

    def __init__(self, end: socket.socket) -> None:
        self.wire = Wire(end, self._hear)
        self._reporters: dict[UUID, Reporter] = {}

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the names of the action's parameters."""
        return action.parameters

    def send(self, request: Request, report: Reporter, /) -> None:
        """Send a request."""
        self._reporters[request.id] = report
        self.wire.say(Sent(request))

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        """Ask what has become of a request."""
        self._reporters[request.id] = report
        self.wire.say(Reattached(request, accepted))

    def cancel(self, request: UUID, /) -> None:
        """Ask for a request to be cancelled."""
        self.wire.say(Cancelled(request))

    def _hear(self, report: Report) -> None:
        self._reporters[report.request](report)
