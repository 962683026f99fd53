"""What somebody may have meant who has written a name that is not there."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches


def meant(name: str, known: Collection[str]) -> str:
    """Return a question about the nearest of the known names, or nothing when none is near; of equally near ones, the first."""
    near = get_close_matches(name, known, 1)
    return f"did you mean {near[0]!r}?" if near else ""
