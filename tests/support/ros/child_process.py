"""The scripts of this folder as processes whose lines are read one by one."""

from __future__ import annotations

import asyncio
import select
import subprocess
import sys
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, Final

import pytest

from tests.support.files import ROOT
from tests.support.processes import LIMIT

ORDERLY: Final = 15.0
"""Seconds for a process to end in order."""


async def until_logged(caplog: pytest.LogCaptureFixture, text: str) -> None:
    """Wait until a text is in the log."""
    async with asyncio.timeout(LIMIT):
        while text not in caplog.text:  # noqa: ASYNC110 - a log has no event
            await asyncio.sleep(0.02)


class ChildProcess:
    """One of the scripts, once it is ready; `said` is for tests to note what they have heard last."""

    def __init__(self, name: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"tests.support.ros.{name}", *arguments]
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self._read = b""
        self.said = ""
        assert self.line() == "ready"

    def line(self, limit: float = LIMIT) -> str:
        """Wait for the next line of its standard output."""
        assert self.process.stdout is not None
        while b"\n" not in self._read:
            ready, _, _ = select.select([self.process.stdout], [], [], limit)
            assert ready, "it says nothing"
            read = self.process.stdout.read1(65536)
            assert read, self.process.communicate()[1].decode()
            self._read += read
        line, _, self._read = self._read.partition(b"\n")
        return line.decode()

    def kill(self) -> None:
        """End it as a crash would."""
        self.process.kill()
        self.process.communicate(timeout=LIMIT)

    def stop(self) -> str:
        """End it in order and return what it has said on the standard error.

        Once in a hundred times the middleware does not come to its end in a process that is told to; then it is killed.
        """
        self.process.terminate()
        try:
            return self.process.communicate(timeout=ORDERLY)[1].decode()
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.communicate(timeout=LIMIT)[1].decode()


def run_bounded(main: Coroutine[Any, Any, Any], limit: float = LIMIT) -> Any:
    """Run a test's coroutine, which may not hang."""

    async def bounded() -> Any:
        return await asyncio.wait_for(main, limit)

    return asyncio.run(bounded())


def bounded(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Have a test that is a coroutine be run, for as long as a busy machine needs and no longer."""

    @wraps(test)
    def run(*arguments: Any, **fixtures: Any) -> None:
        run_bounded(test(*arguments, **fixtures))

    return run
