"""Frames: what is sent to a browser, the whole state or what has changed in it; and the JSON of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, Final

from planner_bridge.view.shown import Shown, View

_HEAD: Final = ("number", "time", "began", "first", "problem", "clock")
PARTS: Final = tuple(part.name for part in fields(View) if part.name not in _HEAD)
"""The parts of a view that have things by key."""


def frame(before: View | None, after: View) -> dict[str, Any]:
    """Return the frame that makes of what a browser has seen what is so now: the whole state if it has seen nothing.

    In its parts, None stands for what is not there any more.
    """
    parts = {name: _changes({} if before is None else getattr(before, name), getattr(after, name)) for name in PARTS}
    head: dict[str, Any] = {name: getattr(after, name) for name in _HEAD}
    return {**head, "is_whole": before is None, "parts": {name: changes for name, changes in parts.items() if changes}}


def _changes(before: Mapping[str, Shown], after: Mapping[str, Shown]) -> dict[str, Any]:
    if before is after:
        return {}
    changed: dict[str, Any] = {key: asdict(shown) for key, shown in after.items() if (old := before.get(key)) is not shown and old != shown}
    return changed | dict.fromkeys(before.keys() - after.keys())
