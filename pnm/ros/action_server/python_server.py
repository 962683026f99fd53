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
import queue
import threading
from collections.abc import Callable
from typing import Any, Final

from rclpy.action import ActionServer
from rclpy.qos import QoSProfile

from pnm.core.logic.computed_values import Layer
from pnm.ros.action_server.run_knowledge import KnowledgeError, RunKnowledge
from pnm.ros.node.service_server import DEPTH

__all__ = ["LIMIT", "KnowledgeError", "PnmActionServer", "PnmSimpleActionServer"]

LIMIT: Final = 10.0
"""Seconds for an answer. A first contact over DDS takes up to 5; give people more, by ``timeout``."""

_Execute = Callable[[Any], Any]


class _ServerWithKnowledge(ActionServer):  # type: ignore[misc]
    """The base of both servers; takes the arguments of `rclpy.action.ActionServer`.

    An execute callback that fails, or does not return a result, aborts its goal and nothing more.
    The mutable state, besides that of `rclpy`, is which thread spins.
    """

    QUERY_LOCAL = UPDATE_LOCAL = Layer.LOCAL
    """The knowledge of the run."""
    QUERY_GLOBAL = UPDATE_GLOBAL = QUERY_REMOTE = UPDATE_REMOTE = Layer.GLOBAL
    """The knowledge that all runs share; also called remote."""
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
            self._begin(goal_handle, callback)

    def _begin(self, goal_handle: Any, callback: _Execute) -> None:
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

    def _query(self, goal_handle: Any, layer: Layer, name: str, meta: object, timeout: float) -> object:
        self._may_wait()
        return _raised(self._knowledge.wait(self._knowledge.query(goal_handle, layer, name, meta, timeout), timeout))

    def _update(self, goal_handle: Any, layer: Layer, name: str, value: object, meta: object, timeout: float) -> None:
        self._may_wait()
        _raised(self._knowledge.wait(self._knowledge.update(goal_handle, layer, name, value, meta, timeout), timeout))

    def _may_wait(self) -> None:
        if threading.get_ident() == self._spinning:
            raise KnowledgeError("waiting here would stop the executor that is waited for; in a coroutine, await the ..._async method")


class PnmActionServer(_ServerWithKnowledge):
    """An action server for any number of goals at a time, each with the knowledge of its run."""

    def query_kb(self, goal_handle: Any, layer: Layer, name: str, meta: object = None, *, timeout: float = LIMIT) -> object:
        """Return the value of a variable, or `pnm.MISSING` if there is none; blocks this thread.

        Raises:
            KnowledgeError: it could not be queried in time, or the goal is being cancelled.
        """
        return self._query(goal_handle, layer, name, meta, timeout)

    def update_kb(self, goal_handle: Any, layer: Layer, name: str, value: object, meta: object = None, *, timeout: float = LIMIT) -> None:
        """Store a variable of a type of JSON; when this returns, every query finds it. Blocks this thread.

        Raises:
            KnowledgeError: it could not be stored in time, or the goal is being cancelled.
        """
        self._update(goal_handle, layer, name, value, meta, timeout)

    async def query_kb_async(self, goal_handle: Any, layer: Layer, name: str, meta: object = None, *, timeout: float = LIMIT) -> object:  # noqa: ASYNC109 - none of asyncio
        """Do what `query_kb` does, in a coroutine."""
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
        """Do what `update_kb` does, in a coroutine."""
        _raised(await self._knowledge.update(goal_handle, layer, name, value, meta, timeout))


class PnmSimpleActionServer(_ServerWithKnowledge):
    """An action server that executes one goal at a time, in the order of their arrival.

    A goal that is cancelled before its turn is not begun. The execute callback is an ordinary function.
    The mutable state is the goals that wait, and the one that is executed.
    """

    def __init__(self, node: Any, action_type: Any, action_name: str, execute_callback: _Execute, **options: Any) -> None:
        if inspect.iscoroutinefunction(execute_callback):
            raise TypeError("expected an ordinary function as the execute callback; PnmActionServer takes coroutines")
        self._waiting: queue.SimpleQueue[tuple[Any, _Execute]] = queue.SimpleQueue()
        self._current: Any = None
        threading.Thread(target=self._work, daemon=True).start()
        super().__init__(node, action_type, action_name, execute_callback, **options)

    def query_kb(self, layer: Layer, name: str, meta: object = None, *, timeout: float = LIMIT) -> object:
        """Return the value of a variable for the current goal, or `pnm.MISSING` if there is none.

        Raises:
            KnowledgeError: it could not be queried in time, or the goal is being cancelled, or there is none.
        """
        return self._query(self._goal(), layer, name, meta, timeout)

    def update_kb(self, layer: Layer, name: str, value: object, meta: object = None, *, timeout: float = LIMIT) -> None:
        """Store a variable of a type of JSON for the current goal.

        Raises:
            KnowledgeError: it could not be stored in time, or the goal is being cancelled, or there is none.
        """
        self._update(self._goal(), layer, name, value, meta, timeout)

    def _goal(self) -> Any:
        if self._current is None:
            raise KnowledgeError("no goal is being carried out, so there is no run whose knowledge could be asked")
        return self._current

    def _begin(self, goal_handle: Any, callback: _Execute) -> None:
        self._waiting.put((goal_handle, callback))

    def _work(self) -> None:
        while True:
            goal_handle, callback = self._waiting.get()
            self._current = goal_handle
            self._run_callback(goal_handle, self._not_begun if goal_handle.is_cancel_requested else callback)
            self._current = None

    def _not_begun(self, goal_handle: Any) -> Any:
        goal_handle.canceled()
        return self.action_type.Result()


def _raised(answer: Any) -> Any:
    if isinstance(answer, KnowledgeError):
        raise answer
    return answer
