"""Pictures that notebooks show of values. The pictures are above the values in this package, so what is above both says who draws them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Picture:
    """The picture of values of one class: what draws it, which is mutable state."""

    def __init__(self) -> None:
        self.draw: Callable[[Any], str | None] = lambda _: None
        """Returns the picture of a value as SVG; None where its text says more."""


PLAN = Picture()
MACHINE = Picture()
