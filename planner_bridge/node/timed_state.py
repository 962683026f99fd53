"""A limit for the time that the answers to questions about a state may take."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from typing import Final

from pnm.core.logic.expressions import Fluent, State, Unknown, Value
from pnm.errors import InputError

MAX_SECONDS: Final = 5.0
"""For the answers to all questions at once."""


@dataclass(frozen=True, slots=True)
class TimedState:
    """A state that can be asked until a time, on the monotonic clock."""

    state: State
    until: float

    @staticmethod
    def begin(state: State) -> TimedState:
        """Return a state that can be asked for `MAX_SECONDS` from now."""
        return TimedState(state, monotonic() + MAX_SECONDS)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a fluent; raise an `InputError` if the time is over."""
        self.check()
        return self.state.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return self.state.objects(types)

    def check(self) -> None:
        """Raise an `InputError` if the time is over."""
        if monotonic() > self.until:
            raise InputError(f"the answers have taken {MAX_SECONDS:g} s; expected fewer or simpler questions")
