"""One listener that passes every moment on to several listeners."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import cache
from typing import Any, TypeVar, cast

L = TypeVar("L")


def broadcast(kind: type[L], listeners: Sequence[L]) -> L:
    """Return a listener that passes every moment on to all listeners, in their order.

    The moments are the public methods of the class, so that a new one is passed on as soon as it is there.

    Args:
        kind: the class of the listeners, with an empty method per moment.
        listeners: may change at any time; those of the time at which a moment comes are called.
    """
    listener: L = _broadcaster(cast("Hashable", kind))()
    listener.__dict__["listeners"] = listeners
    return listener


@cache
def _broadcaster(kind: Any) -> Any:
    moments = {name: _passes_on(name) for name in dir(kind) if not name.startswith("_")}
    return type(f"Broadcast{kind.__name__}", (kind,), moments)


def _passes_on(moment: str) -> Callable[..., None]:
    def pass_on(self: Any, *arguments: object, **options: object) -> None:
        for listener in tuple(self.listeners):
            getattr(listener, moment)(*arguments, **options)

    return pass_on
