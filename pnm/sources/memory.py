"""Global knowledge in the memory of this process: shared by its runs, gone with it."""

from __future__ import annotations

from pnm.queries import MISSING, Question
from pnm.sources.base import Asker
from pnm.sources.values import read_value, write_value


class MemoryKnowledge:
    """Variables by name, each kept as JSON so that nobody changes another's value.

    The mutable state is the variables.
    """

    def __init__(self) -> None:
        self._variables: dict[str, str] = {}

    def __repr__(self) -> str:
        return "<MemoryKnowledge>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the value, or `MISSING`."""
        found = self._variables.get(question.name)
        return MISSING if found is None else read_value(found)

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value; one that is set to None is forgotten."""
        self._variables[question.name] = write_value(value)
        if value is None:
            del self._variables[question.name]

    async def close(self) -> None:
        """Keep everything: there is nothing to let go of."""
