"""Knowledge over ROS 2: the services for the knowledge of a run, and sources of knowledge in other processes.

By the services, action servers query and update the knowledge of the run that sent them a goal. They are ordinary services
(``pnm_interfaces/srv/QueryKnowledge`` and ``UpdateKnowledge``), for servers in any language; `pnm.ros.action_server.python_server` is
for those in Python. A request that waits, for example for a person, holds up no other.

A request that equals another one of the same goal that is still at work gets the same response: at first contact clients
repeat requests because a response may have been lost, and a person shall not be asked twice.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeAlias
from uuid import UUID, uuid4

from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError, printable
from pnm.knowledge.people import ANSWER_LIMIT, message_text, question_text, read_answer
from pnm.knowledge.source import Asker, FindKnowledge, Source, SourceError, read_value, write_value
from pnm.knowledge.sources import Surroundings, only, seconds, text
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile
from pnm.ros.node.services import Fields, Handler, RequestServices, ServiceClient, until_true

LAYERS: Final = (Layer.LOCAL, Layer.GLOBAL, Layer.ALL, Layer.PERSON)
"""The layers by their numbers in requests."""
_Key: TypeAlias = tuple[UUID, Handler, str]
"""The goal, the handler, and all fields of the request."""


class KnowledgeServices:
    """The services ``<name>/query`` and ``<name>/update`` for all goals of this process; see `service_prefix` for the name.

    The sources are queried and updated for all layers but the local one. The mutable state is the requests at work, on the event loop's
    thread.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, name: str, find: FindKnowledge, sources: Source) -> None:
        self._loop = loop
        self._name = name
        self._find = find
        self._sources = sources
        self._work: dict[_Key, asyncio.Task[Fields | None]] = {}
        cancelled, ended = "the goal is over, or the executive ends", "the executive has ended"
        self._services = RequestServices(ros, loop=loop, cancelled=cancelled, ended=ended, arrival=0.0)

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

    async def _answer_once(self, handler: Handler, request: Any) -> Fields | None:
        async def within_limit() -> Fields | None:
            try:
                async with asyncio.timeout(request.timeout if request.timeout > 0 else None):
                    return await handler(request)
            except TimeoutError as error:
                raise SourceError(f"there was no answer within {round(request.timeout, 2):g} s") from error

        key = UUID(bytes=bytes(request.goal_id.uuid)), handler, repr(request)
        if key not in self._work:
            task = self._work[key] = self._loop.create_task(within_limit())
            task.add_done_callback(lambda _: self._work.pop(key))
        return await asyncio.shield(self._work[key])  # shielded: one of several that wait must not cancel it for all

    async def _query(self, request: Any) -> Fields:
        layer, question, (knowledge, asker) = self._read(request)
        value = knowledge.local.variable(question.name) if layer in (Layer.LOCAL, Layer.ALL) else MISSING
        if value is MISSING and layer is not Layer.LOCAL:
            value = await self._sources.query(question, asker)
        return {"found": value is not MISSING, "value": "" if value is MISSING else write_value(value)}

    async def _update(self, request: Any) -> None:
        layer, question, (knowledge, asker) = self._read(request)
        value = read_value(request.value)
        if layer is not Layer.LOCAL:  # first, because it may fail
            await self._sources.update(question, value, asker)
        if layer in (Layer.LOCAL, Layer.ALL):
            knowledge.local.store({question.name: value})

    def _read(self, request: Any) -> tuple[Layer, Question, tuple[Layered, Asker]]:
        """Return the layer and the variable of a request, the knowledge of its run, and who asks the sources."""
        if request.layer >= len(LAYERS):
            raise SourceError(f"there is no layer {request.layer}; expected one of {dict(enumerate(layer.value for layer in LAYERS))}")
        if not request.name:
            raise SourceError("the request names no variable")
        meta = write_value(read_value(request.meta)) if request.meta else "null"
        goal, layer = UUID(bytes=bytes(request.goal_id.uuid)), LAYERS[request.layer]
        run = self._find(goal)
        if run is None:
            raise SourceError(f"no goal {goal} is being carried out for this executive; it may be over")
        return layer, Question(request.name, layer, meta), run


# --- the ids of goals identify the executive that sent one, and so the services for its knowledge ---
#
# An executive draws four bytes once, and begins the ids of all its runs and goals with them. The names of its services
# contain these bytes, so that an action server finds them by the goal alone. The rest of such an id is that of a UUID
# of version 5; clients that know nothing of this send version 4 or no version at all.


def service_prefix(goal: bytes) -> str:
    """Return the prefix of the names of the knowledge services, given the id of any run or goal of the executive."""
    return f"/pnm_{goal[:4].hex()}"


def may_be_ours(goal: bytes) -> bool:
    """Return True if the goal may come from an executive."""
    return goal[6] >> 4 == 5 and goal[8] >> 6 == 2


# --- the source ``ros2``: global knowledge of an ontology, a database or another executive -----------

NAME: Final = "knowledge"
LIMIT: Final = 4.0
"""Seconds to find the service and for its response; new nodes discover each other within 3."""


class Ros2Knowledge:
    """A client of ``<name>/query`` and ``<name>/update``, of the types ``QueryKnowledge`` and ``UpdateKnowledge``."""

    def __init__(self, ros: RosThread, name: str = NAME, *, limit: float = LIMIT) -> None:
        self._name = name
        self._limit = limit
        self._queries = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{name}/query")
        self._updates = ServiceClient(ros, "pnm_interfaces/srv/UpdateKnowledge", f"{name}/update")

    def __repr__(self) -> str:
        return f"<Ros2Knowledge {self._name}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Query the service; return the value, or `MISSING`."""
        answer = await self._queries.call(self._request(question, asker), self._limit)
        self._check(answer)
        return read_value(answer.value) if answer.found else MISSING

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Have the service store the value."""
        self._check(await self._updates.call({**self._request(question, asker), "value": write_value(value)}, self._limit))

    async def close(self) -> None:
        """Destroy both clients."""
        await self._queries.close()
        await self._updates.close()

    def _request(self, question: Question, asker: Asker) -> dict[str, object]:
        return {
            "goal_id": asker.run,
            "layer": LAYERS.index(Layer.GLOBAL),
            "name": question.name,
            "meta": "" if question.meta == "null" else question.meta,
            "timeout": self._limit,
        }

    def _check(self, answer: Any) -> None:
        if not answer.success:
            raise SourceError(f"the knowledge behind {self._name} refuses: {answer.message or 'it does not say why'}")


def ros2(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``ros2``: ``name`` is the prefix of the names of the services, ``limit`` in seconds."""
    only(options, "name", "limit")
    return Ros2Knowledge(thread(surroundings), text(options, "name", NAME), limit=seconds(options, "limit", LIMIT))


def thread(surroundings: Surroundings) -> RosThread:
    """Return the thread of the node; raise an `InputError` if there is none."""
    if not isinstance(surroundings.ros, RosThread):
        raise InputError("needs ROS 2, which is not used here; expected --actions ros2")
    return surroundings.ros


# --- the source ``topics``: a person at a screen, a dialogue system, or a remote operator ------------
#
# At first contact an answer may be lost: DDS matches the two topics one after the other, so a question may be heard, and answered,
# before the publisher of the answer knows that we listen. So open questions are repeated when a publisher of answers is new.

LISTENER: Final = 5.0
"""Seconds to wait for a subscriber of a message."""
DEPTH: Final = 100
"""Messages that late subscribers get, withdrawals of older questions included."""
AGAIN: Final = 1.0
"""Seconds after the discovery of a publisher of answers at which open questions are repeated."""
_FAREWELL: Final = 1.0
"""Seconds to deliver the last withdrawals."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _OpenQuestion:
    """A question without an answer so far, its message, and what waits for the answer."""

    question: Question
    message: Any
    answer: asyncio.Future[object]


class Ros2Person:
    """Publishes questions on ``<name>/questions`` and waits for answers of the same id on ``<name>/answers``.

    Any number of questions are open at once, and late subscribers get them. A question is withdrawn as soon as no answer is
    needed any more, also because one has arrived: other subscribers still show it. At first contact with somebody who answers
    it may be heard more than once, with the same id.

    The mutable state is the open questions by id, on the event loop's thread, and publisher and subscription.
    """

    def __init__(self, ros: RosThread, name: str = NAME, *, limit: float = ANSWER_LIMIT) -> None:
        self._ros = ros
        self._name = name
        self._limit = limit
        self._types = (import_type("pnm_interfaces/msg/Question"), import_type("pnm_interfaces/msg/Answer"))
        self._open: dict[str, _OpenQuestion] = {}
        self._publisher: Any = None
        self._subscription: Any = None
        self._closed = False

    def __repr__(self) -> str:
        return f"<Ros2Person {self._name}, {len(self._open)} questions open>"

    # on the event loop's thread

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the answer to a question, `MISSING` if the person does not know; raise a `SourceError` if there is none in time."""
        loop = asyncio.get_running_loop()
        await self._connect(loop)
        words, id = question_text(question), (asker.question or uuid4()).hex
        message = self._message(self._types[0].ASK, id, question, asker, text=words, timeout=self._limit)
        answer: asyncio.Future[object] = loop.create_future()
        self._open[id] = _OpenQuestion(question, message, answer)
        try:
            self._send(message)
            async with asyncio.timeout(self._limit):
                return await answer
        except TimeoutError as error:
            unheard = "" if await self._ros.ask(self._listeners) else f"; nobody listens on {self._name}/questions"
            raise SourceError(f"nobody has answered {words!r} within {self._limit:g} s{unheard}") from error
        finally:
            del self._open[id]
            self._send(to_message(self._types[0], {"kind": self._types[0].WITHDRAW, "id": id}))

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Publish a message to the person; raise a `SourceError` if there is no subscriber."""
        await self._connect(asyncio.get_running_loop())
        written, said = write_value(value), message_text(question, value)
        try:
            async with asyncio.timeout(LISTENER):
                await until_true(self._ros, self._listeners)
        except TimeoutError as error:
            raise SourceError(f"nobody listens on {self._name}/questions to be told {said!r}") from error
        self._send(self._message(self._types[0].TELL, uuid4().hex, question, asker, text=said, value=written))

    async def close(self) -> None:
        """Withdraw the open questions, and the topics."""
        self._closed = True
        for asked in self._open.values():
            if not asked.answer.done():
                asked.answer.set_exception(SourceError("the question was not answered before the end"))
        await asyncio.sleep(0)  # the queries that wait withdraw their questions
        await self._ros.ask(self._disconnect)

    async def _connect(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._closed:
            raise SourceError("nobody can be asked or told anything any more")
        await self._ros.ask(partial(self._subscribe, loop))

    def _message(self, kind: int, id: str, question: Question, asker: Asker, **fields: object) -> Any:
        about = {"run": asker.run, "plan": printable(asker.plan), "name": question.name, "meta": question.meta}
        return to_message(self._types[0], {"kind": kind, "id": id, **about, **fields})

    def _send(self, message: Any) -> None:
        self._ros.call(lambda: self._publisher and self._publisher.publish(message))  # unless it is closed

    def _answered(self, id: str, text: str | None) -> None:
        asked = self._open.get(id)
        if asked is None:
            _log.info("an answer to %s comes too late, or is for others", id)
        elif not asked.answer.done():
            try:
                asked.answer.set_result(MISSING if text is None else read_answer(text, asked.question))
            except SourceError as error:
                _log.warning("ignored an answer on %s/answers: %s", self._name, error)

    def _repeat(self) -> None:
        for asked in self._open.values():
            if not asked.answer.done():
                self._send(asked.message)

    # on the ROS thread

    def _subscribe(self, loop: asyncio.AbstractEventLoop) -> None:
        from rclpy.event_handler import SubscriptionEventCallbacks  # here, because rclpy is an extra

        if self._publisher is None:
            self._publisher = self._ros.node.create_publisher(self._types[0], f"{self._name}/questions", profile(DEPTH, latched=True))

            def matched(change: Any) -> None:
                if change.current_count_change > 0:  # repeat, a little later, what is open then: somebody new may have answered it in vain
                    call_on_loop(loop, loop.call_later, AGAIN, self._repeat)

            def receive(message: Any) -> None:
                call_on_loop(loop, self._answered, message.id, None if message.unknown else message.value)

            topic, events = f"{self._name}/answers", SubscriptionEventCallbacks(matched=matched)
            create = self._ros.node.create_subscription
            self._subscription = create(self._types[1], topic, receive, profile(DEPTH), event_callbacks=events)

    def _listeners(self) -> int:
        return int(self._publisher.get_subscription_count()) if self._publisher is not None else 0

    def _disconnect(self) -> None:
        from rclpy.duration import Duration  # here, because rclpy is an extra

        if self._publisher is not None:
            self._publisher.wait_for_all_acked(Duration(seconds=_FAREWELL))
            self._ros.node.destroy_publisher(self._publisher)
            self._ros.node.destroy_subscription(self._subscription)
            self._publisher = None


def topics(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``topics``: ``name`` is what the names of the topics begin with, ``limit`` the seconds for an answer."""
    only(options, "name", "limit")
    return Ros2Person(thread(surroundings), text(options, "name", NAME), limit=seconds(options, "limit", ANSWER_LIMIT))
