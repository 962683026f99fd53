"""The connection to one action server: its type, our client, the handshake, and whether there is one server of the name, none, or several.

Everything here runs on the ROS thread.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from typing import Any, Final, TypeAlias
from uuid import UUID, uuid4

from pnm.errors import InputError
from pnm.ros.action_client.goal import AGAIN
from pnm.ros.node.graph import absence, processes, server_name, servers, types
from pnm.ros.node.messages import import_type

RETURN: Final = 5.0
"""Seconds that goals wait for a server that went away: how long a restart may take."""
DISCOVERY: Final = 5.0
"""Seconds in which a server that is running is discovered."""
START: Final = 10.0
"""Seconds after the start of the node in which servers that are started together with it are expected."""
FRESH: Final = 0.02
"""Seconds for which one look at the processes in the graph counts: goals by the hundred are sent in less."""
_UNREAD: Final = 100
"""Messages of feedback that wait to be looked at: in a quarter of a second there are fewer, or the last ones do."""
MayAct: TypeAlias = Callable[[], bool]
"""Whether something may be sent or cancelled; asked on the ROS thread, right before that. What may not be is kept until it may."""
_log = logging.getLogger(__name__)


@dataclass(eq=False, repr=False)
class Connection:
    """The connection to one action server, of a type that is given or found in the graph.

    The mutable state is our client, that of the services and the feedback, and its handshake, once the type is known, the last look at
    the processes, until when a missing server is expected, and when something was answered twice last.
    """

    node: Any
    server: str
    wanted_type: str | None
    joined: float
    """The time at which the node joined the ROS graph, on the monotonic clock."""
    several: bool
    """Whether there may be several servers of this name, all of which carry out every goal."""
    changed: Callable[[], None]
    """Called when goals may be sent that could not be sent before."""
    doubled: Callable[[UUID], None]
    """Called with a goal that several servers have answered, though there may not be several."""
    may_act: MayAct
    services: Any = None
    handshake: Any = None
    _feedback: Any = None
    _doubled_at: float = -math.inf
    _processes: frozenset[bytes] = frozenset()
    _looked: float = -math.inf

    def __post_init__(self) -> None:
        self.name = server_name(self.node, self.server)
        self.type: Any = import_type(self.wanted_type) if self.wanted_type else None
        self._expected_until = max(self.joined + START, monotonic() + DISCOVERY)
        if self.type is not None:
            self._connect()

    def expect(self, type_name: str | None, *, several: bool) -> None:
        """Note another binding of the same server; raise an `InputError` if they contradict each other."""
        self.several = self.several or several
        if type_name is None or type_name == self.wanted_type:
            return
        if self.wanted_type is None and self.type is None:
            self.wanted_type, self.type = type_name, import_type(type_name)
            self._connect()
        elif import_type(type_name) is not self.type:
            other = self.wanted_type or f"{self.type.__module__.split('.')[0]}/action/{self.type.__name__}"
            raise InputError(f"the action server {self.name} is bound with two types: {other} and {type_name}")

    def ready(self) -> bool:
        """Return True if the server is there; connects to it when its type has become known."""
        is_there = self._is_reached()
        if is_there:  # polled on every look, so that the handshake is done before the first goal needs it
            self._expected_until = math.inf
            self.handshake.poll(self.processes(), monotonic())
        elif self._expected_until == math.inf:  # it was there until now
            self._expected_until = monotonic() + RETURN
        return is_there

    def _is_reached(self) -> bool:
        if self.services is None and (known := types(self.node, self.name)):
            try:
                self.type = import_type(known[0])
            except InputError as error:
                _log.debug("%s: %s", self.name, error)
                return False
            self._connect()  # only now, because a client needs the type, which the graph shows once the server is there
            # The server is in the graph, but the new client has yet to be matched with it.
            self._expected_until = max(self._expected_until, monotonic() + DISCOVERY)
        return self.services is not None and self.services.is_served() and bool(self.processes())

    def _connect(self) -> None:
        from pnm.ros.action_client.action_services import ActionServices, UnheardTopic  # here, because rclpy is an extra

        def twice(goal: UUID | None) -> None:
            """Note that two servers have answered one request, and the goal that it has sent, if it was one."""
            self._doubled_at = monotonic()
            if goal is not None and not self.several:
                self.doubled(goal)

        kind = self.type.Impl.FeedbackMessage
        self.services = ActionServices(self.node, self.type, self.name, answered_twice=twice, may_act=self.may_act)
        self._feedback = UnheardTopic(self.node, kind, f"{self.name}/_action/feedback", _UNREAD)
        self.handshake = Handshake(self.services, self.changed)

    def feedback(self) -> dict[UUID, Any]:
        """Return the latest feedback about each goal of which there is some since the last time."""
        messages = self._feedback.take() if self._feedback else ()
        return {UUID(bytes=bytes(message.goal_id.uuid)): message.feedback for message in messages}

    def is_missing(self, now: float) -> bool:
        """Return whether the server is not there, and is not expected any more."""
        return not self.ready() and now >= self._expected_until

    def give_up(self, now: float) -> bool:
        """Expect the server no more; return whether it was missing already, or will be at the next look, if it is not there by then."""
        is_missing = self.is_missing(now)
        self._expected_until = min(self._expected_until, now)
        return is_missing

    def absence(self, now: float) -> str:
        """Return why the server, which is not ready, is not expected any more; empty while it is."""
        return absence(servers(self.node), self.name, self.wanted_type) if now >= self._expected_until else ""

    def processes(self) -> frozenset[bytes]:
        """Return the processes that serve the action."""
        if (now := monotonic()) - self._looked >= FRESH:
            self._processes, self._looked = processes(self.node, self.name), now
        return self._processes

    def may_send(self) -> bool:
        """Return True if the handshake with the server, which is ready, is done, and it is the only one of its name."""
        present = self.processes()
        return bool(self.handshake.is_done(present, monotonic())) and not self.rivals(present)

    @property
    def abandoned(self) -> int:
        """The number of abandoned goals that the server may still be executing."""
        return len(self.handshake.abandoned) if self.handshake else 0

    def close(self) -> None:
        """Destroy the client."""
        if self.services is not None:
            self.services.destroy()
            self._feedback.destroy()

    # several servers of one name

    def are_several(self, present: frozenset[bytes]) -> bool:
        """Return whether several servers of the name are alive, as far as is known."""
        # Of servers that have answered, the graph of a busy machine may show one a little later.
        return (len(present) > 1 and self._doubled_at > -math.inf) or monotonic() - self._doubled_at < DISCOVERY

    def are_unclear(self, present: frozenset[bytes]) -> bool:
        """Return whether it is not known yet how many of several processes are alive."""
        return len(present) > 1 and not (self.are_several(present) or self.handshake.is_met(present, monotonic()))

    def rivals(self, present: frozenset[bytes]) -> str:
        """Return why nothing may be sent: other servers would carry it out as well; empty when there are none, or they are allowed."""
        if not self.are_several(present):
            self._doubled_at = -math.inf
        elif not self.several:
            number = max(2, len(present))
            return f"there are {number} action servers {self.name}, all of which would carry out every goal (see `several_servers`)"
        return ""


# --- when is it safe to send a goal? -------------------------------------------------------
# Once the server has discovered our client and has ended every goal that we abandoned.
#
# DDS discovery is not symmetric: a server that our client has found may not have found our client, and its responses are
# lost then. So processes that serve the action are *probed* first: they are asked for the result of a goal that does not
# exist, again and again until a response arrives. The result service is the last that a client announces, so a
# server that has matched it has matched all.
#
# Processes that leave the graph must be probed anew when they are back, because they have forgotten us as well: that is
# how a network link looks that was cut and has healed. So must all after a time in which the graph was not looked at.
#
# Two processes under one name are a server that was killed and is remembered until its lease ends, and another one, or two servers,
# both of which would carry out every goal. A probe tells them apart: two servers answer it twice. So when there are several processes
# there is some time for a second answer, and they are probed again and again.
#
# A goal is *abandoned* when its server is taken for lost: the server may only be cut off, and go on with it. When it is
# back it is asked to cancel the abandoned goals, and gets no new one until it has answered that they are over, or that it
# does not know them. Everything here runs on the ROS thread.

SECOND_ANSWER: Final = 2.0
"""Seconds in which a second server answers a probe as well."""
SUSPICION: Final = 5.0
"""Seconds between two probes while there are several processes."""
UNWATCHED: Final = 2.0
"""Seconds between two looks at the graph after which all probes are repeated: a cut that both ends notice lasts longer."""


@dataclass(eq=False, repr=False)
class Handshake:
    """The handshake with the processes that serve one action. All fields but the first two change."""

    services: Any
    """`pnm.ros.action_client.action_services.ActionServices`, of our client."""
    changed: Callable[[], None]
    """Called when an answer has arrived, after which goals may be sent."""
    abandoned: set[UUID] = field(default_factory=set)
    """Goals that the server may still be executing, or may never have accepted."""
    _met: frozenset[bytes] | None = None
    """The processes that have answered a probe."""
    _met_at: float = -math.inf
    _looked: float = -math.inf
    """The time of the last look at the graph."""
    _probed: float = -math.inf
    _recalled: float = -math.inf
    """The time at which the abandoned goals were recalled last."""

    def is_done(self, present: frozenset[bytes], now: float) -> bool:
        """Return True if all present processes have discovered us and none may be executing an abandoned goal."""
        return self.is_met(present, now) and not self.abandoned

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
                self.services.ask_result(uuid4(), partial(self._on_answer, present))
        elif not is_done and now - self._recalled >= AGAIN:
            # only now: before the probes are answered, an answer about a goal would be lost
            self._recalled = now
            for goal in self.abandoned:
                self.services.cancel_goal(goal)
                self.services.ask_result(goal, partial(self._on_recalled, goal))

    def _on_answer(self, present: frozenset[bytes], response: object) -> None:
        # The processes present when the probe was sent: one that came later may not have discovered us yet.
        if self._met is None or not present <= self._met:
            self._met_at = monotonic()
        self._met = present
        self.changed()

    def _on_recalled(self, goal: UUID, response: object) -> None:
        """Any answer ends an abandoned goal: it is over, or the server does not know it."""
        # Several recalls of the same goal may be answered; only the last abandoned goal opens the way.
        if goal in self.abandoned:
            self.abandoned.discard(goal)
            if not self.abandoned:
                self.changed()
