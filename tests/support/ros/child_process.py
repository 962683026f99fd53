"""The scripts of this folder as processes whose lines are read one by one; and tests that are coroutines, and may not hang."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, suppress
from dataclasses import dataclass
from typing import Any, Final

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor

from tests.support.processes import LIMIT, Program, say

_ORDERLY: Final = 15.0
"""Seconds for a process to end in order."""
OURS: Final = "/pnm/ros/"
"""Stands in every traceback of what is tested; rclpy itself may fail with one while its context ends."""


def spin(*nodes: Any, threads: int = 1) -> None:
    """Say that a script is ready, and spin its nodes until the process is told to end."""
    executor = SingleThreadedExecutor() if threads == 1 else MultiThreadedExecutor(threads)
    for node in nodes:
        executor.add_node(node)
    say("ready")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(0.5)  # `spin` sometimes sleeps through the signal that is to end it


async def until_logged(caplog: pytest.LogCaptureFixture, text: str) -> None:
    """Wait until a text is in the log."""
    async with asyncio.timeout(LIMIT):
        while text not in caplog.text:  # noqa: ASYNC110 - a log has no event
            await asyncio.sleep(0.02)


class ChildProcess(Program):
    """One of the scripts, once it is ready; `name` is its first argument, and `said` is for tests to note what they have heard last."""

    def __init__(self, script: str, *arguments: str, **environment: str) -> None:
        super().__init__(["-m", f"tests.support.ros.{script}", *arguments], environment)
        self.name = arguments[0] if arguments else ""
        self.said = ""
        self._read = 0
        assert self.line() == "ready"

    def line(self) -> str:
        """Wait for the next line of its standard output."""
        self._read += 1
        self.until(lambda: len(self.out) >= self._read)
        return self.out[self._read - 1]

    def stop(self) -> str:
        """End it in order and return what it has said on the standard error.

        Once in a hundred times the middleware does not come to its end in a process that is told to; then it is killed.
        """
        self.process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_ORDERLY)
        self.kill()
        for reader in self._readers:
            reader.join(LIMIT)
        return "\n".join(self.err)


def run_bounded(main: Coroutine[Any, Any, Any]) -> Any:
    """Run a test's coroutine, which may not hang."""

    async def bounded() -> Any:
        return await asyncio.wait_for(main, LIMIT)

    return asyncio.run(bounded())


@dataclass(frozen=True)
class Within:
    """What a fixture gives to a test that is a coroutine: it gets what the context gives, and the context ends with it."""

    context: AbstractAsyncContextManager[Any]


async def run_within(test: Callable[..., Coroutine[Any, Any, None]], given: Mapping[str, object]) -> None:
    """Run a test with its fixtures, within the contexts among them."""
    async with AsyncExitStack() as stack:
        entered = {name: await stack.enter_async_context(one.context) for name, one in given.items() if isinstance(one, Within)}
        await test(**{**given, **entered})
