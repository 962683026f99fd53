"""People and other sources of knowledge, and the questions that they are asked."""

from __future__ import annotations

import asyncio
import json
import os
import pty
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

from pnm.clock import run_async
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.knowledge.source import Asker


def about(name: str, layer: Layer = Layer.GLOBAL, meta: object = None) -> Question:
    return Question(name, layer, json.dumps(meta))


def run_questions(main: Coroutine[Any, Any, Any], *, virtual: bool = True) -> Any:
    async def bounded() -> Any:
        return await asyncio.wait_for(main, 1000.0)

    return run_async(bounded(), virtual=virtual)


@dataclass
class DelayedSource:
    """A source that answers what it is told to, after a while."""

    answers: dict[str, object] = field(default_factory=dict)
    seconds: float = 0.0
    error: Exception | None = None
    updates: list[tuple[str, object]] = field(default_factory=list)
    closed: bool = False

    async def query(self, question: Question, asker: Asker, /) -> object:
        await asyncio.sleep(self.seconds)
        if self.error:
            raise self.error
        return self.answers.get(question.name, MISSING)

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        await asyncio.sleep(self.seconds)
        self.updates.append((question.name, value))

    async def close(self) -> None:
        if self.error:
            raise self.error
        self.closed = True

    def __repr__(self) -> str:
        return "<DelayedSource>"


class Person:
    """A source of knowledge that answers when a test does.

    Args:
        key: what questions are known by; their names if nothing else is wanted.
        layer: of the questions that a person is asked; any if it is None.

    The mutable state is what was asked and what was withdrawn, each once more as a queue, and what is open.
    """

    def __init__(self, key: Callable[[Question], str] = lambda question: question.name, layer: Layer | None = None) -> None:
        self._key = key
        self._layer = layer
        self.history: list[str] = []
        self.askers: list[Asker] = []
        self.asked: asyncio.Queue[str] = asyncio.Queue()
        self.withdrawn: asyncio.Queue[str] = asyncio.Queue()
        self.open: dict[str, asyncio.Future[object]] = {}

    async def query(self, question: Question, asker: Asker, /) -> object:
        if self._layer not in (None, question.layer):
            return MISSING
        key = self._key(question)
        self.history.append(key)
        self.askers.append(asker)
        answer = self.open[key] = asyncio.get_running_loop().create_future()
        self.asked.put_nowait(key)
        try:
            return await answer
        except asyncio.CancelledError:
            self.withdrawn.put_nowait(key)
            raise
        finally:
            if self.open.get(key) is answer:
                del self.open[key]

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        self.asked.put_nowait(f"{question.name}: {value} {question.meta}")

    async def close(self) -> None: ...

    def answer(self, key: str, value: object) -> None:
        """Answer the open question."""
        self.open[key].set_result(value)


class TerminalUser:
    """Somebody at a terminal, who sees what is shown there and types."""

    def __init__(self) -> None:
        self.hands, screen = pty.openpty()
        self.stream = os.fdopen(screen, "r+b", buffering=0)
        self.answers = open(screen, encoding="utf-8", closefd=False)  # noqa: SIM115 - closed below
        self.shown = open(screen, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        self._seen = ""

    async def sees(self, text: str) -> None:
        """Wait until the text appears; what comes before it is forgotten."""
        loop = asyncio.get_running_loop()
        while text not in self._seen:
            self._seen += (await loop.run_in_executor(None, os.read, self.hands, 4096)).decode()
        self._seen = self._seen.partition(text)[2]

    def types(self, text: str) -> None:
        os.write(self.hands, text.encode())

    def leave(self) -> None:
        for one in (self.answers, self.shown, self.stream):
            one.close()
        os.close(self.hands)
