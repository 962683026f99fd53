"""The link to one action server: its queue of goals, the goals that are under way, and what happens when it goes away.

A goal moves *queued* → *unanswered* → *accepted* → ended. One that is not answered in time is cancelled by its id, for its server may
be at work on it all the same; it ends when the server says so, does not know it for as long again, or is gone.

Everything here runs on the ROS thread, which also spins: `rclpy` sends a request before it registers its future, so a response that
another thread reads meanwhile is lost (ros2/rclpy#1123).

At most `IN_FLIGHT` goals are unanswered at a time: a server keeps the last 10 requests it has not yet read and silently
drops older ones, for which no answer ever comes. Goals are sent only after the handshake, see `pnm.ros.action_client.handshake`.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from functools import partial
from time import monotonic
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.requests import Accepted, OutcomeKind
from pnm.errors import InputError, PnmError
from pnm.ros.action_client.goal import OVER, UNKNOWN, Goal, message_in
from pnm.ros.action_client.handshake import Handshake, ros_uuid
from pnm.ros.action_client.liveness import AGAIN, ASKS, Liveness, Verdict
from pnm.ros.node.graph import absence, processes, server_name, types
from pnm.ros.node.messages import fields, import_type, to_data, to_message

IN_FLIGHT: Final = 8
"""Goals without an answer at a time."""
RETURN: Final = 5.0
"""Seconds that goals wait for a server that went away: how long a restart may take."""
DISCOVERY: Final = 5.0
"""Seconds in which a server that is running is discovered."""
RESENSED: Final = 1.0
"""Seconds from the notice of a restart until its goals are lost: sensors should report the new state before a retry."""
START: Final = 10.0
"""Seconds after the start of the node in which servers that are started together with it are expected."""
_DEPTH: Final = 1000
"""Unread responses that our client keeps; they come in bursts when many goals end together."""

_log = logging.getLogger(__name__)


class ServerLink:
    """The link to one action server, of a type that is given or found in the graph.

    The mutable state is the client and its handshake, once the type is known, until when a missing server is expected, whether
    something was answered twice, and the goals by how far they are.

    Args:
        several: whether there may be several servers of this name, all of which carry out every goal.
        joined: when the node joined the ROS graph, on the monotonic clock.
    """

    def __init__(self, node: Any, server: str, type_name: str | None, joined: float, *, several: bool = False) -> None:
        self._node = node
        self.name = server_name(node, server)
        self.wanted_type = type_name
        self.type: Any = import_type(type_name) if type_name else None
        self._several = several
        self._answered_twice = False
        self._client: Any = None
        self._expected_until = max(joined + START, monotonic() + DISCOVERY)
        self._queued: deque[Goal] = deque()
        self._unanswered: set[Goal] = set()
        self._accepted: set[Goal] = set()
        self._handshake: Any = None
        if self.type is not None:
            self._connect()

    def __repr__(self) -> str:
        return f"<ServerLink {self.name} {len(self._queued)} queued, {len(self._unanswered)} unanswered, {len(self._accepted)} accepted>"

    def ready(self) -> bool:
        """Return True if the server is there; connects to it when its type has become known."""
        is_there = self._is_reached()
        if is_there:  # polled on every look, so that the handshake is done before the first goal needs it
            self._expected_until = math.inf
            self._handshake.poll(processes(self._node, self.name), monotonic())
        elif self._expected_until == math.inf:  # it was there until now
            self._expected_until = monotonic() + RETURN
        return is_there

    def _is_reached(self) -> bool:
        if self._client is None and (known := types(self._node, self.name)):
            try:
                self.type = import_type(known[0])
            except InputError as error:
                _log.debug("%s: %s", self.name, error)
                return False
            self._connect()  # only now, because a client needs the type, which the graph shows once the server is there
            # The server is in the graph, but the new client has yet to be matched with it.
            self._expected_until = max(self._expected_until, monotonic() + DISCOVERY)
        return self._client is not None and bool(self._client.server_is_ready())

    def _connect(self) -> None:
        from rclpy.qos import QoSProfile  # here, because rclpy is an extra

        from pnm.ros.action_client.attentive_client import AttentiveClient

        deep = QoSProfile(depth=_DEPTH)  # the default keeps ten responses; more goals than that may end between two turns of the executor
        self._client = AttentiveClient(
            self._node,
            self.type,
            self.name,
            goal_service_qos_profile=deep,
            result_service_qos_profile=deep,
            cancel_service_qos_profile=deep,
            answered_twice=self._note_second_answer,
        )
        self._handshake = Handshake(self._client, self._pump)

    def _may_send(self) -> bool:
        """Return True if the handshake with the server, which is ready, is done, and it is the only one of its name."""
        present = processes(self._node, self.name)
        return bool(self._handshake.is_done(present, monotonic())) and not self._rivals(present)

    # several servers of one name

    def _rivals(self, present: frozenset[bytes]) -> str:
        """Return the reason to send nothing: other servers would carry it out as well; empty when there are none, or they are allowed."""
        self._answered_twice = self._answered_twice and len(present) > 1
        if self._several or not self._answered_twice:
            return ""
        return f"there are {len(present)} action servers {self.name}, all of which would carry out every goal (see `several_servers`)"

    def _note_second_answer(self, identity: UUID | None) -> None:
        """Note that two servers have answered one request; if it was a goal, have both of them cancel it."""
        self._answered_twice = True
        if identity is None or self._several:
            return
        goal = next((sent for sent in (*self._unanswered, *self._accepted) if sent.request.id == identity), None)
        if goal is not None:
            self.cancel(goal)
        else:
            self._handshake.handle(identity).cancel_goal_async()

    @property
    def is_busy(self) -> bool:
        """Whether `look` has work besides goals: to find the server's type, or to recall abandoned goals."""
        return self.type is None or bool(self._handshake and self._handshake.abandoned)

    def close(self) -> None:
        """Forget all goals without reports, and destroy the client."""
        for goal in (*self._queued, *self._unanswered, *self._accepted):
            goal.ended = True
        self._queued.clear()
        self._unanswered.clear()
        self._accepted.clear()
        if self._client is not None:
            self._client.destroy()

    # sending

    def send(self, goal: Goal) -> None:
        """Send the goal as soon as the server is there, the handshake is done, and few enough goals are unanswered."""
        self._queued.append(goal)
        self._pump()

    def _pump(self) -> None:
        # Asked for each goal: a dispatch may fail at once, and the server may go away meanwhile.
        while self._queued and sum(not goal.cancel_asked for goal in self._unanswered) < IN_FLIGHT and self.ready() and self._may_send():
            self._dispatch(self._queued.popleft())

    def _dispatch(self, goal: Goal) -> None:
        known = fields(self.type.Goal)
        # Half a goal message would be sent with zeros in the other fields, which the server takes for values.
        if unfilled := goal.unfilled(known):
            reason = f"{self.name} came when the goal had been filled; nobody has looked for values for {', '.join(unfilled)}"
            goal.end(OutcomeKind.UNAVAILABLE, reason)
            return
        try:
            message = to_message(self.type.Goal, goal.data(known))
            future = self._client.send_goal_async(message, goal_uuid=ros_uuid(goal.request.id))
        except PnmError as error:
            goal.end(OutcomeKind.REJECTED, f"goal for {self.name}: {error}")
            return
        except Exception as error:
            _log.exception("cannot send a goal to %s", self.name)
            goal.end(OutcomeKind.REJECTED, f"goal for {self.name} cannot be sent: {error}")
            return
        goal.sent = monotonic()
        if goal.postponed:
            goal.postpone(goal.sent)
        # The processes of this moment: one that appears later cannot have this goal.
        goal.liveness = Liveness(processes(self._node, self.name))
        self._unanswered.add(goal)
        future.add_done_callback(partial(self._answered, goal))

    def _answered(self, goal: Goal, future: Any) -> None:
        self._unanswered.discard(goal)
        now = monotonic()
        for later in self._unanswered:  # which a server that takes its time for each goal could not answer before
            if later.sent >= goal.sent:
                later.sent = now
                later.postpone(now)
        handle = future.result()
        if not handle.accepted:  # first of all, since a refusal ends the goal whatever else has happened to it
            goal.end(OutcomeKind.REJECTED, f"{self.name} rejected the goal")
        elif goal.ended:
            # It was accepted after its time limit, when the run had already gone on without it.
            handle.cancel_goal_async()
        else:
            goal.handle, goal.unknown_since = handle, None  # kept by us, because `rclpy` refers to handles only weakly
            goal.liveness = Liveness(processes(self._node, self.name), asked=monotonic())
            self._accepted.add(goal)
            goal.report(Accepted(goal.request.id))
            self._ask_result(goal)
            if goal.cancel_asked:  # it was asked for before there was a handle to cancel with
                self._send_cancel(goal)
        self._pump()  # a goal fewer is unanswered, so the next one may go

    # the end

    def _handle(self, goal: Goal) -> Any:
        """Return a handle of the goal, by its id alone if it was not accepted."""
        return goal.handle or self._handshake.handle(goal.request.id)

    def _ask_result(self, goal: Goal) -> None:
        future = self._handle(goal).get_result_async()
        goal.results.append(future)
        future.add_done_callback(partial(self._result, goal))

    def _result(self, goal: Goal, future: Any) -> None:
        if goal.ended or future.cancelled():  # several requests for the same result may be out; the first answer counts
            return
        answer = future.result()
        if answer.status == UNKNOWN:
            # Not over at once: the delay lets sensors report the new state first (`RESENSED`), or the server take the goal up.
            goal.unknown_since = goal.unknown_since or monotonic()
        elif answer.status in OVER:
            self._accepted.discard(goal)
            self._unanswered.discard(goal)
            result = to_data(answer.result)
            goal.end(OVER[answer.status], message_in(result), result)

    def _lose(self, goal: Goal, message: str) -> None:
        self._accepted.discard(goal)
        if not goal.unknown_since:  # a server that does not know the goal is not executing it
            self._handshake.abandon(goal.request.id, goal.handle)
        goal.end(OutcomeKind.LOST, message)
        for future in goal.results:  # their answers may still come when a link heals, for a goal that is over for us
            future.cancel()

    # cancelling

    def cancel(self, goal: Goal) -> None:
        """Request cancellation, now or as soon as the server has accepted the goal."""
        goal.cancel_asked = True
        if goal in self._queued:
            self._queued.remove(goal)
            goal.end(OutcomeKind.CANCELED, "cancelled before it was sent")
        elif goal in self._accepted or goal in self._unanswered:
            goal.cancel_answered = False  # a person may ask again after a refusal
            self._send_cancel(goal)

    def _send_cancel(self, goal: Goal) -> None:
        goal.cancel_sent = monotonic()
        self._handle(goal).cancel_goal_async().add_done_callback(partial(self._cancel_answered, goal))
        if goal in self._unanswered and all(future.done() for future in goal.results):
            self._ask_result(goal)

    def _cancel_answered(self, goal: Goal, future: Any) -> None:
        goal.cancel_answered = goal not in self._unanswered  # which the server may not have taken up yet
        if not future.result().goals_canceling and not goal.ended:
            _log.info("%s does not cancel %s", self.name, goal.request.action)

    # liveness

    def look(self) -> None:
        """Check the server and every goal that is under way; called a few times a second."""
        now = monotonic()
        self._look_at_queue(now)
        if self._unanswered or self._accepted:
            present = processes(self._node, self.name)  # one look at the graph for all goals, so that their verdicts agree
            for goal in tuple(self._unanswered):
                self._look_at_unanswered(goal, present, now)
            self._look_at_accepted(present, now)
        self._pump()
        if self._queued and self.ready() and self._may_send():  # then only the answers to others are waited for
            for goal in self._queued:
                if now - goal.postponed >= goal.accept / 4.0:
                    goal.postpone(now)

    def _look_at_queue(self, now: float) -> None:
        is_ready, reason = self.ready(), ""
        if not self._queued:
            return
        if is_ready:
            reason = self._rivals(processes(self._node, self.name))
        elif now >= self._expected_until:
            reason = absence(self._node, self.name, self.wanted_type)
        if reason:  # all queued goals together: they would all wait in vain for the same server
            while self._queued:
                self._queued.popleft().end(OutcomeKind.UNAVAILABLE, reason)
        elif is_ready and not self._may_send():
            abandoned = self._handshake.abandoned
            for goal in tuple(self._queued):
                goal.sent = goal.sent or now  # the limit counts from here: the server is ready, the goal could have been sent
                if now - goal.sent >= goal.accept:
                    given_up = f"did not end within {goal.accept:g} s what was given up: {abandoned} goal{'s' * (abandoned > 1)}"
                    self._queued.remove(goal)
                    goal.end(OutcomeKind.UNAVAILABLE, f"{self.name} {given_up if abandoned else _silence(goal)}")

    def _look_at_unanswered(self, goal: Goal, present: frozenset[bytes], now: float) -> None:
        verdict = goal.liveness.check(present, False, now)
        if verdict is Verdict.LOST:
            reason = "went away before it answered"
        elif verdict is Verdict.ASK and goal.liveness.asks == ASKS and not self._answered_twice:
            reason = "was restarted before it answered"
        elif goal.unknown_since and now - max(goal.unknown_since, goal.sent + goal.accept) >= goal.accept:
            reason = f"{_silence(goal)}, and does not know the goal"
        else:
            if now - goal.sent >= goal.accept and (goal.cancel_sent is None or now - goal.cancel_sent >= AGAIN):
                self.cancel(goal)
            return
        self._unanswered.discard(goal)
        # Gone from the graph, it may only be cut off and have the goal: it is recalled before the next one is sent.
        if verdict is Verdict.LOST:
            self._handshake.abandon(goal.request.id, None)
        goal.end(OutcomeKind.UNAVAILABLE, f"{self.name} {reason}")

    def _look_at_accepted(self, present: frozenset[bytes], now: float) -> None:
        requests = 0
        for goal in tuple(self._accepted):
            if requests == IN_FLIGHT:
                return  # like goals, requests for results must not overflow the server's queue; the rest has the next turn
            match goal.liveness.check(present, goal.over, now):
                case Verdict.ASK:
                    requests += 1
                    self._ask_result(goal)
                case Verdict.LOST:
                    self._lose(goal, f"{self.name} went away")
                case Verdict.SILENT:
                    self._accepted.discard(goal)
                    goal.end(OVER[goal.handle.status], "its result never came")
                case Verdict.FINE:
                    pass
            if goal.unknown_since and now - goal.unknown_since >= RESENSED:
                self._lose(goal, f"{self.name} no longer knows the goal; it was restarted")
            # Requests may be lost like any other, and cancelling twice does no harm.
            if not goal.ended and goal.wants_cancel and goal.cancel_sent is not None and now - goal.cancel_sent >= AGAIN:
                self._send_cancel(goal)


def _silence(goal: Goal) -> str:
    return f"did not answer within {goal.accept:g} s"
