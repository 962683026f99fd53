"""Where answers come from that a run does not have itself: the knowledge all runs share, and people.

`Sources` sends every question to the right one; `open_sources` makes it from the names that a file chose, which
`register_source` adds to. None of the sources ever blocks the event loop, and every wait has a limit.
"""

from pnm.knowledge.sources.registry import SourceChoice, Surroundings, check_source, open_sources, register_source, source_names
from pnm.knowledge.sources.router import Sources
from pnm.knowledge.sources.source import Asker, Source, SourceError

__all__ = [
    "Asker",
    "Source",
    "SourceChoice",
    "SourceError",
    "Sources",
    "Surroundings",
    "check_source",
    "open_sources",
    "register_source",
    "source_names",
]
