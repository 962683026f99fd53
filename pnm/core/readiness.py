"""Readiness: whether the action servers and sensors that a robot needs are there, and are what the files about them expect."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from pnm.errors import InputError, Position


class ReadyState(Enum):
    """The readiness of an action server or a sensor."""

    READY = "ready"
    ABSENT = "absent"
    """Not there, which may change."""
    SEVERAL = "several"
    """There more than once, which may change."""
    SILENT = "silent"
    """There, but nothing was heard of it."""
    STALE = "stale"
    """It was heard, and has fallen silent, or says what cannot be so."""
    OPEN = "open"
    """Its name depends on a value that its calls get when they start."""
    UNFIT = "unfit"
    """It can never work with the files as they are."""


@dataclass(frozen=True, slots=True)
class Readiness:
    """The readiness of one action with its server, or of one sensor."""

    what: str
    """The action, or the sensor by what it reports."""
    name: str
    """Of the action server, topic or service."""
    type: str
    """In the ROS graph, or as expected while nothing is there; empty if neither is known."""
    state: ReadyState
    advice: str = ""
    """Why it is not ready, and what to do about it."""
    waits: str = ""
    """The consequence while it is missing, as the rest of a sentence about it; empty if it is not waited for."""
    position: Position | None = None
    """Of the binding or of the sensor in its file."""
    is_sensor: bool = False

    def __str__(self) -> str:
        return (self.where or f"{self.what}: ") + self.advice

    @property
    def where(self) -> str:
        """The position in a file to change; empty for none."""
        return f"{self.position}: " if self.position and self.state is ReadyState.UNFIT else ""

    def as_json(self) -> dict[str, object]:
        """Return it as plain data."""
        where = self.position and {"file": self.position.file, "line": self.position.line, "column": self.position.column}
        return {
            "what": self.what,
            "name": self.name,
            "type": self.type,
            "state": self.state.value,
            "advice": self.advice,
            "position": where,
        }


def refuse_unfit(rows: Iterable[Readiness]) -> None:
    """Raise an `InputError` with all that can never work, if there is something."""
    if unfit := [str(row) for row in rows if row.state is ReadyState.UNFIT]:
        raise InputError("\n".join(dict.fromkeys(unfit)))
