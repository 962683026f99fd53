"""The text of questions and messages for people, and the parsing of their answers; on a terminal as over ROS 2."""

from __future__ import annotations

import json
from typing import Final

from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.sources.memory import read_value
from pnm.knowledge.sources.source import SourceError

LIMIT: Final = 60.0
"""Time limit for a person's answer, in seconds."""
PSEUDO: Final = frozenset({"USER", "CONTROLLER"})
"""Names of people rather than variables, in files for the original implementation: the user and the operator of the robot."""
_WRITTEN: Final = ('"', "[", "{")
"""Beginnings of JSON texts, so that malformed JSON is not taken for an answer."""


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


def read_answer(text: str) -> object:
    """Return the value of an answer: JSON, or else the text as it stands; malformed JSON raises `SourceError`.

    >>> read_answer("kitchen"), read_answer("5"), read_answer('"5"'), read_answer("true")
    ('kitchen', 5, '5', True)
    """
    text = text.strip()
    try:
        return read_value(text)
    except SourceError:
        if text.startswith(_WRITTEN):
            raise
        return text


def _wording(meta: str) -> str:
    try:
        data = json.loads(meta) if meta else None
    except ValueError:
        return meta
    text = data.get("text") if isinstance(data, dict) else data
    return text.strip() if isinstance(text, str) else ""
