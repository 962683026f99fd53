"""Lets those who wait for a change try again, one after the other."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, Generic, TypeVar

PATIENCE: Final = 5
"""So many who try in vain one after the other; those behind them try after the next change."""

Who = TypeVar("Who")


class Turnstile(Generic[Who]):
    """A line before something that only one can try at a time, such as to find room for a plan.

    The mutable state is who waits, who has been let through and has neither come back nor gone, who is still to be let through
    since the last change, and how many have tried in vain since somebody did not.

    Args:
        rank: those with the lowest are let through first.
    """

    def __init__(self, rank: Callable[[Who], tuple[int, int]]) -> None:
        self._rank = rank
        self._line: dict[Who, asyncio.Future[None]] = {}
        self._inside: Who | None = None
        self._left: list[Who] = []
        self._misses = 0

    async def wait(self, who: Who) -> None:
        """Stand in line until it is one's turn; who comes back has tried in vain."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._line[who] = turn
        if self._inside == who:
            self._inside = None
            self._misses += 1
            self._admit()
        try:
            await turn
        finally:
            self._line.pop(who, None)

    def gone(self, who: Who) -> None:
        """Note that somebody does not try any more, with success or not."""
        if self._inside == who:
            self._inside, self._misses = None, 0
            self._admit()

    def changed(self) -> None:
        """Let all try again, the first in line first."""
        self._left = sorted(self._line, key=self._rank)
        self._misses = 0
        if self._inside is None:
            self._admit()

    def _admit(self) -> None:
        while self._left and self._misses < PATIENCE:
            who = self._left.pop(0)
            turn = self._line.get(who)
            if turn is not None and not turn.done():
                self._inside = who
                turn.set_result(None)
                return
