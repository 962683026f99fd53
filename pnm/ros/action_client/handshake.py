"""When is it safe to send a goal? Once the server has discovered our client and has ended every goal that we abandoned.

DDS discovery is not symmetric: a server that our client has found may not have found our client, and its responses are
lost then. So processes that serve the action are *probed* first: they are asked for the result of a goal that does not
exist, again and again until a response arrives. The result service is the last that a client announces, so a
server that has matched it has matched all.

Processes that leave the graph must be probed anew when they are back, because they have forgotten us as well: that is
how a network link looks that was cut and has healed. So must all after a time in which the graph was not looked at.

Two processes under one name are a server that was killed and is remembered until its lease ends, and another one, or two servers,
both of which would carry out every goal. A probe tells them apart: two servers answer it twice. So when there are several processes
there is some time for a second answer, and they are probed again and again.

A goal is *abandoned* when its server is taken for lost: the server may only be cut off, and go on with it. When it is
back it is asked to cancel the abandoned goals, and gets no new one until it has answered that they are over, or that it
does not know them. Everything here runs on the ROS thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from time import monotonic
from typing import Any, Final
from uuid import UUID, uuid4

from pnm.ros.action_client.liveness import AGAIN

SECOND_ANSWER: Final = 2.0
"""Seconds in which a second server answers a probe as well."""
SUSPICION: Final = 5.0
"""Seconds between two probes while there are several processes."""
UNWATCHED: Final = 2.0
"""Seconds between two looks at the graph after which all probes are repeated: a cut that both ends notice lasts longer."""


class Handshake:
    """The handshake with the processes that serve one action.

    The mutable state is the processes that have answered a probe and since when they have, when the graph was last looked at, when the
    last probe was sent, the abandoned goals, and when they were last recalled.

    Args:
        services: `pnm.ros.action_client.action_services.ActionServices`, of our client.
        changed: called when an answer has arrived, after which goals may be sent.
    """

    def __init__(self, services: Any, changed: Callable[[], None]) -> None:
        self._services = services
        self._changed = changed
        self._met: frozenset[bytes] | None = None
        self._met_at = -math.inf
        self._looked = -math.inf
        self._probed = -math.inf
        self._abandoned: set[UUID] = set()
        self._recalled = -math.inf

    def __repr__(self) -> str:
        return f"<Handshake {'open' if self._met is None else 'done'}, {len(self._abandoned)} goals abandoned>"

    @property
    def abandoned(self) -> int:
        """The number of abandoned goals that the server may still be executing."""
        return len(self._abandoned)

    def is_done(self, present: frozenset[bytes], now: float) -> bool:
        """Return True if all present processes have discovered us and none may be executing an abandoned goal."""
        return self.is_met(present, now) and not self._abandoned

    def is_met(self, present: frozenset[bytes], now: float) -> bool:
        """Return True if all present processes have discovered us, and there was time for all that are alive to show that."""
        # Processes that have left are forgotten, and so are all after a time in which a cut could have gone unnoticed.
        if self._met is not None:
            self._met = self._met & present if now - self._looked < UNWATCHED else None
        self._looked = now
        return self._met is not None and present <= self._met and (len(present) < 2 or now - self._met_at >= SECOND_ANSWER)

    def renew(self) -> None:
        """Probe all processes anew: one of them has answered what another one should have."""
        self._met = None
        self._probed = -math.inf

    def poll(self, present: frozenset[bytes], now: float) -> None:
        """Probe the present processes, or recall the abandoned goals; to be called when the server is ready."""
        is_done = self.is_done(present, now)
        is_met = self._met is not None and present <= self._met
        if not is_met or (len(present) > 1 and now - self._probed >= SUSPICION):
            if now - self._probed >= AGAIN:  # probes are lost silently until the server has discovered us, so they are repeated
                self._probed = now
                self._services.ask_result(uuid4(), partial(self._on_answer, present))
        elif not is_done and now - self._recalled >= AGAIN:
            # only now: before the probes are answered, an answer about a goal would be lost
            self._recalled = now
            for goal in self._abandoned:
                self._services.cancel_goal(goal)
                self._services.ask_result(goal, partial(self._on_recalled, goal))

    def abandon(self, goal: UUID) -> None:
        """Note an abandoned goal, which may never have been accepted."""
        self._abandoned.add(goal)

    def _on_answer(self, present: frozenset[bytes], response: object) -> None:
        # The processes present when the probe was sent: one that came later may not have discovered us yet.
        if self._met is None or not present <= self._met:
            self._met_at = monotonic()
        self._met = present
        self._changed()

    def _on_recalled(self, goal: UUID, response: object) -> None:
        """Any answer ends an abandoned goal: it is over, or the server does not know it."""
        # Several recalls of the same goal may be answered; only the last abandoned goal opens the way.
        if goal in self._abandoned:
            self._abandoned.discard(goal)
            if not self._abandoned:
                self._changed()
