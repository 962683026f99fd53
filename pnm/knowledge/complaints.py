"""Complaints about bad reports: the first is logged at once, those that follow as a number, so that nothing floods the log."""

from __future__ import annotations

import asyncio
import logging
from typing import Final

PERIOD: Final = 60.0
"""Seconds between two lines of the log about the same source."""


class Complaints:
    """Complaints about one source of reports, on the event loop's thread.

    The mutable state is how many complaints have not been logged yet, the last one, and the timer of the next line.

    Args:
        source: what people know it by.
        log: where the complaints go.
    """

    def __init__(self, source: str, log: logging.Logger) -> None:
        self._source = source
        self._log = log
        self._count = 0
        self._last = ""
        self._timer: asyncio.TimerHandle | None = None

    def note(self, reason: str) -> None:
        """Log why a report is wrong: now, or with others at the end of the period."""
        if self._timer is None:
            self._log.warning("a report on %s is wrong: %s", self._source, reason)
            self._timer = asyncio.get_running_loop().call_later(PERIOD, self._end_period)
        else:
            self._count += 1
            self._last = reason

    def close(self) -> None:
        """Log what has not been logged yet."""
        if self._timer is not None:
            self._timer.cancel()
            self._summarize()

    def _end_period(self) -> None:
        # as long as there are complaints, periods follow each other, with one line each
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._end_period) if self._count else None
        self._summarize()

    def _summarize(self) -> None:
        if self._count:
            self._log.warning("%d more reports on %s were wrong; the last one: %s", self._count, self._source, self._last)
            self._count = 0
