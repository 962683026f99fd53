"""A person at the terminal: one question at a time, while everything else goes on.

The line is read on a thread, which holds virtual time still: a person cannot answer within a simulated second.
"""

from __future__ import annotations

import asyncio
import os
import select
import sys
import termios
from typing import Final, TextIO

from pnm.core.logic.computed_values import Question
from pnm.errors import printable
from pnm.knowledge.sources.person_text import LIMIT, message_text, question_text, read_answer
from pnm.knowledge.sources.source import Asker, SourceError

_LINE: Final = 4096


class TerminalSource:
    """A person at the terminal: questions are written to one stream and answers read from another, which must be a terminal.

    An answer is read by `read_answer`; an empty line means that the person does not know. Input from before
    a question appeared does not count as its answer.

    The mutable state is the queue of the questions, which the lock holds.

    Args:
        answers: the input stream; by default the standard input.
        shown: the stream for questions; by default the standard error, since the standard output is for results.
        limit: seconds for an answer, on a real clock.
    """

    def __init__(self, answers: TextIO | None = None, shown: TextIO | None = None, *, limit: float = LIMIT) -> None:
        self._answers = answers
        self._shown = shown
        self._limit = limit
        self._turn = asyncio.Lock()

    def __repr__(self) -> str:
        return "<Terminal>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Show the question when its turn comes and return the answer, or `MISSING` for an empty line."""
        self._check()
        async with self._turn:
            termios.tcflush(self._input.fileno(), termios.TCIFLUSH)
            self._show(f"{_name(asker)}{question_text(question)}", " ")
            while True:
                line = await self._line()
                try:
                    return read_answer(line, question)
                except SourceError as error:
                    self._show(f"{error}; once more:", " ")

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Show the value as a message."""
        self._check()
        async with self._turn:
            self._show(f"{_name(asker)}{message_text(question, value)}")

    async def close(self) -> None:
        """Leave the terminal as it is."""

    def _check(self) -> None:
        if not is_terminal(self._input):
            raise SourceError("a person was to be asked or told something, but there is no terminal to do it on")

    @property
    def _input(self) -> TextIO:
        return sys.stdin if self._answers is None else self._answers

    def _show(self, text: str, end: str = "\n") -> None:
        stream = sys.stderr if self._shown is None else self._shown
        stream.write(printable(text) + end)
        stream.flush()

    async def _line(self) -> str:
        """Read a line on a thread; when this is cancelled, the thread stops reading first."""
        heard, ring = os.pipe()
        reading = asyncio.get_running_loop().run_in_executor(None, self._read, heard)
        try:
            return await asyncio.shield(reading)
        except (asyncio.CancelledError, SourceError):
            os.write(ring, b"\0")
            await asyncio.gather(reading, return_exceptions=True)
            self._show(" (no longer asked)")
            raise
        finally:
            os.close(heard)
            os.close(ring)

    # on the thread

    def _read(self, bell: int) -> str:
        terminal = self._input.fileno()
        ready, _, _ = select.select([terminal, bell], [], [], self._limit)
        if bell in ready:
            return ""
        if not ready:
            raise SourceError(f"nobody has answered on the terminal within {self._limit:g} s")
        line = os.read(terminal, _LINE)
        if not line:
            raise SourceError("the terminal was closed")
        return line.decode("utf-8", "replace")


def is_terminal(stream: TextIO | None = None) -> bool:
    """Return whether the stream, or the standard input, is a terminal."""
    try:
        return (sys.stdin if stream is None else stream).isatty()
    except (ValueError, AttributeError):  # it was closed, or never there
        return False


def _name(asker: Asker) -> str:
    return f"[{asker.plan}] " if asker.plan else ""
