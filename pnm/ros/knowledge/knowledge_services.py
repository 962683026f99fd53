"""The services by which action servers query and update the knowledge of the run that sent them a goal.

They are ordinary services (``pnm_interfaces/srv/QueryKnowledge`` and ``UpdateKnowledge``), for servers in any language;
`pnm.ros.action_server.python_server` is for those in Python. A request that waits, for example for a person, holds up no other.

A request that equals another one of the same goal that is still at work gets the same response: at first contact clients
repeat requests because a response may have been lost, and a person shall not be asked twice.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any, Final, TypeAlias
from uuid import UUID

from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.knowledge.source import Asker, FindKnowledge, Source, SourceError, read_value, write_value
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_server import Fields, Handler, RequestServices

LAYERS: Final = (Layer.LOCAL, Layer.GLOBAL, Layer.ALL, Layer.PERSON)
"""The layers by their numbers in requests."""

_Key: TypeAlias = tuple[UUID, Handler, str]
"""The goal, the handler, and all fields of the request."""


class KnowledgeServices:
    """The pair of services for all goals of this process.

    The mutable state is the requests at work, on the event loop's thread.

    Args:
        name: the services are ``<name>/query`` and ``<name>/update``; see `pnm.ros.knowledge.goal_ids.service_prefix`.
        sources: queried and updated for all layers but the local one.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, name: str, find: FindKnowledge, sources: Source) -> None:
        self._loop = loop
        self._name = name
        self._find = find
        self._sources = sources
        self._work: dict[_Key, asyncio.Task[Fields]] = {}
        cancelled, ended = "the goal is over, or the executive ends", "the executive has ended"
        self._services = RequestServices(ros, loop=loop, cancelled=cancelled, ended=ended, arrival=0.0)

    def __repr__(self) -> str:
        return f"<KnowledgeServices {self._name}, {len(self._work)} requests at work>"

    async def open(self) -> None:
        """Offer the services."""
        await self._services.open(
            {
                f"{self._name}/query": ("pnm_interfaces/srv/QueryKnowledge", partial(self._answer_once, self._query)),
                f"{self._name}/update": ("pnm_interfaces/srv/UpdateKnowledge", partial(self._answer_once, self._update)),
            }
        )

    def end(self, goal: UUID) -> None:
        """Withdraw the requests of a goal, which is over."""
        for (of, _, _), task in self._work.items():
            if of == goal:
                task.cancel()

    async def close(self) -> None:
        """Withdraw all requests, and take the services down."""
        for task in self._work.values():
            task.cancel()
        await self._services.close()

    async def _answer_once(self, handler: Handler, request: Any) -> Fields:
        key = UUID(bytes=bytes(request.goal_id.uuid)), handler, repr(request)
        if key not in self._work:
            task = self._work[key] = self._loop.create_task(_within_limit(handler, request))
            task.add_done_callback(lambda _: self._work.pop(key))
        return await asyncio.shield(self._work[key])  # shielded: one of several that wait must not cancel it for all

    async def _query(self, request: Any) -> Fields:
        layer, question, (knowledge, asker) = self._read(request)
        value: object = MISSING
        if layer in (Layer.LOCAL, Layer.ALL):
            value = knowledge.local.variable(question.name)
        if value is MISSING and layer is not Layer.LOCAL:
            value = await self._sources.query(question, asker)
        return {"found": value is not MISSING, "value": "" if value is MISSING else write_value(value)}

    async def _update(self, request: Any) -> Fields:
        layer, question, (knowledge, asker) = self._read(request)
        value = read_value(request.value)
        if layer is not Layer.LOCAL:  # first, because it may fail
            await self._sources.update(question, value, asker)
        if layer in (Layer.LOCAL, Layer.ALL):
            knowledge.local.store({question.name: value})
        return {}

    def _read(self, request: Any) -> tuple[Layer, Question, tuple[Layered, Asker]]:
        """Return the layer and the variable of a request, the knowledge of its run, and who asks the sources."""
        if request.layer >= len(LAYERS):
            raise SourceError(f"there is no layer {request.layer}; expected one of {dict(enumerate(layer.value for layer in LAYERS))}")
        if not request.name:
            raise SourceError("the request names no variable")
        meta = write_value(read_value(request.meta)) if request.meta else "null"
        goal = UUID(bytes=bytes(request.goal_id.uuid))
        run = self._find(goal)
        if run is None:
            raise SourceError(f"no goal {goal} is being carried out for this executive; it may be over")
        layer = LAYERS[request.layer]
        return layer, Question(request.name, layer, meta), run


async def _within_limit(handler: Handler, request: Any) -> Fields:
    try:
        async with asyncio.timeout(request.timeout if request.timeout > 0 else None):
            return await handler(request)
    except TimeoutError as error:
        raise SourceError(f"there was no answer within {round(request.timeout, 2):g} s") from error
