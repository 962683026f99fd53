"""Action servers in Python that can query and update the knowledge of the run that sent the goal.

    class Guide(Node):
        def __init__(self):
            super().__init__("guide")
            self.server = PnmActionServer(self, GroundAction, "guide", self.execute)

        def execute(self, goal):
            shop = self.server.query_kb(goal, PnmActionServer.QUERY_ALL, "shop")
            self.server.update_kb(goal, PnmActionServer.UPDATE_LOCAL, "seen", [shop])
            goal.succeed()
            return GroundAction.Result()

An ordinary function as the execute callback runs on a thread of its own, so it may block, whatever executor spins the
node. A coroutine runs on the executor, as usual in `rclpy`, and awaits `query_kb_async` and `update_kb_async`. Goals of
clients other than an executive are executed as usual; a query for one of them is a `KnowledgeError`.
"""

from __future__ import annotations

import inspect
import threading
from collections import OrderedDict
from collections.abc import Callable, Generator
from functools import partial
from math import inf
from time import monotonic
from typing import Any, Final

from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

from pnm.core.logic.computed_values import MISSING, Layer
from pnm.errors import PnmError
from pnm.knowledge.source import SourceError, read_value, write_value
from pnm.ros.knowledge import LAYERS, may_be_ours, service_prefix
from pnm.ros.node.messages import import_type
from pnm.ros.node.services import AGAIN, DEPTH

# --- the client of the knowledge services of the run that sent a goal ----------------------
# The id of the goal says which executive that is, see `pnm.ros.knowledge`. Everything that touches `rclpy` happens in one
# coroutine on the executor that spins the node; threads wait for it.

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
    """Clients of the executives whose goals are executed on a node, the latest last, and which of them have had a response."""

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
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(_LOOK, lambda: None, callback_group=self._group, clock=steady)  # it wakes the executor
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
            raise KnowledgeError("the goal does not come from a plan executive, so there is no run with knowledge")
        prefix = service_prefix(goal)
        client = self._clients_of(prefix)[service]
        while not client.service_is_ready():
            await _yield_until(goal_handle, until, f"there is no service {prefix}/{service}; the executive that has sent the goal is gone")
        request.timeout = max(0.0, until - monotonic()) or _LOOK
        sent, again = list[Any](), 0.0
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
                create = partial(self._node.create_client, qos_profile=QoSProfile(depth=DEPTH), callback_group=self._group)
                self._clients[prefix] = {name: create(kind, f"{prefix}/{name}") for name, kind in self._types.items()}
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


# --- the action server ---------------------------------------------------------------------

__all__ = ["LIMIT", "KnowledgeError", "PnmActionServer"]
LIMIT: Final = 10.0
"""Seconds for an answer. A first contact over DDS takes up to 5; give people more, by ``timeout``."""
_Execute = Callable[[Any], Any]


class PnmActionServer(ActionServer):  # type: ignore[misc]
    """An action server for any number of goals at a time, each with the knowledge of its run; it takes the arguments of `rclpy`'s.

    An execute callback that fails, or does not return a result, aborts its goal and nothing more.
    The mutable state, besides that of `rclpy`, is which thread spins.
    """

    QUERY_LOCAL = UPDATE_LOCAL = Layer.LOCAL
    """The knowledge of the run."""
    QUERY_GLOBAL = UPDATE_GLOBAL = Layer.GLOBAL
    """The knowledge that all runs share."""
    QUERY_ALL = UPDATE_ALL = Layer.ALL
    """A query asks the local, then the global knowledge; an update goes to both."""
    QUERY_PERSON = UPDATE_PERSON = Layer.PERSON
    """The person who answers questions of the run."""

    def __init__(self, node: Any, action_type: Any, action_name: str, execute_callback: _Execute, **options: Any) -> None:
        self._spinning: int | None = None
        self._knowledge = RunKnowledge(node)
        deep = QoSProfile(depth=DEPTH)  # the default of 10 loses goals silently
        for service in ("goal", "result", "cancel"):
            options.setdefault(f"{service}_service_qos_profile", deep)
        super().__init__(node, action_type, action_name, execute_callback, **options)

    def take_data(self) -> Any:
        """Note which thread spins: `rclpy` calls this on it."""
        self._spinning = threading.get_ident()
        return super().take_data()

    def notify_execute(self, goal_handle: Any, execute_callback: _Execute | None) -> None:
        """Execute the goal; called on the executor."""
        callback = execute_callback or self._execute_callback
        self._knowledge.connect(goal_handle)
        if inspect.iscoroutinefunction(callback):

            async def execute(goal_handle: Any) -> Any:
                try:
                    return self._result(await callback(goal_handle))
                except Exception as error:
                    return self._failed(error)

            super().notify_execute(goal_handle, execute)
        else:
            threading.Thread(target=self._run_callback, args=(goal_handle, callback), daemon=True).start()

    def _run_callback(self, goal_handle: Any, callback: _Execute) -> None:
        """Call back, then have the executor send the result; called on another thread."""
        try:
            result = self._result(callback(goal_handle))
        except Exception as error:
            result = self._failed(error)
        if self._node.executor is not None:  # it may have ended meanwhile
            super().notify_execute(goal_handle, lambda _: result)

    def _result(self, returned: Any) -> Any:
        """Return the callback's result; anything else would end the whole server in `rclpy`."""
        if not isinstance(returned, self.action_type.Result):
            raise TypeError(f"it returned {returned!r}; expected a {self.action_type.__name__}.Result")
        return returned

    def _failed(self, error: Exception) -> Any:
        message = f"the execute callback failed, so the goal is aborted: {type(error).__name__}: {error}"
        self._logger.error(message)  # a logger of `rclpy`, which formats nothing
        return self.action_type.Result()

    def _wait(self, exchange: Any, timeout: float) -> Any:
        if threading.get_ident() == self._spinning:
            exchange.close()
            raise KnowledgeError("waiting here would stop the executor that is waited for; in a coroutine, await the ..._async method")
        return _raised(self._knowledge.wait(exchange, timeout))

    def query_kb(self, goal_handle: Any, layer: Layer, name: str, meta: object = None, *, timeout: float = LIMIT) -> object:
        """Return the value of a variable, or `pnm.MISSING`; raise `KnowledgeError` if there is none in time. Blocks this thread."""
        return self._wait(self._knowledge.query(goal_handle, layer, name, meta, timeout), timeout)

    def update_kb(self, goal_handle: Any, layer: Layer, name: str, value: object, meta: object = None, *, timeout: float = LIMIT) -> None:
        """Store a value of a type of JSON, for every later query; raise `KnowledgeError` if it is not in time. Blocks this thread."""
        self._wait(self._knowledge.update(goal_handle, layer, name, value, meta, timeout), timeout)

    async def query_kb_async(self, goal_handle: Any, layer: Layer, name: str, meta: object = None, *, timeout: float = LIMIT) -> object:  # noqa: ASYNC109 - none of asyncio
        """Query knowledge like `query_kb`, in a coroutine."""
        return _raised(await self._knowledge.query(goal_handle, layer, name, meta, timeout))

    async def update_kb_async(
        self,
        goal_handle: Any,
        layer: Layer,
        name: str,
        value: object,
        meta: object = None,
        *,
        timeout: float = LIMIT,  # noqa: ASYNC109 - none of asyncio
    ) -> None:
        """Update knowledge like `update_kb`, in a coroutine."""
        _raised(await self._knowledge.update(goal_handle, layer, name, value, meta, timeout))


def _raised(answer: Any) -> Any:
    if isinstance(answer, KnowledgeError):
        raise answer
    return answer
