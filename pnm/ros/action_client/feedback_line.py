"""Feedback of action servers on one line: its numbers and texts by the names of their fields, the outer fields first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from pnm.ros.node.messages import fields, plain

LENGTH: Final = 160
"""Characters of a line."""
ITEMS: Final = 5
"""Numbers or texts of a list that are written; of a longer list, and of one of messages, only how many there are."""
_TIME: Final = ("sec", "nanosec")
"""The fields of a time or a duration."""


def feedback_line(message: Any) -> str:
    """Return the fields of a message as "distance_remaining 1.2, recoveries 0".

    Headers, empty texts and nested messages that nobody filled in are left out.
    """
    line = ""
    for part in readable_fields(message):
        longer = f"{line}, {part}" if line else part
        if len(longer) > LENGTH:
            return f"{line}, …" if line else f"{part[: LENGTH - 1]}…"
        line = longer
    return line


def readable_fields(message: Any) -> Iterator[str]:
    """Yield the fields with their names, level by level; those of nested messages with the names of both."""
    level = [("", message)]
    while level:
        deeper: list[tuple[str, Any]] = []
        for path, outer in level:
            for name in fields(outer):
                value = getattr(outer, name)
                if name == "header":
                    continue
                if _is_message(value) and fields(value) != _TIME:
                    if value != type(value)():  # the pose of a server that fills in only the distance
                        deeper.append((f"{path}{name}.", value))
                elif text := _text(value):
                    yield f"{path}{name} {text}"
        level = deeper


def _is_message(value: Any) -> bool:
    return hasattr(value, "get_fields_and_field_types")


def _text(value: Any) -> str:
    """Return a value in a few characters; empty when there is nothing to say."""
    match value:
        case bool():
            return str(value).lower()
        case int():
            return str(value)
        case float():
            return f"{round(value, 3):g}"
        case str():
            return " ".join(value.split())
        case bytes():
            return str(plain(value))
        case _ if _is_message(value):
            return f"{round(value.sec + value.nanosec * 1e-9, 1):g} s"
    if len(value) > ITEMS or (len(value) and _is_message(value[0])):
        return f"{len(value)} items"
    items = plain(value)
    return f"[{', '.join(map(_text, items))}]" if isinstance(items, list) and items else ""
