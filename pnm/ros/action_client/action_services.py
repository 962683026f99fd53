"""Our client of the three services of an action server: a goal is sent, cancelled, and asked for its result; and goals of others there.

An action is three services and two topics. The action client of `rclpy` subscribes to both topics, and reads the status of every goal
that the server remembers whenever one of them changes, which is many times the work of the services.

The executor of `rclpy` takes one answer a turn, by way of a future and a task. Here all answers that are there are taken in one turn, and
passed on at once. Two answers to one request mean that two servers of one name are alive.

Everything here runs on the ROS thread.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, Final
from uuid import UUID

from action_msgs.msg import GoalInfo, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from rclpy.waitable import NumberOfEntities, Waitable
from unique_identifier_msgs import msg

from pnm.ros.action_client.goal import AGAIN
from pnm.ros.node.graph import processes
from pnm.ros.node.ros_thread import RosThread

_QOS: Final = QoSProfile(depth=1000)
"""Unread answers that are kept; by default it is ten, and more goals than that may end between two turns of the executor."""
_REMEMBERED: Final = 1000
"""Requests of a service whose second answer is noticed."""
_UNANSWERED: Final = 20_000
"""Requests of a service that wait for answers: a server that hangs gets some every second, and answers none."""
_log = logging.getLogger(__name__)
Answered = Callable[[Any], object]
"""Called with the response to a request."""


@dataclass(eq=False)
class _Service:
    """One of the services. The mutable state is its place in the wait set, the requests without an answer, and those answered last."""

    client: Any
    place: int = 0
    requests: dict[int, tuple[UUID, Answered]] = field(default_factory=dict)
    answered: dict[int, UUID] = field(default_factory=dict)
    """The goals of these requests."""

    def send(self, goal: UUID, request: Any, answered: Answered) -> None:
        self.requests[self.client.handle.send_request(request)] = goal, answered
        if len(self.requests) > _UNANSWERED:
            del self.requests[next(iter(self.requests))]

    def take(self) -> Iterator[tuple[int, Any]]:
        """Yield the answers that are there, with the numbers of their requests."""
        try:
            while True:
                header, response = self.client.handle.take_response(self.client.srv_type.Response)
                if header is None:
                    return
                yield header.request_id.sequence_number, response
        except Exception:  # those that were taken are passed on all the same
            _log.exception("answers of %s cannot be taken", self.client.srv_name)


class ActionServices(Waitable):  # type: ignore[misc]
    """The client of an action server's services.

    `answered_twice` is called when a request was answered twice, with the goal if the request has sent one. `may_act` is asked right before
    something is cancelled; what may not be is as a request that got lost.
    """

    def __init__(
        self,
        node: Any,
        action_type: Any,
        server: str,
        *,
        answered_twice: Callable[[UUID | None], None],
        may_act: Callable[[], bool] = lambda: True,
    ) -> None:
        super().__init__(node.default_callback_group)
        self._node = node
        self._answered_twice = answered_twice
        self._may_act = may_act
        self._goal_request = action_type.Impl.SendGoalService.Request
        self._result_request = action_type.Impl.GetResultService.Request

        def connect(kind: Any, name: str) -> _Service:
            return _Service(node.create_client(kind, f"{server}/_action/{name}", qos_profile=_QOS, callback_group=Unheard()))

        self._goals = connect(action_type.Impl.SendGoalService, "send_goal")
        self._cancels = connect(CancelGoal, "cancel_goal")
        self._results = connect(action_type.Impl.GetResultService, "get_result")  # last, see `pnm.ros.action_client.connection`
        self._services = (self._goals, self._cancels, self._results)
        node.add_waitable(self)

    def is_served(self) -> bool:
        """Return whether a server has been discovered by all of its services."""
        return all(service.client.service_is_ready() for service in self._services)

    def send_goal(self, goal: UUID, message: Any, answered: Answered) -> None:
        """Send a goal."""
        self._goals.send(goal, self._goal_request(goal_id=ros_uuid(goal), goal=message), answered)

    def ask_result(self, goal: UUID, answered: Answered) -> None:
        """Ask for the result of a goal, which is answered when it is over; a server that does not know it says so at once."""
        self._results.send(goal, self._result_request(goal_id=ros_uuid(goal)), answered)

    def cancel_goal(self, goal: UUID, answered: Answered = lambda response: None) -> None:
        """Ask for a goal to be cancelled."""
        if self._may_act():
            self._cancels.send(goal, CancelGoal.Request(goal_info=GoalInfo(goal_id=ros_uuid(goal))), answered)

    def forget_result(self, goal: UUID) -> None:
        """Pass on no result of a goal any more: answers may still come when a link heals."""
        requests = self._results.requests
        for number in [number for number, (of, _) in requests.items() if of == goal]:
            del requests[number]

    def destroy(self) -> None:
        """Destroy the client."""
        self._node.remove_waitable(self)
        for service in self._services:
            self._node.destroy_client(service.client)

    # for the executor

    def __enter__(self) -> None:
        for service in self._services:
            service.client.handle.__enter__()

    def __exit__(self, *exception: object) -> None:
        for service in self._services:
            service.client.handle.__exit__(*exception)

    def get_num_entities(self) -> NumberOfEntities:
        """Return the entities of the wait set."""
        return NumberOfEntities(num_clients=len(self._services))

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add the services to the wait set."""
        for service in self._services:
            service.place = wait_set.add_client(service.client.handle)

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether there is an answer."""
        return any(wait_set.is_ready("client", service.place) for service in self._services)

    def take_data(self) -> list[tuple[_Service, int, Any]]:
        """Return the answers that are there."""
        return [(service, *answer) for service in self._services for answer in service.take()]

    async def execute(self, taken_data: list[tuple[_Service, int, Any]]) -> None:
        """Pass on the answers."""
        for service, number, response in taken_data:
            request, before = service.requests.pop(number, None), service.answered.get(number)
            try:
                if request is not None:
                    service.answered[number], answered = request
                    if len(service.answered) > _REMEMBERED:
                        del service.answered[next(iter(service.answered))]
                    answered(response)
                elif before is not None:
                    self._answered_twice(before if service is self._goals else None)
            except Exception:  # the others are taken as well, and would be lost
                _log.exception("an answer about goal %s cannot be used", request[0] if request else before)


def ros_uuid(uuid: UUID) -> msg.UUID:
    """Return the id as a message."""
    return msg.UUID(uuid=list(uuid.bytes))


# --- a topic that is looked at when somebody asks ------------------------------------------
# A subscription that wakes nobody: its messages wait in the middleware until they are taken.
#
# Action servers report what they are at work on more often than anybody can look at it.


class Unheard(CallbackGroup):  # type: ignore[misc]
    """A callback group of which the executor executes nothing, and waits for nothing."""

    def can_execute(self, entity: object) -> bool:
        """Return False."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Return False."""
        return False


class UnheardTopic:
    """A subscription without a callback, only to be used on the ROS thread; `raw` messages are taken as the bytes that have arrived."""

    def __init__(self, node: Any, kind: Any, topic: str, qos: Any, *, raw: bool = False) -> None:
        self._node = node
        unheard = {"callback_group": Unheard(), "event_callbacks": SubscriptionEventCallbacks(use_default_callbacks=False)}
        self._subscription = node.create_subscription(kind, topic, lambda message: None, qos, raw=raw, **unheard)

    def __repr__(self) -> str:
        return f"<UnheardTopic {self._subscription.topic_name}>"

    def take(self) -> Iterator[Any]:
        """Yield the messages that have arrived since the last time."""
        with self._subscription.handle:
            while (taken := self._subscription.handle.take_message(self._subscription.msg_type, self._subscription.raw)) is not None:
                yield taken[0]

    def destroy(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)


# --- other goals ----------------------------------------------------------------------------------
# Goals on the action servers that this process has not sent: those of other programs, and those that this node has forgotten.
#
# Action servers publish the goals that they are at work on, and a later subscriber hears the last state at once. The ids of all
# goals of a node begin alike, in each of its processes. So a goal that begins in that way, but is unknown, is *forgotten*: a process that
# has died has sent it, and there is no journal that knows it. Its result means nothing any more, and it is cancelled until it is over.


HEARD: Final = 0.5
"""Seconds in which the last state of a status topic arrives."""
_AT_WORK: Final = (1, 2, 3)
"""Accepted, executing, canceling: action_msgs/msg/GoalStatus."""
_OWN: Final = 10_000
"""Goals of this process that are known as its own: many more than servers are at work on at a time."""


@dataclass
class _StatusTopic:
    """The status topic of a server: everything changes but the name."""

    server: str
    processes: frozenset[bytes] = frozenset()
    """Those that served the action when the subscription was made: what is heard after that comes from processes that are alive."""
    reader: UnheardTopic | None = None
    began: float = 0.0
    """The time of the subscription."""
    statuses: dict[bytes, int] = field(default_factory=dict)
    """The last message of the server about all goals that it knows."""
    goals: frozenset[UUID] = frozenset()
    """Those of them that it was at work on."""
    cancelled: set[UUID] = field(default_factory=set)
    """Of these, those that are to be cancelled."""
    client: Any = None
    """Of the service that cancels goals, once it is needed."""


class OtherGoals:
    """The goals that action servers work on, and those of them that this process has not sent.

    The ids of all goals of this node begin with the prefix; it is empty if other processes of it cannot be recognized by that. `kept` are
    goals that another process of this node has sent, and that this one goes on with. `may_act` is asked right before something is
    cancelled: a node that was cut off and whose journal another process has taken over hears goals of that one, and does not know them.
    The mutable state is the ids of its own goals, the topics, and the timer that cancels goals until they are over.
    """

    def __init__(self, ros: RosThread, prefix: bytes = b"", kept: Iterable[UUID] = (), may_act: Callable[[], bool] = lambda: True) -> None:
        self._ros = ros
        self._may_act = may_act
        self._prefix = prefix
        self._own = dict.fromkeys(kept)
        self._topics: dict[str, _StatusTopic] = {}
        self._timer: Any = None

    def sent(self, goal: UUID) -> None:
        """Note a goal of this process."""
        self._own[goal] = None
        if len(self._own) > _OWN:
            del self._own[next(iter(self._own))]

    def watch(self, server: str, present: frozenset[bytes] | None = None) -> frozenset[UUID]:
        """Return the goals that a server is at work on, as far as it was heard; it is listened to from now on.

        A process that died says nothing more, so the topic is subscribed to anew whenever other processes serve the action: `present`,
        or those in the graph now.
        """
        topic = self._topics.setdefault(server, _StatusTopic(server))
        present = processes(self._ros.node, server) if present is None else present
        if topic.reader is None or present != topic.processes:
            self._unsubscribe(topic)
            topic.processes, topic.statuses, topic.goals, topic.began = present, {}, frozenset(), monotonic()
            name = f"{server}/_action/status"
            topic.reader = UnheardTopic(self._ros.node, GoalStatusArray, name, qos_profile_action_status_default, raw=True)
            if self._prefix:
                self._keep_looking()
        for message in topic.reader.take():
            self._hear(topic, message)
        return topic.goals

    def status(self, server: str, goal: UUID) -> int:
        """Return the last status of a goal from a server: action_msgs/msg/GoalStatus, 0 for none."""
        return self._topics[server].statuses.get(goal.bytes, 0)

    def others(self, server: str, present: frozenset[bytes] | None = None) -> frozenset[UUID]:
        """Return the goals of other programs and the forgotten ones that a server is at work on; see `watch`."""
        return frozenset(goal for goal in self.watch(server, present) if goal not in self._own)

    @property
    def may_forget(self) -> bool:
        """Whether goals that this node has forgotten can be recognized."""
        return bool(self._prefix)

    def is_heard(self, server: str) -> bool:
        """Return whether there was time to hear what a server is at work on; one that never had a goal says nothing."""
        return monotonic() - self._topics[server].began >= HEARD

    def are_forgotten(self, others: Iterable[UUID]) -> bool:
        """Return whether some of these goals are of this node itself."""
        return any(map(self._is_forgotten, others))

    def busy_servers(self) -> tuple[str, ...]:
        """Return the servers that are at work on such goals, of all that are listened to."""
        return tuple(server for server in (*self._topics,) if self.others(server))

    def cancel(self, server: str, goals: Collection[UUID]) -> None:
        """Cancel goals that a server is at work on, again and again until they are over."""
        topic = self._topics[server]
        new = set(goals) - topic.cancelled
        topic.cancelled |= new
        if new:
            self._send_cancel(topic, new)
        self._keep_looking()

    def close(self) -> None:
        """Listen no longer."""
        if self._timer is not None:
            self._timer.destroy()
            self._timer = None
        for topic in self._topics.values():
            self._unsubscribe(topic)
            if topic.client is not None:
                self._ros.node.destroy_client(topic.client)
        self._topics.clear()

    def _is_forgotten(self, other: UUID) -> bool:
        return self.may_forget and other.bytes.startswith(self._prefix)

    def _hear(self, topic: _StatusTopic, message: bytes) -> None:
        topic.statuses = statuses(message)
        topic.goals = frozenset(UUID(bytes=goal) for goal, status in topic.statuses.items() if status in _AT_WORK)
        forgotten = {goal for goal in topic.goals if goal not in self._own and self._is_forgotten(goal)}
        for goal in forgotten - topic.cancelled if self._may_act() else ():
            _log.warning("%s is at work on a goal (%s) of this node that it knows nothing of; it is cancelled", topic.server, goal.hex[:8])
        if forgotten:
            self.cancel(topic.server, forgotten)

    def _keep_looking(self) -> None:
        """Have the timer run while goals may be found that are to be cancelled, and until those that are are over."""
        if self._timer is None:
            self._timer = self._ros.timer(AGAIN, self._look)
        elif self._timer.is_canceled():
            self._timer.reset()

    def _look(self) -> None:
        for topic in tuple(self._topics.values()):
            self.watch(topic.server)
            topic.cancelled &= topic.goals
            self._send_cancel(topic, topic.cancelled)
        if not self._prefix and not any(topic.cancelled for topic in self._topics.values()):
            self._timer.cancel()

    def _send_cancel(self, topic: _StatusTopic, goals: Iterable[UUID]) -> None:
        if not self._may_act():
            return
        if topic.client is None:
            topic.client = self._ros.node.create_client(CancelGoal, f"{topic.server}/_action/cancel_goal")
        for goal in goals if topic.client.service_is_ready() else ():  # until it is known, requests would be lost
            topic.client.call_async(CancelGoal.Request(goal_info=GoalInfo(goal_id=ros_uuid(goal))))

    def _unsubscribe(self, topic: _StatusTopic) -> None:
        if topic.reader is not None:
            topic.reader.destroy()
            topic.reader = None


def statuses(message: bytes) -> dict[bytes, int]:
    """Return the status of each goal of a serialized ``GoalStatusArray``, a hundred times as fast as `rclpy` does.

    A server may remember thousands of goals, and repeats them all whenever one of them changes. In CDR, four bytes say how the message is
    encoded and four how many goals there are; each is an id of 16 bytes, a time of 8 that begins at a multiple of 4, and the status.
    """
    count = int.from_bytes(message[4:8], "little" if message[1] & 1 else "big")
    aligned = message[8:24] + bytes(3) + message[24:]  # all ids but the first one end at an odd place, with three bytes up to the time
    return dict(struct.iter_unpack("16s11xb", aligned[: 28 * count]))
