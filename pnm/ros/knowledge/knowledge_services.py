"""What action servers ask while they carry out a goal: two services over the knowledge of the run that sent it.

They are ordinary services (``pnm_interfaces/srv/QueryKnowledge`` and ``UpdateKnowledge``), for servers in any language;
`pnm.ros.action_server.python_server` is for those in Python. A request that waits, for a person say, holds up no other. One that repeats
another of the same goal that is still at work gets the same answer: at a first contact requests are sent again because an
answer may have got lost, and a person shall not be asked twice.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeAlias
from uuid import UUID

from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.knowledge.sources.memory import read_value, write_value
from pnm.knowledge.sources.person_text import printable
from pnm.knowledge.sources.source import Asker, FindKnowledge, Source, SourceError
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import until_true

LAYERS: Final = (Layer.LOCAL, Layer.GLOBAL, Layer.ALL, Layer.PERSON)
"""What the numbers in the requests mean."""
DEPTH: Final = 1000
"""Requests that may wait unread; they come in bursts when many actions run."""
_FAREWELL: Final = 1.0
"""Seconds in which the last refusals are sent when the services close."""

_Fields: TypeAlias = dict[str, object]
_Work: TypeAlias = Callable[[Any], Awaitable[_Fields]]
_Reply: TypeAlias = Callable[[_Fields], object]
_Key: TypeAlias = tuple[_Work, str]
"""What is done, and all fields of the request written out."""

_log = logging.getLogger(__name__)


class KnowledgeServices:
    """One pair of services, for all goals of this process.

    The mutable state is, on the event loop's thread, the requests at work by goal, and who waits for the answer to each;
    on the ROS thread, the services and the number of requests that are not answered yet.

    Args:
        name: the services are ``<name>/query`` and ``<name>/update``; see `pnm.ros.action_server.run_knowledge.service_prefix`.
        find: finds the run by the id of the goal; called on the event loop's thread.
        sources: asked for what runs do not know themselves.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, name: str, find: FindKnowledge, sources: Source) -> None:
        self._ros = ros
        self._loop = loop
        self._name = name
        self._find = find
        self._sources = sources
        self._work: dict[UUID, set[asyncio.Task[_Fields]]] = {}
        self._waiting: dict[_Key, list[_Reply]] = {}
        self._services: list[Any] = []
        self._unanswered = 0

    def __repr__(self) -> str:
        return f"<KnowledgeServices {self._name}, {sum(map(len, self._work.values()))} requests at work>"

    # on the event loop's thread

    async def open(self) -> None:
        """Offer the services.

        Raises:
            InputError: the package pnm_interfaces is not installed.
        """
        types = (import_type("pnm_interfaces/srv/QueryKnowledge"), import_type("pnm_interfaces/srv/UpdateKnowledge"))
        await self._ros.ask(partial(self._offer, *types))

    def end(self, goal: UUID) -> None:
        """Withdraw what is still being asked for the goal, which is over."""
        for task in self._work.get(goal, ()):
            task.cancel()

    async def close(self) -> None:
        """Refuse what is still being asked, and take the services down."""
        for goal in tuple(self._work):
            self.end(goal)
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                await until_true(self._ros, lambda: not self._unanswered)
        await self._ros.ask(self._take_down)

    def _begin(self, work: _Work, request: Any, reply: _Reply) -> None:
        key = work, repr(request)
        if key in self._waiting:
            self._waiting[key].append(reply)
            return
        self._waiting[key] = [reply]
        goal = UUID(bytes=bytes(request.goal_id.uuid))
        task = self._loop.create_task(self._answer(work, request))
        self._work.setdefault(goal, set()).add(task)
        task.add_done_callback(partial(self._done, goal, key))

    def _done(self, goal: UUID, key: _Key, task: asyncio.Task[_Fields]) -> None:
        self._work[goal].discard(task)
        if not self._work[goal]:
            del self._work[goal]
        fields = _refusal("the goal is over, or the executive ends") if task.cancelled() else task.result()
        for reply in self._waiting.pop(key):
            reply(fields)

    async def _answer(self, work: _Work, request: Any) -> _Fields:
        """Do the work, and return the answer whatever becomes of it."""
        try:
            async with asyncio.timeout(request.timeout if request.timeout > 0 else None):
                return {"success": True, **await work(request)}
        except SourceError as error:
            return _refusal(str(error))
        except TimeoutError:
            return _refusal(f"there was no answer within {round(request.timeout, 2):g} s")
        except Exception as error:
            _log.exception("a request for knowledge failed")
            return _refusal(f"{type(error).__name__}: {error}")

    async def _query(self, request: Any) -> _Fields:
        layer, question, (knowledge, asker) = self._read(request)
        found: object = MISSING
        if layer in (Layer.LOCAL, Layer.ALL):
            found = knowledge.local.variable(question.name)
        if found is MISSING and layer is not Layer.LOCAL:
            found = await self._sources.query(question, asker)
        return {"found": found is not MISSING, "value": "" if found is MISSING else write_value(found)}

    async def _update(self, request: Any) -> _Fields:
        layer, question, (knowledge, asker) = self._read(request)
        value = read_value(request.value)
        if layer is not Layer.LOCAL:  # first, because it may fail
            await self._sources.update(question, value, asker)
        if layer in (Layer.LOCAL, Layer.ALL):
            knowledge.local.store({question.name: value})
        return {}

    def _read(self, request: Any) -> tuple[Layer, Question, tuple[Layered, Asker]]:
        """Return what the request means.

        Raises:
            SourceError: it means nothing, or nothing any more.
        """
        if request.layer >= len(LAYERS):
            raise SourceError(f"there is no layer {request.layer}; expected one of {dict(enumerate(one.value for one in LAYERS))}")
        if not request.name:
            raise SourceError("the request names no variable")
        meta = write_value(read_value(request.meta)) if request.meta else "null"
        goal = UUID(bytes=bytes(request.goal_id.uuid))
        found = self._find(goal)
        if found is None:
            raise SourceError(f"no goal {goal} is being carried out for this executive; it may be over")
        layer = LAYERS[request.layer]
        return layer, Question(request.name, layer, meta), found

    # on the ROS thread

    def _offer(self, query: Any, update: Any) -> None:
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.qos import QoSProfile

        for kind, name, work in ((query, "query", self._query), (update, "update", self._update)):
            self._services.append(
                self._ros.node.create_service(
                    kind,
                    f"{self._name}/{name}",
                    partial(self._serve, work),
                    qos_profile=QoSProfile(depth=DEPTH),
                    callback_group=ReentrantCallbackGroup(),  # the next request is taken while this one waits
                )
            )

    async def _serve(self, work: _Work, request: Any, response: Any) -> Any:
        """Have the work done on the event loop's thread; rclpy goes on with others until the future is set."""
        from rclpy.task import Future

        answer = Future()
        self._unanswered += 1
        try:
            self._loop.call_soon_threadsafe(self._begin, work, request, lambda fields: self._ros.call(lambda: answer.set_result(fields)))
            fields: Mapping[str, object] = await answer
        except RuntimeError:
            fields = _refusal("the executive has ended")
        finally:
            self._unanswered -= 1
        return to_message(type(response), fields)

    def _take_down(self) -> None:
        for service in self._services:
            self._ros.node.destroy_service(service)
        self._services.clear()


def _refusal(message: str) -> _Fields:
    return {"success": False, "message": printable(message)}
