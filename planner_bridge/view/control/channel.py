"""The channel from the page to the process that has started it: a line of JSON for every command, and one for its reply."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any, Final

from planner_bridge.view.control.commands import Reply

_LIMIT: Final = 30.0
"""Seconds for a reply."""
_OPEN: Final = 32
"""Commands that wait for their replies at the same time: their replies fit into a pipe, so nobody waits to write one."""


class Channel:
    """The end of the page.

    The mutable state is what waits for replies, by the numbers of commands.

    Args:
        write: writes a line to the other end.
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._numbers = count(1)
        self._waiting: dict[int, asyncio.Future[Reply]] = {}

    async def ask(self, command: Mapping[str, Any]) -> Reply:
        """Send a command on, and return the reply."""
        if len(self._waiting) >= _OPEN:
            return Reply("too much is asked for at once; try again in a moment")
        number = next(self._numbers)
        replied: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[number] = replied
        try:
            self._write(json.dumps({"number": number, "command": command}))
            async with asyncio.timeout(_LIMIT):
                return await replied
        except TimeoutError:
            return Reply(f"there was no answer within {_LIMIT:g} s; what was wanted may still happen")
        except BrokenPipeError:
            return Reply("the process that has the tasks has ended")
        finally:
            del self._waiting[number]

    def hear(self, line: str) -> None:
        """Take in a line from the other end, on the event loop."""
        heard = json.loads(line)
        waiting = self._waiting.get(heard["number"])
        if waiting is not None and not waiting.done():
            waiting.set_result(Reply(**heard["reply"]))
