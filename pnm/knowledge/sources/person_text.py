"""What people are shown, and what is made of what they say; the same on a terminal and over ROS 2."""

from __future__ import annotations

import json
from typing import Final

from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.sources.memory import read_value
from pnm.knowledge.sources.source import SourceError

LIMIT: Final = 60.0
"""Seconds a person has for an answer."""
PSEUDO: Final = frozenset({"USER", "CONTROLLER"})
"""Names that are no variables but people, in files that come from the original implementation: whoever uses the robot or runs it."""
_WRITTEN: Final = ('"', "[", "{")
"""How texts begin that are meant to be JSON, so that a slip of the pen is not taken for an answer."""


def is_for_people(question: Question) -> bool:
    """Tell whether a person is asked or told, in place of a knowledge base."""
    return question.layer is Layer.PERSON or (question.layer is not Layer.LOCAL and question.name in PSEUDO)


def question_text(question: Question) -> str:
    """Return the question in words: what its meta data say, alone or under ``text``; otherwise one made from the name."""
    said = _said(question.meta)
    if said:
        return said
    return "What do you say?" if question.name in PSEUDO else f"What is {question.name}?"


def message_text(question: Question, value: object) -> str:
    """Return what a person is told, in words."""
    shown = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    about = _said(question.meta) or ("" if question.name in PSEUDO else question.name)
    return f"{about}: {shown}" if about else shown


def read_answer(text: str) -> object:
    """Return the value of what a person wrote: JSON, or else the text as it stands.

    Raises:
        SourceError: it begins as a JSON text, list or mapping does but is none.

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


def printable(text: str) -> str:
    """Return the text without what could make a terminal do something: texts come from files and from other machines."""
    return "".join(letter if letter.isprintable() else " " if letter.isspace() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def _said(meta: str) -> str:
    try:
        found = json.loads(meta) if meta else None
    except ValueError:
        return meta
    if isinstance(found, dict):
        found = found.get("text")
    return found.strip() if isinstance(found, str) else ""
