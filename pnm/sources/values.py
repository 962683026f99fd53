"""Values on their way out of the process and back: JSON, bounded."""

from __future__ import annotations

import json
from typing import Final

from pnm.operators import MAX_SIZE
from pnm.sources.base import SourceError

_SHOWN: Final = 60


def write_value(value: object) -> str:
    """Return the value as JSON text, all of it ASCII.

    Raises:
        SourceError: JSON cannot say it (there is no NaN), or it is too large.
    """
    try:
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise SourceError(f"JSON cannot say {_short(repr(value))}: {error}") from error
    if len(text) > MAX_SIZE:
        raise SourceError(f"{_short(text)} has {len(text)} characters as JSON; at most {MAX_SIZE} can be stored")
    return text


def read_value(text: str) -> object:
    """Return the value that a JSON text says.

    Raises:
        SourceError: it is not JSON, or too large.
    """
    if len(text) > MAX_SIZE:
        raise SourceError(f"{_short(text)} has {len(text)} characters; expected at most {MAX_SIZE}")
    try:
        return json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{_short(text)!r} is not JSON: {error}") from error


def _refuse(name: str) -> object:
    raise ValueError(f"JSON has no {name}")


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
