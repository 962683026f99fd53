"""The link to one action server: its queue of goals, the goals that are under way, and what happens when it goes away.

A goal moves *queued* → *unanswered* → *accepted* → ended. One that is not answered in time is cancelled by its id, for its server may
be at work on it all the same; it ends when the server says so, does not know it for as long again, or is gone.

Everything here runs on the ROS thread, which also spins: the number of a request is known only when it has been sent, so a response that
another thread reads meanwhile would be lost (as in ros2/rclpy#1123).

At most `IN_FLIGHT` goals are unanswered at a time: a server keeps the last 10 requests it has not yet read and silently
drops older ones, for which no answer ever comes. Goals are sent only after the handshake, see `pnm.ros.action_client.connection`.
"""

from __future__ import annotations

import logging
from collections import deque
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any, Final
from uuid import UUID

from pnm.core.machine.bindings import Foreign
from pnm.core.machine.requests import Accepted, OutcomeKind
from pnm.errors import PnmError, counted
from pnm.ros.action_client.connection import Connection, MayAct
from pnm.ros.action_client.goal import AGAIN, OVER, UNKNOWN, Goal, Liveness, Verdict
from pnm.ros.node.messages import fields, fitted_binding, to_data, to_message

if TYPE_CHECKING:
    from pnm.ros.action_client.action_services import OtherGoals  # which needs rclpy, an extra

IN_FLIGHT: Final = 8
"""Goals without an answer at a time."""
RESENSED: Final = 1.0
"""Seconds from the notice of a restart until its goals are lost: sensors should report the new state before a retry."""
FOUND: Final = 2.0
"""Seconds in which a server says that it does not know a goal that another process has sent; it is at work on it otherwise."""
_log = logging.getLogger(__name__)


class ServerLink:
    """The link to one action server. The mutable state is the goals by how far they are, and that of the connection.

    Args:
        others: what servers are at work on that this process has not sent.
        grace: seconds for which the server may be missing from the graph before its goals are lost.
        node, server, type_name, joined, several, may_act: see `Connection`; goals are not sent, either, when they may not be.
    """

    def __init__(
        self, node: Any, server: str, type_name: str | None, joined: float, several: bool, others: OtherGoals, may_act: MayAct, grace: float
    ) -> None:
        self._others = others
        self._may_act = may_act
        self._grace = grace
        self._queued: deque[Goal] = deque()
        self._unanswered: set[Goal] = set()
        self._accepted: set[Goal] = set()
        self.connection = Connection(node, server, type_name, joined, several, self._pump, self._stop_doubled, may_act)
        self.name = self.connection.name
        self._at_work()

    @property
    def is_busy(self) -> bool:
        """Whether `look` has work besides goals: to find the server's type, or to recall abandoned goals."""
        return self.connection.type is None or self.connection.abandoned > 0

    def close(self) -> None:
        """Forget all goals without reports, and destroy the client."""
        for goal in (*self._queued, *self._unanswered, *self._accepted):
            goal.ended = True
        self._queued.clear()
        self._unanswered.clear()
        self._accepted.clear()
        self.connection.close()

    # sending

    def send(self, goal: Goal) -> None:
        """Send the goal as soon as the server is there, the handshake is done, and few enough goals are unanswered."""
        goal.postponed = monotonic()
        self._others.sent(goal.request.id)
        self._queued.append(goal)
        self._pump()

    def _pump(self) -> None:
        # Asked for each goal: a dispatch may fail at once, and the server may go away meanwhile.
        while self._queued and sum(not goal.cancel_asked for goal in self._unanswered) < IN_FLIGHT and self._may_send():
            if self._waits(self._queued[0]):
                break
            goal = self._queued.popleft()
            (self._find if goal.kept else self._send)(goal)

    def _waits(self, goal: Goal) -> bool:
        """Return whether a goal must wait until the server is done with what this process has not sent."""
        if goal.kept:
            return False
        if goal.foreign is Foreign.SHARE and not self._others.may_forget:
            return False
        others = self._others.others(self.name, self.connection.processes())
        if goal.foreign is Foreign.SHARE:
            return self._others.are_forgotten(others)
        if others and goal.foreign is Foreign.CANCEL:
            self._others.cancel(self.name, others)
        return bool(others) or not self._others.is_heard(self.name)

    def _may_send(self) -> bool:
        return self._may_act() and self.connection.ready() and self.connection.may_send()

    def _find(self, goal: Goal) -> None:
        """Ask for the result of a goal that another process has sent; a server that does not know it says so, all others are at work."""
        goal.binding, goal.is_accepted = fitted_binding(goal.binding, self.connection.type), True
        goal.sent = monotonic()
        goal.liveness = Liveness(self.connection.processes(), asked=goal.sent, grace=self._grace)
        self._accepted.add(goal)
        self._ask_result(goal)
        if goal.cancel_asked:  # before anything could be sent
            self._send_cancel(goal)

    def _send(self, goal: Goal) -> None:
        known = fields(self.connection.type.Goal)
        # Half a goal message would be sent with zeros in the other fields, which the server takes for values.
        if unfilled := goal.unfilled(known):
            reason = f"{self.name} appeared after the goal was filled; there are no values for {', '.join(unfilled)}"
            goal.end(OutcomeKind.UNAVAILABLE, reason)
            return
        try:
            goal.binding = fitted_binding(goal.binding, self.connection.type)
            message = to_message(self.connection.type.Goal, goal.data(known))
            self.connection.services.send_goal(goal.request.id, message, partial(self._answered, goal))
        except PnmError as error:
            goal.end(OutcomeKind.REJECTED, f"goal for {self.name}: {error}")
            return
        except Exception as error:
            _log.exception("cannot send a goal to %s", self.name)
            goal.end(OutcomeKind.REJECTED, f"goal for {self.name} cannot be sent: {error}")
            return
        goal.sent = monotonic()
        goal.postpone(goal.sent, goal.binding.accept / 4.0)
        # The processes of this moment: one that appears later cannot have this goal.
        goal.liveness = Liveness(self.connection.processes())
        self._unanswered.add(goal)

    def _answered(self, goal: Goal, response: Any) -> None:
        self._unanswered.discard(goal)
        now = monotonic()
        for later in self._unanswered:  # which a server that takes its time for each goal could not answer before
            if later.sent >= goal.sent:
                later.sent = now
                later.postpone(now, later.binding.accept / 4.0)  # if the answers come in quick succession, the next look does
        if not response.accepted:  # first of all, since a refusal ends the goal whatever else has happened to it
            goal.end(OutcomeKind.REJECTED, f"{self.name} rejected the goal")
        elif goal.ended:
            # It was accepted after its time limit, when the run had already gone on without it.
            self.connection.services.cancel_goal(goal.request.id)
        elif goal not in self._accepted:
            self._take_as_accepted(goal)
        self._pump()  # a goal fewer is unanswered, so the next one may go

    def _take_as_accepted(self, goal: Goal) -> None:
        goal.is_accepted, goal.unknown_since = True, None
        goal.liveness = Liveness(self.connection.processes(), asked=monotonic(), grace=self._grace)
        self._accepted.add(goal)
        goal.report(Accepted(goal.request.id))
        self._ask_result(goal)
        if goal.cancel_asked:  # the server may not have known it then
            self._send_cancel(goal)

    # the end

    def _ask_result(self, goal: Goal) -> None:
        goal.results_asked += 1
        self.connection.services.ask_result(goal.request.id, partial(self._result, goal))

    def _result(self, goal: Goal, answer: Any) -> None:
        goal.results_asked -= 1
        if goal.ended:  # several requests for the same result may be out; the first answer counts
            return
        if answer.status == UNKNOWN:
            # Not over at once: the delay lets sensors report the new state first (`RESENSED`), or the server take the goal up.
            if goal.unknown_since is None and not self.connection.are_several(self.connection.processes()):
                goal.unknown_since = monotonic()
                self.connection.handshake.renew()  # it may be another server that says so, while the goal's own is at work on it
        elif answer.status in OVER:
            self._accepted.discard(goal)
            self._unanswered.discard(goal)
            goal.finish(answer.status, to_data(answer.result))

    def _lose(self, goal: Goal, message: str) -> None:
        self._accepted.discard(goal)
        if not goal.unknown_since:  # a server that does not know the goal is not executing it
            self.connection.handshake.abandoned.add(goal.request.id)
        goal.end(OutcomeKind.LOST, message)
        self.connection.services.forget_result(goal.request.id)

    # cancelling

    def cancel(self, goal: Goal) -> None:
        """Request cancellation, now or as soon as the server has accepted the goal."""
        goal.cancel_asked = True
        if goal in self._queued and not goal.kept:  # what another process has sent may be executed, and is cancelled when it is found
            self._queued.remove(goal)
            goal.end(OutcomeKind.CANCELED, "cancelled before it was sent")
        elif goal in self._accepted or goal in self._unanswered:
            goal.cancel_answered = False  # a person may ask again after a refusal
            self._send_cancel(goal)

    def _send_cancel(self, goal: Goal) -> None:
        def answered(response: Any) -> None:
            goal.cancel_answered = goal not in self._unanswered  # which the server may not have taken up yet
            if not response.goals_canceling and not goal.ended:
                _log.info("%s does not cancel %s", self.name, goal.request.action)

        goal.cancel_sent = monotonic()
        self.connection.services.cancel_goal(goal.request.id, answered)
        if goal in self._unanswered and not goal.results_asked:
            self._ask_result(goal)

    # several servers of one name

    def _stop_doubled(self, identity: UUID) -> None:
        """Have all servers cancel a goal that several of them have answered."""
        self._stop_for_rivals(self.connection.processes())
        if all(goal.request.id != identity for goal in (*self._unanswered, *self._accepted)):  # one of them has ended it, or rejected it
            self.connection.services.cancel_goal(identity)

    def _stop_for_rivals(self, present: frozenset[bytes]) -> None:
        """Cancel all goals if there are several servers that all would carry them out, but are not to."""
        if rivals := self.connection.rivals(present):
            for goal in (*self._unanswered, *self._accepted):
                if not goal.refused:
                    goal.refused = rivals
                    self.cancel(goal)

    # liveness

    def look(self, now: float) -> None:
        """Check the server and every goal that is under way; called a few times a second."""
        self._look_at_queue(now)
        if self._unanswered or self._accepted:
            present = self.connection.processes()  # one look at the graph for all goals, so that their verdicts agree
            self._stop_for_rivals(present)
            for goal in tuple(self._unanswered):
                goal.postpone(goal.sent, 0.0)
                self._look_at_unanswered(goal, present, now)
            latest = self.connection.feedback()
            for goal in (*self._unanswered, *self._accepted):
                goal.feedback = latest.get(goal.request.id, goal.feedback)
                if goal.is_accepted:
                    goal.report_feedback()
            self._look_at_accepted(present, now)
        self._pump()
        if self._queued and self._may_send():  # then only the answers to others are waited for
            for goal in self._queued:
                goal.postpone(now, goal.binding.accept / 4.0)

    def _look_at_queue(self, now: float) -> None:
        is_ready = self.connection.ready()
        if not self._queued:
            return
        reason = self.connection.rivals(self.connection.processes()) if is_ready else self.connection.absence(now)
        if reason:  # all queued goals together: they would all wait in vain for the same server
            while self._queued:
                goal = self._queued.popleft()
                if goal.kept and self.connection.handshake:  # it may be at work on it, where it cannot be reached
                    self.connection.handshake.abandoned.add(goal.request.id)
                goal.end(OutcomeKind.LOST if goal.kept else OutcomeKind.UNAVAILABLE, reason)
        elif is_ready and not self.connection.may_send():
            abandoned = self.connection.abandoned
            for goal in [goal for goal in self._queued if not goal.kept]:  # the limits of a run are those of what it has begun
                goal.sent = goal.sent or now  # the limit counts from here: the server is ready, the goal could have been sent
                if now - goal.sent >= goal.binding.accept:
                    given_up = f"did not end {counted(abandoned, 'abandoned goal')} within {goal.binding.accept:g} s"
                    self._queued.remove(goal)
                    goal.end(OutcomeKind.UNAVAILABLE, f"{self.name} {given_up if abandoned else _silence(goal)}")
        elif is_ready and self._waits(self._queued[0]):
            for goal in [goal for goal in self._queued if not goal.kept]:
                if goal.waits_since is None and self._others.others(self.name, self.connection.processes()):
                    goal.waits_since = now
                    _log.warning("%s waits: %s is at work on goals of other programs", goal.request.action, self.name)
                elif goal.waits_since is not None and now - goal.waits_since >= goal.timeout:
                    self._queued.remove(goal)
                    reason = f"{self.name} was at work on goals of other programs for {goal.timeout:g} s"
                    goal.end(OutcomeKind.UNAVAILABLE, reason)

    def _look_at_unanswered(self, goal: Goal, present: frozenset[bytes], now: float) -> None:
        verdict = goal.liveness.check(present, False, now)
        if verdict is not Verdict.FINE and goal.request.id in self._at_work():  # its process died before it could answer,
            self._unanswered.discard(goal)  # but had kept it: another one goes on with it
            self._take_as_accepted(goal)
            return
        if verdict is Verdict.LOST:
            if not (present or self.connection.give_up(now)):
                return  # whoever hears that it went away is to know that it is missing
            reason = "went away before it answered"
        elif verdict is Verdict.ASK and goal.liveness.has_asked and not self.connection.are_several(present):
            reason = "was restarted before it answered"
        elif goal.unknown_since and now - max(goal.unknown_since, goal.sent + goal.binding.accept) >= goal.binding.accept:
            reason = f"{_silence(goal)}, and does not know the goal"
        else:
            if now - goal.sent >= goal.binding.accept and (goal.cancel_sent is None or now - goal.cancel_sent >= AGAIN):
                self.cancel(goal)
            return
        self._unanswered.discard(goal)
        # Gone from the graph, it may only be cut off and have the goal: it is recalled before the next one is sent.
        if verdict is Verdict.LOST:
            self.connection.handshake.abandoned.add(goal.request.id)
        goal.end(OutcomeKind.UNAVAILABLE, f"{self.name} {reason}")

    def _at_work(self) -> frozenset[UUID]:
        """Return the goals that the server is at work on, as far as it was heard."""
        return self._others.watch(self.name, self.connection.processes())

    def _look_at_accepted(self, present: frozenset[bytes], now: float) -> None:
        requests, at_work = 0, self._at_work()
        for goal in tuple(self._accepted):
            if goal.kept and goal.unknown_since is None and now - goal.sent >= FOUND:
                goal.kept = None
                goal.report(Accepted(goal.request.id))
            if requests == IN_FLIGHT:
                return  # like goals, requests for results must not overflow the server's queue; the rest has the next turn
            goal.status = self._others.status(self.name, goal.request.id) or goal.status
            if goal.request.id in at_work:  # if another process says so, it goes on with what one that died has accepted
                goal.liveness.processes |= present
            match goal.liveness.check(present, goal.status in OVER, now):
                case Verdict.ASK:
                    requests += 1
                    self._ask_result(goal)
                case Verdict.LOST:
                    self._lose(goal, f"{self.name} went away")
                case Verdict.SILENT:
                    self._accepted.discard(goal)
                    goal.end(OVER[goal.status], "its result never came")
                case Verdict.FINE:
                    pass
            if goal.unknown_since and self.connection.are_several(present):
                goal.unknown_since = None  # it was another server that does not know it
            elif goal.unknown_since and now - goal.unknown_since >= RESENSED and goal.may_be_resent:
                self._accepted.discard(goal)
                goal.kept = goal.unknown_since = None
                goal.is_accepted, goal.status, goal.is_resent = False, UNKNOWN, True
                if goal.cancel_asked:
                    goal.end(OutcomeKind.CANCELED, "cancelled before it was sent")
                else:
                    self.send(goal)
            elif goal.unknown_since and now - goal.unknown_since >= RESENSED and not self.connection.are_unclear(present):
                self._lose(goal, f"{self.name} no longer knows the goal; it was restarted")
            # Requests may be lost like any other, and cancelling twice does no harm.
            if (
                not goal.ended
                and goal.cancel_asked
                and not goal.cancel_answered
                and goal.cancel_sent is not None
                and now - goal.cancel_sent >= AGAIN
            ):
                self._send_cancel(goal)


def _silence(goal: Goal) -> str:
    return f"did not answer within {goal.binding.accept:g} s"
