"""Carries out actions on the action servers of a ROS 2 system, whatever their type."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.bindings import ABOUT_THE_CALL, Bindings, Foreign
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Report, Reporter, Request
from pnm.errors import PnmError
from pnm.ros.action_client.connection import MayAct
from pnm.ros.action_client.goal import GRACE, Goal, Kept
from pnm.ros.action_client.server_link import ServerLink
from pnm.ros.node.graph import server_name
from pnm.ros.node.messages import fields
from pnm.ros.node.ros_thread import RosThread, call_on_loop

LOOK: Final = 0.25
"""Seconds between two looks at the goals that are under way."""
_log = logging.getLogger(__name__)
_CLOSED: Final = "the ROS 2 node was closed"
_Key = tuple[str, str | None, bool]
_AT_ONCE: Final = frozenset({OutcomeKind.SUCCEEDED, OutcomeKind.CANCELED})
"""Ends that are reported at once: the effects of the one are looked for, and the other is waited for."""


@dataclass(eq=False, repr=False)
class Ros2ActionClient:
    """An `ActionClient` for action servers of any type.

    A server that has not been reached yet is waited for, for a few seconds; a goal whose values do not fit
    its fields counts as rejected. Every request that was sent is answered by exactly one `Ended` until `close`,
    even when the ROS thread is closed before.

    The mutable state is on the ROS thread (the links, the open goals, and the requests whose cancelling has to wait), except `_closed`, and
    the ends that are to be reported; the reports on their way to the event loop are on both, and so are the missing servers.
    """

    ros: RosThread
    bindings: Bindings
    loop: asyncio.AbstractEventLoop
    ended: Callable[[UUID], Awaitable[object]] = lambda request: asyncio.sleep(0)
    """Called on the event loop's thread with each request that is over, before its end is reported, to have asked how the world is
    then. An end without success is reported when that is known: it decides whether there is another attempt."""
    others: Any = None
    """`pnm.ros.action_client.action_services.OtherGoals`: what servers are at work on that this process has not sent."""
    may_act: MayAct = lambda: True
    grace: float = GRACE
    """Seconds for which a server may be missing from the graph before the goals that it has accepted are lost."""
    missing: frozenset[str] = frozenset()
    """The servers that were waited for in vain, and were not there at the last look, by the names that bindings give them."""
    _links: dict[_Key, ServerLink] = field(default_factory=dict)
    _goals: dict[UUID, tuple[Goal, ServerLink]] = field(default_factory=dict)
    _uncancelled: set[UUID] = field(default_factory=set)
    _reports: deque[tuple[Reporter, Report]] = field(default_factory=deque)
    _ends: set[asyncio.Future[None]] = field(default_factory=set)
    _closed: bool = False
    _timer: Any = None

    def __post_init__(self) -> None:
        from pnm.ros.action_client.action_services import OtherGoals  # here, because rclpy is an extra

        self.others = self.others or OtherGoals(self.ros, may_act=self.may_act)
        self.ros.on_close(self._lose_all)

    # on the event loop's thread

    async def prepare(self, actions: Iterable[GroundAction], limit: float = 5.0) -> tuple[str, ...]:
        """Connect to the servers of the actions; return the names of those not there within `limit` seconds.

        Waits until a new node has discovered all others: there may be another server of the same name. It is no error when a server is
        missing: it is looked for again when a goal is sent to it.
        """
        keys = dict.fromkeys(map(self._key, actions))
        links = await self.ros.ask(lambda: [self._link(key) for key in keys])
        self.ros.call(self._keep_looking)
        until = monotonic() + limit
        while True:
            missing = await self.ros.ask(lambda: tuple(link.name for link in links if not link.connection.ready()))
            if not missing or monotonic() >= until:  # polled, because the ROS graph has no event for a single server
                return missing
            await asyncio.sleep(0.1)

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the names of the fields of the action's goal once its type is known."""
        link = self._links.get(self._key(action))
        return fields(link.connection.type.Goal) if link is not None and link.connection.type is not None else None

    def send(self, request: Request, report: Reporter, /) -> None:
        """Send the goal; `report` is called later, on the event loop's thread."""
        # Noted before the thread is left: the type may become known until the goal is dispatched.
        is_blind = _may_be_blind(request) and self.goal_fields(request.action) is None
        # Later and not at once: the caller does not expect a report before `send` has returned.
        if not self.ros.call(partial(self._send, request, report, is_blind=is_blind)):
            self.loop.call_soon(report, Ended(request.id, Outcome(OutcomeKind.UNAVAILABLE, message=_CLOSED)))

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        """Find out what has become of a goal that another process has sent, by its id; `report` is called later."""
        kept, is_blind = Kept.ACCEPTED if accepted else Kept.UNANSWERED, _may_be_blind(request)
        if not self.ros.call(partial(self._send, request, report, is_blind=is_blind, kept=kept)):
            self.loop.call_soon(report, Ended(request.id, Outcome(OutcomeKind.LOST, message=_CLOSED)))

    def cancel(self, request: UUID, /) -> None:
        """Ask for the request to be cancelled; it ends when the server says so, or not at all if it refuses."""
        self.ros.call(partial(self._cancel, request))

    def close(self) -> None:
        """Let go of all servers; goals still open are left to them, and nothing more is reported."""

        def end() -> None:
            if self._timer is not None:
                self._timer.destroy()
            for link in set(self._links.values()):
                link.close()
            self.others.close()
            self._goals.clear()

        if not self._closed:
            self._closed = True
            self.ros.call(end)

    def _pass_on(self) -> None:
        """Pass on the reports that are there, of all that the ROS thread has heard since the loop was woken."""
        while self._reports:
            report, what = self._reports.popleft()
            if not self._closed:  # one by one, since a reporter may fail
                self.loop.call_soon(partial(self._report_end, report) if isinstance(what, Ended) else report, what)

    def _report_end(self, report: Reporter, end: Ended) -> None:
        asked, at_once = self.ended(end.request), end.outcome.kind in _AT_ONCE

        async def report_then() -> None:
            await asked
            if not (at_once or self._closed):
                report(end)

        ending = asyncio.ensure_future(report_then())
        self._ends.add(ending)
        ending.add_done_callback(self._ends.discard)
        if at_once:
            report(end)

    def _key(self, action: GroundAction) -> _Key:
        binding = self.bindings.of(action.name)
        return self.bindings.server(action), binding.type, binding.several_servers

    # on the ROS thread

    def _link(self, key: _Key) -> ServerLink:
        """Return the link to a server: one for each, by whatever name and type bindings speak of it."""
        if key not in self._links:
            server, type_name, several = key
            name = server_name(self.ros.node, server)
            same = next((link for link in self._links.values() if link.name == name), None)
            if same is None:
                own = self.others, self.may_act, self.grace
                same = ServerLink(self.ros.node, server, type_name, self.ros.joined, several, *own)
            else:
                same.connection.expect(type_name, several=several)
            self._links[key] = same
        return self._links[key]

    def _send(self, request: Request, report: Reporter, *, is_blind: bool = False, kept: Kept | None = None) -> None:
        binding = self.bindings.of(request.action.name)
        foreign = binding.foreign or (Foreign.WAIT if self.bindings.resources(request.action) else Foreign.SHARE)
        timeout = self.bindings.timeout(request.action)
        goal = Goal(request, binding, partial(self._hear, report), kept, foreign, timeout, is_blind)
        try:
            link = self._link(self._key(request.action))
            self._goals[request.id] = goal, link
            link.send(goal)
        except PnmError as error:
            goal.end(OutcomeKind.UNAVAILABLE, str(error))
        except Exception as error:
            _log.exception("cannot send %s", request.action)
            goal.end(OutcomeKind.UNAVAILABLE, f"cannot be sent: {error}")
        self._keep_looking()

    def _cancel(self, request: UUID) -> None:
        if not self.may_act():
            self._uncancelled.add(request)
        elif request in self._goals:
            goal, link = self._goals[request]
            link.cancel(goal)

    def _hear(self, report: Reporter, what: Report) -> None:
        if isinstance(what, Ended):
            self._goals.pop(what.request, None)
        self._reports.append((report, what))
        if len(self._reports) == 1:  # else the loop has been woken, and has yet to look
            call_on_loop(self.loop, self._pass_on)

    def _keep_looking(self) -> None:
        """Have the timer run while, and only while, a goal is under way, a server is missing, or a link has something to look after."""
        if self._timer is None:
            self._timer = self.ros.timer(LOOK, self._look)
        elif self._timer.is_canceled():
            self._timer.reset()

    def _look(self) -> None:
        if not self.may_act():
            return
        while self._uncancelled:
            self._cancel(self._uncancelled.pop())
        now = monotonic()
        # Before the goals to a missing server end: whoever hears of that knows then that it is missing.
        self.missing = frozenset(name for (name, *_), link in self._links.items() if link.connection.is_missing(now))
        for link in set(self._links.values()):
            link.look(now)
        if not (self._goals or self.missing) and not any(link.is_busy for link in self._links.values()):
            self._timer.cancel()

    def _lose_all(self) -> None:
        for goal, _ in tuple(self._goals.values()):
            goal.end(OutcomeKind.LOST if goal.is_accepted else OutcomeKind.UNAVAILABLE, _CLOSED)


def _may_be_blind(request: Request) -> bool:
    """Return whether the values of a request may have been collected for all fields that a type may have."""
    return request.goal.keys() >= ABOUT_THE_CALL
