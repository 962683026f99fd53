"""The text of questions and messages for people, and the parsing of their answers; on a terminal as over ROS 2."""

from __future__ import annotations

import json
from typing import Final

from pnm.core.logic.computed_values import MISSING, Layer, Question, spoken
from pnm.knowledge.sources.memory import read_value
from pnm.knowledge.sources.source import SourceError

LIMIT: Final = 60.0
"""Time limit for a person's answer, in seconds."""
PSEUDO: Final = frozenset({"USER", "CONTROLLER"})
"""Names of people rather than variables, in files for the original implementation: the user and the operator of the robot."""
_WRITTEN: Final = ('"', "[", "{")
"""Beginnings of JSON texts, so that malformed JSON is not taken for an answer."""
_SHOWN: Final = 40
"""Characters of a wrong answer that are repeated."""


def is_for_people(question: Question) -> bool:
    """Return whether the question is for a person rather than a knowledge base."""
    return question.layer is Layer.PERSON or (question.layer is not Layer.LOCAL and question.name in PSEUDO)


def question_text(question: Question) -> str:
    """Return the wording of a question: its meta data, alone or under ``text``; otherwise one made from the name."""
    if wording := _wording(question.meta):
        return wording
    return "What do you say?" if question.name in PSEUDO else f"What is {question.name}?"


def message_text(question: Question, value: object) -> str:
    """Return the text of a message to a person."""
    shown = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    about = _wording(question.meta) or ("" if question.name in PSEUDO else question.name)
    return f"{about}: {shown}" if about else shown


def read_answer(text: str, question: Question) -> object:
    """Return the value of an answer, by whichever way it came: that one of the question's ``answers`` which is said, if it names any.

    Otherwise JSON, or else the text as it stands; an empty text is `MISSING`. Raises `SourceError` for malformed JSON,
    and for what is none of the answers.

    >>> open, closed = Question("go", Layer.PERSON, ""), Question("go", Layer.PERSON, '{"answers": ["yes", "no", 3]}')
    >>> [read_answer(text, open) for text in ("kitchen", "5", '"5"', "true", "No.")]
    ['kitchen', 5, '5', True, 'No.']
    >>> [read_answer(text, closed) for text in ("No.", " YES", "3")]
    ['no', 'yes', 3]
    """
    text = text.strip()
    if not text:
        return MISSING
    data = _meta(question.meta)
    expected = data.get("answers") if isinstance(data, dict) else None
    if isinstance(expected, list):
        for answer in expected:
            if spoken(text) == spoken(answer if isinstance(answer, str) else json.dumps(answer)):
                return answer
        raise SourceError(f"expected {' or '.join(map(str, expected))}, found {text[:_SHOWN]!r}")
    try:
        return read_value(text)
    except SourceError:
        if text.startswith(_WRITTEN):
            raise
        return text


def _wording(meta: str) -> str:
    data = _meta(meta)
    text = data.get("text") if isinstance(data, dict) else data
    return text.strip() if isinstance(text, str) else ""


def _meta(meta: str) -> object:
    """Return the meta data of a question, which is JSON or a text."""
    try:
        return json.loads(meta) if meta else None
    except ValueError:
        return meta
