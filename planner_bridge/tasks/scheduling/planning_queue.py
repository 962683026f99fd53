"""Lets one after the other try something that they would spoil for each other, such as finding room for a plan."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, Generic, TypeVar

PATIENCE: Final = 5
"""So many who try again in vain, one after the other, after a change; those behind them try after the next one."""
SLOW: Final = 1.0
"""Seconds after which the next one is let through beside somebody who is still trying."""

Who = TypeVar("Who")


class Turnstile(Generic[Who]):
    """The line of those who are to try, and those who have tried in vain and wait for a change.

    The mutable state is both, who has been let through and has not left, who of them is slow or has been overtaken by a change,
    and how many have tried again in vain since the last change.

    Args:
        rank: those with the lowest are let through first.
    """

    def __init__(self, rank: Callable[[Who], tuple[int, int]]) -> None:
        self._rank = rank
        self._line: dict[Who, asyncio.Future[None]] = {}
        self._disappointed: set[Who] = set()
        self._inside: dict[Who, asyncio.TimerHandle] = {}
        self._slow: set[Who] = set()
        self._overtaken: set[Who] = set()
        self._misses = 0

    async def enter(self, who: Who) -> None:
        """Wait for one's turn; who has left in vain waits for a change first."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._line[who] = turn
        # everybody who comes at this moment is in line before the first is let through
        asyncio.get_running_loop().call_soon(self._admit)
        try:
            await turn
        finally:
            self._line.pop(who, None)

    def leave(self, who: Who, *, in_vain: bool = False) -> None:
        """Note that somebody does not try any more; of who is not inside nothing is noted.

        Who has been overtaken by a change has not tried in vain what can be tried now.
        """
        if who in self._inside:
            self._inside.pop(who).cancel()
            self._slow.discard(who)
            self._misses = self._misses + 1 if in_vain else 0
            if in_vain and who not in self._overtaken:
                self._disappointed.add(who)
            self._overtaken.discard(who)
            self._admit()

    def changed(self) -> None:
        """Let those try again who have tried in vain."""
        self._disappointed.clear()
        self._overtaken = {*self._inside}
        self._misses = 0
        self._admit()

    def _admit(self) -> None:
        if self._inside.keys() - self._slow:
            return
        waiting = [who for who in sorted(self._line, key=self._rank) if who not in self._disappointed and not self._line[who].done()]
        if waiting and self._misses < PATIENCE:
            self._inside[waiting[0]] = asyncio.get_running_loop().call_later(SLOW, self._let_another_in, waiting[0])
            self._line[waiting[0]].set_result(None)

    def _let_another_in(self, slow: Who) -> None:
        self._slow.add(slow)
        self._admit()
