"""Values that are made when they are asked for, and kept: from then on, or for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class WhenAsked(dict[K, V]):
    """Values that are made when they are first asked for, and kept."""

    def __init__(self, make: Callable[[K], V]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, key: K) -> V:
        value = self[key] = self._make(key)
        return value


class Remembered(Generic[K, V]):
    """Values that were made once and may be needed again: when there are too many, all are forgotten.

    The mutable state is all of it.
    """

    def __init__(self, limit: int = 1000) -> None:
        self._limit, self._values = limit, dict[K, V]()

    def get(self, key: K) -> V | None:
        """Return the value under a key."""
        return self._values.get(key)

    def keep(self, key: K, value: V) -> V:
        """Keep a value, and return it; if another is kept under its key already, that one."""
        if len(self._values) >= self._limit:
            self.forget()
        return self._values.setdefault(key, value)

    def forget(self) -> None:
        """Forget all of them."""
        self._values = {}
