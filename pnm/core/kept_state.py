"""The state of an object as values, and back: what a journal keeps of a run that goes on, so that another process makes it again."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar


class KeptState:
    """An object that tells its state as plain values, and takes it back; each class says beside its fields which of them that are.

    All others follow from those, or from what the object is made with.
    """

    KEPT: ClassVar[tuple[str, ...]]
    """The attributes that are its state."""

    def values(self) -> dict[str, Any]:
        """Return its state; containers are copied, their content is not."""
        state: dict[str, Any] = {}
        for name in self.KEPT:
            value = getattr(self, name)
            match value:
                case list() | deque():
                    state[name] = tuple(value)
                case set():
                    state[name] = frozenset(value)
                case dict():
                    state[name] = dict(value)
                case _:
                    state[name] = value
        return state

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back, of an object that was made with the same; containers stay the ones that others know."""
        for name in self.KEPT:
            value, held = values[name], getattr(self, name)
            match held:
                case dict():
                    held.clear()
                    held.update({key: copy(item) if isinstance(item, dict | list) else item for key, item in value.items()})
                case set():
                    held.clear()
                    held.update(value)
                case list() | deque():
                    held.clear()
                    held.extend(value)
                case _:
                    setattr(self, name, value)
