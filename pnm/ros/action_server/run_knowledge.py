"""The client of the knowledge services, for action servers: queries and updates the knowledge of the run that sent a goal.

The id of the goal says which executive that is, see `pnm.ros.knowledge.goal_ids`. Everything that touches `rclpy` happens in one
coroutine on the executor that spins the node; threads wait for it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Generator
from math import inf
from time import monotonic
from typing import Any, Final

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

from pnm.core.logic.computed_values import MISSING, Layer
from pnm.errors import PnmError
from pnm.knowledge.source import SourceError, read_value, write_value
from pnm.ros.knowledge.goal_ids import may_be_ours, service_prefix
from pnm.ros.knowledge.knowledge_services import LAYERS
from pnm.ros.node.messages import import_type
from pnm.ros.node.service_client import AGAIN
from pnm.ros.node.service_server import DEPTH

EXECUTIVES: Final = 16
"""Executives whose clients a server keeps; a restarted one counts as another."""
_LOOK: Final = 0.1
"""Seconds between two checks of what does not wake the executor."""
_MARGIN: Final = 1.0
"""Seconds more for the executive to report the timeout itself."""
_PERSON: Final = LAYERS.index(Layer.PERSON)
_GRACE: Final = 5.0
"""Seconds more after which a thread concludes that the node is not spun."""


class KnowledgeError(PnmError):
    """The knowledge of the run could not be queried or updated."""


class _Yield:
    """An awaitable that lets the executor run other callbacks until it is woken again."""

    def __await__(self) -> Generator[None, None, None]:
        yield


class RunKnowledge:
    """Clients of the executives whose goals are executed on a node.

    The mutable state is the clients of each executive, the latest last, and those that have had a response.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._group = ReentrantCallbackGroup()  # responses are read while other callbacks of the node wait
        self._types = {name: import_type(f"pnm_interfaces/srv/{name.capitalize()}Knowledge") for name in ("query", "update")}
        self._clients: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._met: set[Any] = set()
        self._lock = threading.Lock()

    def connect(self, goal_handle: Any) -> None:
        """Connect to the executive that has sent the goal, early: discovery takes a moment."""
        goal = bytes(goal_handle.goal_id.uuid)
        if may_be_ours(goal):
            self._clients_of(service_prefix(goal))

    async def query(self, goal_handle: Any, layer: Layer, name: str, meta: object, limit: float) -> Any:
        """Return the value, or `MISSING`; or return a `KnowledgeError`: raised here, it would end the executor."""
        answer = await self._ask(goal_handle, "query", {"name": name}, layer, meta, limit)
        if isinstance(answer, KnowledgeError):
            return answer
        try:
            return read_value(answer.value) if answer.found else MISSING
        except SourceError as error:
            return KnowledgeError(str(error))

    async def update(self, goal_handle: Any, layer: Layer, name: str, value: object, meta: object, limit: float) -> Any:
        """Store the value and return None; or return a `KnowledgeError`."""
        try:
            written = write_value(value)
        except SourceError as error:
            return KnowledgeError(str(error))
        answer = await self._ask(goal_handle, "update", {"name": name, "value": written}, layer, meta, limit)
        return answer if isinstance(answer, KnowledgeError) else None

    def wait(self, exchange: Any, limit: float) -> Any:
        """Run one of the coroutines on the executor, and return its value; to be called on another thread."""
        executor = self._node.executor
        if executor is None:
            exchange.close()
            return KnowledgeError("the node is not being spun")
        done = threading.Event()
        task = executor.create_task(exchange)
        task.add_done_callback(lambda _: done.set())
        if not done.wait(limit + _MARGIN + _GRACE):
            task.cancel()
            return KnowledgeError("the node is not being spun, or its executor is busy with something else")
        return task.result()

    # on the executor

    async def _ask(self, goal_handle: Any, service: str, fields: dict[str, object], layer: Layer, meta: object, limit: float) -> Any:
        timer = self._node.create_timer(_LOOK, _wake, callback_group=self._group, clock=Clock(clock_type=ClockType.STEADY_TIME))
        try:
            if layer not in LAYERS:
                raise KnowledgeError(f"{layer!r} is not one of {', '.join(map(str, LAYERS))}")
            written = "" if meta is None else write_value(meta)
            request = self._types[service].Request(goal_id=goal_handle.goal_id, layer=LAYERS.index(layer), meta=written, **fields)
            answer = await self._exchange(goal_handle, service, request, limit)
            if not answer.success:
                raise KnowledgeError(answer.message or "the executive refuses, and does not say why")
            return answer
        except Exception as error:
            return error if isinstance(error, KnowledgeError) else KnowledgeError(f"{fields['name']} cannot be asked for: {error}")
        finally:
            self._node.destroy_timer(timer)

    async def _exchange(self, goal_handle: Any, service: str, request: Any, limit: float) -> Any:
        goal, until = bytes(goal_handle.goal_id.uuid), monotonic() + limit
        if not may_be_ours(goal):
            raise KnowledgeError("the goal does not come from a plan executive, so there is no run whose knowledge could be asked")
        prefix = service_prefix(goal)
        client = self._clients_of(prefix)[service]
        while not client.service_is_ready():
            await _yield_until(goal_handle, until, f"there is no service {prefix}/{service}; the executive that has sent the goal is gone")
        request.timeout = max(0.0, until - monotonic()) or _LOOK
        sent: list[Any] = []
        again = 0.0
        try:
            while not (answered := [future for future in sent if future.done()]):
                if monotonic() >= again:
                    # The first response of a service may be lost, so requests are repeated; but a person is told nothing twice.
                    again = inf if client in self._met or (service == "update" and request.layer == _PERSON) else monotonic() + AGAIN
                    sent.append(client.call_async(request))
                await _yield_until(goal_handle, until + _MARGIN, f"{prefix}/{service} did not answer within {limit:g} s")
            self._met.add(client)
            return answered[0].result()
        finally:
            for future in sent:
                client.remove_pending_request(future)

    def _clients_of(self, prefix: str) -> dict[str, Any]:
        """Return the clients of an executive; those of the least recently used one are destroyed."""
        with self._lock:
            if prefix not in self._clients:
                self._clients[prefix] = {
                    name: self._node.create_client(
                        kind, f"{prefix}/{name}", qos_profile=QoSProfile(depth=DEPTH), callback_group=self._group
                    )
                    for name, kind in self._types.items()
                }
            self._clients.move_to_end(prefix)
            if len(self._clients) > EXECUTIVES:
                for client in self._clients.popitem(last=False)[1].values():
                    self._met.discard(client)
                    self._node.destroy_client(client)
            return self._clients[prefix]


async def _yield_until(goal_handle: Any, until: float, otherwise: str) -> None:
    """Let the executor run other callbacks; raise a `KnowledgeError` if the time is up, or the goal is being cancelled."""
    if goal_handle.is_cancel_requested:
        raise KnowledgeError("the goal is being cancelled")
    if monotonic() >= until:
        raise KnowledgeError(otherwise)
    await _Yield()


def _wake() -> None:
    """Do nothing: the timer wakes the executor."""
