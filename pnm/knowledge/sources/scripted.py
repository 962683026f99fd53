"""Answers that were given beforehand, in place of a person's: for rehearsals, and where nobody is there to ask."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from pnm.core.logic.computed_values import Question
from pnm.knowledge.sources.person_text import read_answer
from pnm.knowledge.sources.source import Asker, Source

_log = logging.getLogger(__name__)


class ScriptedAnswers:
    """Answers to questions by their names; what has none here goes to another source.

    Several answers of a name are given in turn, and the last of them from then on. The mutable state is those that are left,
    and the names that nobody has asked for yet, which are logged at the end.

    Args:
        answers: names and values, in the order in which they are given; texts are read as those that people write.
        otherwise: the source of people.
    """

    def __init__(self, answers: Iterable[tuple[str, object]], otherwise: Source) -> None:
        self._otherwise = otherwise
        self._left: dict[str, list[object]] = {}
        for name, value in answers:
            self._left.setdefault(name, []).append(value)
        self._unused = dict.fromkeys(self._left)

    def __repr__(self) -> str:
        return f"<ScriptedAnswers {', '.join(self._left)}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the next answer of this name; ask the other source if there is none."""
        answers = self._left.get(question.name)
        if not answers:
            return await self._otherwise.query(question, asker)
        self._unused.pop(question.name, None)
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        return read_answer(answer, question) if isinstance(answer, str) else answer

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Have the other source show the value."""
        await self._otherwise.update(question, value, asker)

    async def close(self) -> None:
        """Close the other source; log the names of answers that were not used."""
        if self._unused:
            _log.warning("nobody has asked for %s, to which there was an answer", " or ".join(self._unused))
        await self._otherwise.close()
