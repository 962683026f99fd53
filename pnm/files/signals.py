"""Signals that end a process: the first cancels its work, which comes to its end in order; the second has it leave in any case."""

from __future__ import annotations

import _thread
import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from math import inf
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

if TYPE_CHECKING:
    import asyncio

T = TypeVar("T")
_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a process unless it handles them: Ctrl-C, `kill` and supervisors, a terminal that is closed, Ctrl-\\."""
_ONE_REQUEST: Final = 1.0
"""Seconds in which signals count as one: some supervisors send theirs to a process and to its group as well."""
LEAVING: Final = 2.0
"""Seconds of real time that a process has to leave in order after a second signal; then it leaves at once."""
_CALLBACK: Final = 0.01
"""Seconds for a callback that has swallowed Ctrl-C to be over."""
_SPEAKING: Final = 0.5
"""Seconds for its last words."""
CANCELLED: Final = 1
"""The exit status of a process that leaves at once."""


class LastWords:
    """The immediate end of a program: its last words, unless they were said, and its status.

    The mutable state is those, whether they are said, and whether this process is such a program: what is no program of ours leaves
    when its caller does.
    """

    def __init__(self) -> None:
        self._words: Callable[[], object] = lambda: sys.stderr.write("cancelled\n")
        self.status = CANCELLED
        self.is_program = False
        self.are_said = False

    def belong_to_program(self, words: Callable[[], object]) -> None:
        """Have the process leave at once, with these words, when it is told so twice, or before it has begun."""
        self._words, self.is_program = words, True

    def say(self) -> None:
        """Say them, once."""
        words, self._words, self.are_said = self._words, lambda: None, True
        words()

    def drop(self, status: int) -> None:
        """Have nothing left to say: how it went has been told, and is the exit status."""
        self._words, self.status = lambda: None, status


LAST_WORDS: Final = LastWords()


class StoppableWork:
    """Work that signals cancel in place of killing the process, which could not cancel then what its robots do.

    The first signal cancels the work, which then comes to its end in order; the next one cancels it again, and the process leaves
    within `LEAVING` seconds, whatever still goes on. A signal during which the loop is too busy to hear even of the one before raises
    `KeyboardInterrupt`. Signals that the caller ignores or handles are left alone;
    SIGINT is ignored in no program that `leave_at_ctrl_c`, which handles it before.

    The loop runs the work; `cancelled` is called on it whenever the work is cancelled, before that.
    The mutable state is the task of the work, and when the last signal came, and whether the loop has yet to hear of it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, cancelled: Callable[[], object]) -> None:
        self._loop = loop
        self._cancelled = cancelled
        self._task: asyncio.Task[Any] | None = None
        self._last = -inf
        self._is_pending = False

    async def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Await the coroutine that is the work, and return its result."""
        from asyncio import current_task  # here, because a program imports this before anything that takes its time

        self._task = current_task()
        return await main

    @contextmanager
    def handled(self) -> Iterator[None]:
        """Handle the signals; only the main thread can."""
        is_main = threading.current_thread() is threading.main_thread()
        usual = {number: signal.getsignal(number) for number in _ENDING if is_main}
        ours = [number for number, handler in usual.items() if handler in (signal.SIG_DFL, signal.default_int_handler)]
        try:
            for number in ours:
                signal.signal(number, self._receive)
            yield
        finally:
            for number in ours:
                signal.signal(number, usual[number])

    def _receive(self, number: int, frame: object) -> None:
        now = monotonic()
        if now - self._last < _ONE_REQUEST:  # of the same request; what is ignored does not put the next one off
            return
        before, self._last = self._last, now
        if before > -inf and LAST_WORDS.is_program:
            leave_within(LEAVING)
        if self._is_pending:
            raise KeyboardInterrupt
        self._is_pending = True

        def cancel() -> None:
            self._is_pending = False
            self._cancelled()
            if self._task is not None:
                self._task.cancel()

        self._loop.call_soon_threadsafe(cancel)


def leave_within(seconds: float) -> None:
    """Have the process leave at once when it has not ended after these seconds: by a thread, since its own work may be what hangs."""
    _later(seconds, leave)


def leave() -> NoReturn:
    """End the process at once. Nothing is closed: what is kept, such as a journal, is as after a crash."""

    def say_and_exit() -> None:
        try:
            LAST_WORDS.say()
        finally:
            os._exit(LAST_WORDS.status)

    _later(0.0, say_and_exit)
    sleep(_SPEAKING)  # who should read the words may have stopped reading
    os._exit(LAST_WORDS.status)


def _later(seconds: float, function: Callable[[], object]) -> None:
    """Call a function in a thread of its own. Not one of `threading`, whose lock this thread may have just now: signals come anywhere."""

    def call() -> None:
        sleep(seconds)
        function()

    _thread.start_new_thread(call, ())


def leave_at_ctrl_c(words: Callable[[], object]) -> None:
    """Have Ctrl-C end this program at once, with words that say so, where it is not `interruptible`.

    While it is being imported, and when it is over, there is nothing to be closed; and what is unwound there is no business of people.
    """
    LAST_WORDS.belong_to_program(words)
    signal.signal(signal.SIGINT, _leave_now)  # also when it was ignored, as by shells for what they start in the background
    sys.unraisablehook = _raise_again
    atexit.register(_end)  # first, so that it comes last


@contextmanager
def interruptible() -> Iterator[None]:
    """Have Ctrl-C raise `KeyboardInterrupt` while this is entered, also in a program that would leave at once."""
    is_ours = signal.getsignal(signal.SIGINT) is _leave_now
    if is_ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, _leave_now)


def _end() -> None:
    """End the process with its status: once Python itself ends, Ctrl-C would become the status, even one that was handled long ago."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if LAST_WORDS.are_said:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(LAST_WORDS.status)


def _leave_now(number: int, frame: object) -> None:
    leave()


def _raise_again(swallowed: sys.UnraisableHookArgs) -> None:
    """Have Ctrl-C be heard that came while Python was in a callback out of which nothing can be raised."""
    if issubclass(swallowed.exc_type, KeyboardInterrupt):
        _later(_CALLBACK, _thread.interrupt_main)  # later, or it would be swallowed here
    else:
        sys.__unraisablehook__(swallowed)
