"""A person as a knowledge source over two topics, questions and answers: a screen, a dialogue system, a remote operator.

At first contact an answer may be lost: DDS matches the two topics one after the other, so a question may be heard, and answered,
before the publisher of the answer knows that we listen. So open questions are repeated when a publisher of answers is new.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final
from uuid import uuid4

from pnm.core.logic.computed_values import MISSING, Question
from pnm.errors import printable
from pnm.knowledge.people import ANSWER_LIMIT, message_text, question_text, read_answer
from pnm.knowledge.source import Asker, Source, SourceError, write_value
from pnm.knowledge.sources import Surroundings, only, seconds, text
from pnm.ros.knowledge.knowledge_source import NAME, thread, uuid_field
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.service_client import until_true

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
        written = write_value(value)
        try:
            async with asyncio.timeout(LISTENER):
                await until_true(self._ros, self._listeners)
        except TimeoutError as error:
            raise SourceError(f"nobody listens on {self._name}/questions to be told {message_text(question, value)!r}") from error
        said = message_text(question, value)
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
        about = {"run": uuid_field(asker.run), "plan": printable(asker.plan), "name": question.name, "meta": question.meta}
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

    def _discovered(self) -> None:
        """Repeat, a little later, what is open then, as somebody new may have answered it in vain."""
        asyncio.get_running_loop().call_later(AGAIN, self._repeat)

    def _repeat(self) -> None:
        for asked in self._open.values():
            if not asked.answer.done():
                self._send(asked.message)

    # on the ROS thread

    def _subscribe(self, loop: asyncio.AbstractEventLoop) -> None:
        from rclpy.event_handler import SubscriptionEventCallbacks  # here, because rclpy is an extra
        from rclpy.qos import DurabilityPolicy, QoSProfile

        if self._publisher is None:
            latched = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._publisher = self._ros.node.create_publisher(self._types[0], f"{self._name}/questions", latched)
            receive = partial(self._receive, loop)
            matched = SubscriptionEventCallbacks(matched=partial(self._matched, loop))
            self._subscription = self._ros.node.create_subscription(
                self._types[1], f"{self._name}/answers", receive, QoSProfile(depth=DEPTH), event_callbacks=matched
            )

    def _matched(self, loop: asyncio.AbstractEventLoop, change: Any) -> None:
        if change.current_count_change > 0:
            call_on_loop(loop, self._discovered)

    def _receive(self, loop: asyncio.AbstractEventLoop, message: Any) -> None:
        call_on_loop(loop, self._answered, message.id, None if message.unknown else message.value)

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
