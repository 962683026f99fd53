"""How the built-in sources are made from the options in a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pnm.errors import InputError
from pnm.nearest import meant
from pnm.sources import people
from pnm.sources.base import Source
from pnm.sources.memory import MemoryKnowledge
from pnm.sources.registry import Choice, Surroundings, make_source
from pnm.sources.sqlite import SqliteKnowledge
from pnm.sources.terminal import Terminal, is_terminal


def memory(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make knowledge that lasts as long as the process; it has no options."""
    only(options)
    return MemoryKnowledge()


def sqlite(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make knowledge in a ``file``; the user's own when none is named."""
    only(options, "file")
    file = text(options, "file", "")
    return SqliteKnowledge(surroundings.folder / Path(file).expanduser() if file else None)


def terminal(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make a person at the terminal, who has so many seconds (``limit``) for an answer."""
    only(options, "limit")
    return Terminal(limit=seconds(options, "limit", people.LIMIT))


def person(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make a person at the terminal if there is one, or no ROS 2; otherwise one behind topics. Options are theirs."""
    found = "terminal" if is_terminal() or surroundings.ros is None else "topics"
    return make_source(Choice(found, options), surroundings)


# --- options -------------------------------------------------------------------------------


def only(options: Mapping[str, object], *known: str) -> None:
    """Refuse every option but the known ones, naming the nearest.

    Raises:
        InputError: there is another.
    """
    for name in options:
        if name not in known:
            hint = meant(str(name), known) or (f"expected {', '.join(known)}" if known else "it has no options")
            raise InputError(f"unknown option {name!r}; {hint}")


def text(options: Mapping[str, object], name: str, default: str) -> str:
    """Return an option that is a text.

    Raises:
        InputError: it is something else.
    """
    value = options.get(name, default)
    if not isinstance(value, str):
        raise InputError(f"expected a text for {name}, found {value!r}")
    return value


def seconds(options: Mapping[str, object], name: str, default: float) -> float:
    """Return an option that is a number above 0.

    Raises:
        InputError: it is something else.
    """
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"expected a number of seconds for {name}, found {value!r}")
    return float(value)
