"""Liveness of the server of a goal: when the goal is lost, and when its result must be requested again.

A server that dies sends nothing. But every server process publishes the status of its goals under a GID of its own, which
the ROS graph shows:

- The process is *gone* from the graph: at once after an orderly shutdown, after its lease (20 s) when it is killed
  or cut off. The goal is lost a moment later, unless the same process comes back.
- *Another* process appeared under the name: for the rest of the lease, a restart looks like this. The result is requested
  again: the new process answers that it knows no such goal. If it says on the status topic that it is at work on the goal,
  it goes on with what the other has accepted: both may have it from then on, see `pnm.ros.action_client.server_link`.
- The status topic says that the goal is *over*, but no result has arrived: it is requested again.

A server that is too busy to answer is never taken for dead, because none of the three is a question to it.
Nothing here does I/O or reads a clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

GRACE: Final = 3.0
"""Seconds for which a process may be missing from the graph before its goals are lost."""
AGAIN: Final = 1.0
"""Seconds between two requests for the same result."""
ASKS: Final = 5
"""The seconds between two requests of a result; a server keeps each request until it answers."""


class Verdict(Enum):
    """The treatment of a goal."""

    FINE = "nothing"
    ASK = "ask for the result"
    LOST = "the server went away"
    SILENT = "the goal is over but there is no result"


@dataclass
class Liveness:
    """Observations about the server of one goal. All fields change."""

    processes: frozenset[bytes]
    """The server's processes when the goal was accepted, by GID."""
    gone_since: float | None = None
    over_since: float | None = None
    asked: float = float("-inf")
    asks: int = 0
    seen: frozenset[bytes] = frozenset()
    """The processes that were present at the last look."""
    grace: float = GRACE
    """Seconds for which all of them may be missing from the graph."""

    def check(self, present: frozenset[bytes], over: bool, now: float) -> Verdict:
        """Return the verdict, given the present processes and whether the status topic says that the goal is over."""
        if present - self.seen:  # a process that has not been asked: the one that was may have died before it could answer
            self.asks = 0
        self.seen = present
        if not self.processes:  # the publisher was not discovered yet when the goal was accepted
            self.processes = present
        if not present & self.processes:  # none of the processes that may have the goal is left; another one under the name does not count
            if self.gone_since is None:
                self.gone_since = now
            if now - self.gone_since >= self.grace:  # a process may be missing from the graph for a moment while discovery is busy
                return Verdict.LOST
            return self._ask(now) if present else Verdict.FINE
        # It is back: an answer may have been lost meanwhile, so the result is requested again, with all attempts.
        if self.gone_since is not None:
            self.gone_since, self.asks = None, 0
            return self._ask(now)
        if over:
            if self.over_since is None:
                self.over_since, self.asks = now, 0
            if now - self.over_since < AGAIN:  # the result most often arrives right after the status; it is given a moment
                return Verdict.FINE
            if self.asks >= ASKS and now - self.asked >= AGAIN:
                return Verdict.SILENT
            return self._ask(now)
        return self._ask(now) if present - self.processes else Verdict.FINE

    def _ask(self, now: float) -> Verdict:
        if self.asks >= ASKS or now - self.asked < AGAIN:
            return Verdict.FINE
        self.asked, self.asks = now, self.asks + 1
        return Verdict.ASK
