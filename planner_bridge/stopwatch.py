"""Where the time of a task goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Adds up where the time of a task goes, in seconds of the wall clock."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("parse", "plan", "translate", "verify", "execute"), 0.0)

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Measure one part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - began
