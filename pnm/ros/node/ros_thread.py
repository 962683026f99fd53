"""The ROS thread: the one thread on which every call of `rclpy` is made.

`rclpy` sends a request before it registers the future of the response, so a response that another thread reads in between
is lost (ros2/rclpy#1123). On the thread that spins nothing can come in between. Functions cross to it through a queue and
a guard condition; nothing polls, so an idle thread costs nothing. Results cross back by `call_soon_threadsafe`.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from time import monotonic
from typing import Any, Final, TypeVar

from pnm.errors import RosError, installation, printable_lines
from pnm.tasks import EVENTS

try:
    import rclpy
    from rclpy.clock import Clock, ClockType
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
except ImportError as error:
    _missing: ImportError | None = error
else:
    _missing = None

T = TypeVar("T")
_DISCOVERY: Final = 4.0
"""Seconds in which a new node discovers the others: participants announce themselves every 3 s, and on one host often only then."""
_STILL: Final = 0.5
"""Seconds without change after which the graph counts as settled."""
_LOOK: Final = 1.0
"""Seconds after which the thread looks for functions without being woken."""
_log = logging.getLogger(__name__)


def call_on_loop(loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: object) -> None:
    """Call the function on the event loop's thread; nothing happens once the loop is closed."""
    try:
        loop.call_soon_threadsafe(function, *arguments)
    except RuntimeError:
        _log.debug("the event loop is closed; %s is not called", function)


def profile(depth: int, *, latched: bool = False) -> Any:
    """Return the QoS of a topic or a service: the messages that a slow reader may be behind, and whether late ones get the last ones."""
    from rclpy.qos import DurabilityPolicy, QoSProfile  # here, because rclpy is an extra

    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


class Rosout(logging.Handler):
    """Publishes on ``/rosout``, with the time of the wall, what the packages log and what happens to tasks.

    The logger of the node would print it as well, in the midst of what commands print, and its settings are those of the whole process,
    in which others may have nodes. The mutable state is the publishers, by thread: the first one publishes.
    """

    LOGGERS: Final = (logging.getLogger("pnm"), logging.getLogger("planner_bridge"), EVENTS)

    def __init__(self) -> None:
        super().__init__()
        self._publishers: dict[RosThread, Any] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record, from any thread. As if this handler were not there, warnings that have no other one are printed on stderr."""
        others = {handler for logger in (logging.root, *self.LOGGERS) for handler in logger.handlers if handler is not self}
        if (last := logging.lastResort) and others <= {*EVENTS.handlers} and record.name != EVENTS.name and record.levelno >= last.level:
            last.handle(record)
        for ros in tuple(self._publishers)[:1]:
            ros.call(partial(self.publish, ros, record))

    # on the ROS thread

    def join(self, ros: RosThread) -> None:
        """Publish by this node from now on, unless another one does, or ROS arguments say that nothing shall be."""
        from rcl_interfaces.msg import Log
        from rclpy.duration import Duration

        named = ros.node.get_publisher_names_and_types_by_node(ros.node.get_name(), ros.node.get_namespace())
        if any(topic == "/rosout" for topic, _ in named):
            qos = profile(1000, latched=True)
            qos.lifespan = Duration(seconds=10)  # as ROS has it
            self._publishers[ros] = ros.node.create_publisher(Log, "/rosout", qos)
            for logger in self.LOGGERS:
                logger.addHandler(self)
            EVENTS.setLevel(logging.INFO)

    def leave(self, ros: RosThread) -> None:
        """Publish nothing more by this node."""
        self._publishers.pop(ros, None)
        if not self._publishers:
            EVENTS.setLevel(logging.NOTSET)
            for logger in self.LOGGERS:
                logger.removeHandler(self)

    def publish(self, ros: RosThread, record: logging.LogRecord) -> None:
        """Publish a record by this node, unless its logger leaves out what has this level."""
        node, publisher = ros.node, self._publishers.get(ros)
        if publisher is not None and node.get_logger().is_enabled_for(min(record.levelno, logging.CRITICAL) // 10 * 10):
            log, seconds = publisher.msg_type(), int(record.created)
            log.stamp.sec, log.stamp.nanosec = seconds, int((record.created - seconds) * 1e9)
            log.level, log.name, log.msg = record.levelno, node.get_logger().name, printable_lines(self.format(record))
            log.file, log.function, log.line = record.pathname, record.funcName or "", record.lineno
            publisher.publish(log)


ROSOUT: Final = Rosout()


class RosThread:
    """A ROS 2 node and the daemon thread that spins it.

    The mutable state is the queue of functions, those for the end, and `_closing`, which the lock guards: a function that
    `call` has accepted is run, even if the thread is closed at the same time. The node belongs to the thread: use `node`
    only in functions given to `call`, `submit` or `ask`.

    With ``async with`` it is closed at the end of the block. Raises `RosError` if ROS 2 is not installed, or the node cannot be made.

    Args:
        args: arguments as a launch file gives them, such as ``["--ros-args", "-r", "__ns:=/r1"]``.
        managed: make a node with a managed life cycle, see `pnm.ros.node.lifecycle`.
        limit: seconds for the node to be made.
    """

    def __init__(
        self, name: str = "pnm", *, namespace: str = "", args: Sequence[str] = (), managed: bool = False, limit: float = 20.0
    ) -> None:
        if _missing is not None:
            raise RosError(f"ROS 2 is not there ({_missing}); `{installation('ros2')}`, or source a ROS 2 installation") from _missing
        self.node: Any = None
        self._functions: deque[Callable[[], object]] = deque()
        self._at_end: list[Callable[[], object]] = []
        self._lock = threading.Lock()
        self._closing = False
        self._guard: Any = None
        self._managed = managed
        started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(name, namespace, list(args), started), name="ros", daemon=True)
        self._thread.start()
        try:
            started.result(limit)
        except Exception as error:
            self._closing = True
            raise RosError(f"the ROS 2 node {name!r} cannot be made: {str(error) or type(error).__name__}") from error
        self.joined = monotonic()
        """The time at which the node joined the ROS graph, on the monotonic clock."""
        # A daemon thread that is inside the middleware while the interpreter is finalized may crash the process.
        atexit.register(self.close)

    async def __aenter__(self) -> RosThread:
        return self

    async def __aexit__(self, *exception: object) -> None:
        await asyncio.to_thread(self.close)  # not on this thread: the ROS thread may be waiting for this loop

    def call(self, function: Callable[[], object]) -> bool:
        """Queue the function for the thread; return False, and do nothing, once the thread is closed."""
        with self._lock:
            if not self._closing:
                self._functions.append(function)
                if len(self._functions) == 1:  # else the thread has been woken, and has yet to look
                    self._guard.trigger()
            return not self._closing

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Run the function on the thread and return the future of its result."""
        future: Future[T] = Future()

        def run() -> None:
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(function())
                except Exception as error:
                    future.set_exception(error)

        if not self.call(run):
            raise RosError("the ROS 2 node is closed")
        return future

    async def ask(self, function: Callable[[], T]) -> T:
        """Run the function on the thread and await its result."""
        return await asyncio.wrap_future(self.submit(function))

    def timer(self, period: float, function: Callable[[], object]) -> Any:
        """Return a timer on real time, even with ``use_sim_time``; only from the thread itself."""
        return self.node.create_timer(period, function, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def on_close(self, function: Callable[[], object]) -> None:
        """Run the function on the thread before it ends, for whatever reason."""
        self._at_end.append(function)

    async def settled(self) -> None:
        """Wait until the node has had the time to discover the others, and the ROS graph has stopped changing."""
        seen, still_since = object(), monotonic()
        while True:
            now = monotonic()
            graph = await self.ask(lambda: (self.node.get_topic_names_and_types(), self.node.get_node_names()))
            if graph != seen:
                seen, still_since = graph, now
            if now - self.joined >= _DISCOVERY and now - still_since >= _STILL:
                return
            await asyncio.sleep(0.1)

    def close(self, limit: float = 5.0) -> bool:
        """End the thread after the functions in the queue; return whether it ended within `limit` seconds."""
        with self._lock:
            if not self._closing:
                self._closing = True
                atexit.unregister(self.close)
                if self._guard is not None:
                    self._guard.trigger()
        if threading.current_thread() is not self._thread:
            self._thread.join(limit)
        return not self._thread.is_alive()

    # on the thread

    def _run(self, name: str, namespace: str, args: list[str], started: Future[None]) -> None:
        context = rclpy.Context()
        try:
            # Signals belong to the program, which ends its runs before it closes the node.
            rclpy.init(args=args, context=context, signal_handler_options=rclpy.SignalHandlerOptions.NO)
            if self._managed:
                from pnm.ros.node.managed_node import ManagedNode  # here, because rclpy is an extra

                self.node = ManagedNode(name, namespace=namespace, context=context)
            else:
                self.node = rclpy.create_node(name, namespace=namespace, context=context)
            self._guard = self.node.create_guard_condition(self._drain)
            self.timer(_LOOK, lambda: None)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(self.node)
        except BaseException as error:
            started.set_exception(error)
            rclpy.try_shutdown(context=context)
            return
        ROSOUT.join(self)
        started.set_result(None)
        while not self._closing and context.ok():
            try:
                executor.spin_once()
                # Fast DDS may lose a wake-up that comes while it returns from a wait for another reason, such as a message. So the thread
                # looks for functions after each callback as well, and once a second if there was none.
                self._drain()
            except ExternalShutdownException:
                break
            except Exception:  # a callback that fails must not end the others
                _log.exception("a ROS 2 callback failed")
        with self._lock:
            self._closing = True  # also after an external shutdown: nothing is accepted any more that would not be run
        self._functions.extend(self._at_end)
        self._drain()
        ROSOUT.leave(self)
        try:
            executor.shutdown(0.0)
            self.node.destroy_node()
            rclpy.try_shutdown(context=context)
        except Exception:
            _log.exception("the ROS 2 node did not shut down properly")

    def _drain(self) -> None:
        while self._functions:
            function = self._functions.popleft()
            try:
                function()
            except Exception:
                _log.exception("a function on the ROS 2 thread failed")
