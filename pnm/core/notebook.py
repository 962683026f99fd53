"""Pictures that notebooks show of values. The pictures are above the values in this package, so what is above both says who draws them."""

from __future__ import annotations

from typing import Any, Protocol


class Draw(Protocol):
    """Draws a value."""

    def __call__(self, value: Any, /) -> str | None:
        """Return its picture as SVG; None where the text of the value says more."""


class Picture:
    """The picture of values of one class: what draws it, which is mutable state."""

    def __init__(self) -> None:
        self.draw: Draw = lambda _: None


PLAN = Picture()
MACHINE = Picture()
