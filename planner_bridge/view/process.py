"""The page in a process of its own, beside the command whose journal it shows: nothing that it does can hold the command up."""

from __future__ import annotations

import asyncio
import json
import select
import subprocess
import sys
from contextlib import suppress
from types import TracebackType
from typing import Final

from pnm.errors import InputError

_READY: Final = 60.0
"""Seconds in which the process has to say where the page is."""
_ENDS: Final = 5.0
"""Seconds in which it has to end."""


class PageProcess:
    """The page, at a port of this computer, until it is closed or this process is dead.

    Raises:
        InputError: the port is in use, or what serves the page is not installed.
    """

    def __init__(self, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "planner_bridge.view", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the command, which ends the page
        )
        assert self._process.stdout is not None
        is_said = select.select([self._process.stdout], [], [], _READY)[0]
        self.url: Final = self._process.stdout.readline().strip() if is_said else ""
        self._is_told = False
        if not self.url.startswith("http"):
            self.close()
            raise InputError(self.url or "the page could not be started")

    def follow(self, journal: str) -> None:
        """Show a journal, which need not be there yet; the first one that is named counts."""
        if not self._is_told and self._process.stdin is not None:
            self._is_told = True
            with suppress(BrokenPipeError):
                self._process.stdin.write(f"{json.dumps(journal)}\n")
                self._process.stdin.flush()

    async def ended(self) -> None:
        """Return when the process has ended."""
        over = asyncio.Event()
        loop, out = asyncio.get_running_loop(), self._process.stdout
        assert out is not None
        loop.add_reader(out, over.set)  # it says nothing more, so this is the end of its output
        try:
            await over.wait()
        finally:
            loop.remove_reader(out)

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
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> PageProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
