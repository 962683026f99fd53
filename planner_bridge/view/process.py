"""The page in a process of its own, beside the command whose journal it shows: nothing that it does can hold the command up."""

from __future__ import annotations

import asyncio
import json
import select
import subprocess
import threading
from contextlib import suppress
from types import TracebackType
from typing import Any, Final

from planner_bridge.view.control.commands import Controlled, Reply
from planner_bridge.view.control.operator import Operator
from pnm.errors import InputError
from pnm.files.process import own_environment, own_python

_READY: Final = 60.0
"""Seconds in which the process has to say where the page is."""
_ENDS: Final = 5.0
"""Seconds in which it has to end."""


class PageProcess:
    """The page, at a port of this computer, until it is closed or this process is dead.

    The mutable state is whether it knows its journal, and who carries out what people want on it, on which event loop.

    Args:
        port: where it is; any that is free for 0.
        controlled: what those may control who have its token, which is in its URL then.

    Raises:
        InputError: the port is in use, or what serves the page is not installed.
    """

    def __init__(self, port: int, controlled: Controlled = Controlled.NOTHING) -> None:
        self._process = subprocess.Popen(
            own_python("-m", "planner_bridge.view", str(port), controlled.value),
            env=own_environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the command, which ends the page
        )
        assert self._process.stdout is not None
        is_said = select.select([self._process.stdout], [], [], _READY)[0]
        self.url: Final = self._process.stdout.readline().strip() if is_said else ""
        self._is_told = False
        self._operator: tuple[Operator, asyncio.AbstractEventLoop] | None = None
        self._working: set[asyncio.Task[None]] = set()
        self._writing = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        if not self.url.startswith("http"):
            self.close()
            raise InputError(self.url or "the page could not be started")
        self._reader.start()

    def follow(self, journal: str) -> None:
        """Show a journal, which need not be there yet; the first one that is named counts."""
        if not self._is_told:
            self._is_told = True
            self._write(journal)

    def operate(self, operator: Operator) -> None:
        """Have an operator carry out, on the event loop that runs here, what people want on the page from now on."""
        self._operator = operator, asyncio.get_running_loop()

    async def ended(self) -> None:
        """Return when the process has ended."""
        over, loop = asyncio.Event(), asyncio.get_running_loop()

        def wait() -> None:
            self._reader.join()
            with suppress(RuntimeError):  # the loop is over already
                loop.call_soon_threadsafe(over.set)

        threading.Thread(target=wait, daemon=True).start()
        await over.wait()

    def close(self) -> None:
        """End the page."""
        with suppress(BrokenPipeError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(_ENDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader.ident is not None:
            self._reader.join(_ENDS)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> PageProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _read(self) -> None:
        """Have each command that the page sends carried out, and reply to it."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            wanted = json.loads(line)
            number, refused = wanted["number"], Reply("there is nothing yet that could be controlled")
            if self._operator is not None:
                operator, loop = self._operator
                try:
                    loop.call_soon_threadsafe(self._begin, operator, number, wanted["command"])
                    continue
                except RuntimeError:  # the loop is closed
                    refused = Reply("it is over: nothing is left that could be controlled")
            self._reply(number, refused)

    def _begin(self, operator: Operator, number: int, command: object) -> None:
        async def work() -> None:
            self._reply(number, await operator.reply(command))

        task = asyncio.ensure_future(work())
        self._working.add(task)
        task.add_done_callback(self._working.discard)

    def _reply(self, number: int, reply: Reply) -> None:
        self._write({"number": number, "reply": reply.as_json()})

    def _write(self, value: Any) -> None:
        with self._writing, suppress(BrokenPipeError, ValueError):  # it has ended, or is closed
            if self._process.stdin is not None:
                self._process.stdin.write(f"{json.dumps(value)}\n")
                self._process.stdin.flush()
