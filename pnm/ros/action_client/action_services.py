"""Our client of the three services of an action server: a goal is sent, cancelled, and asked for its result.

An action is three services and two topics. The action client of `rclpy` subscribes to both topics, and reads the status of every goal
that the server remembers whenever one of them changes, which is many times the work of the services.

The executor of `rclpy` takes one answer a turn, by way of a future and a task. Here all answers that are there are taken in one turn, and
passed on at once. Two answers to one request mean that two servers of one name are alive.

Everything here runs on the ROS thread.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final
from uuid import UUID

from action_msgs.msg import GoalInfo
from action_msgs.srv import CancelGoal
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.waitable import NumberOfEntities, Waitable
from unique_identifier_msgs import msg

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
