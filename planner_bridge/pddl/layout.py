"""Nested lists of words as text for people: a list that fits is one line, any other has a line for each of its parts."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import takewhile
from typing import Final, TypeAlias

Form: TypeAlias = "str | list[Form]"
_WIDTH: Final = 100
_ONE_A_LINE: Final = (":types", ":constants", ":objects", ":predicates", ":functions", ":init")


def definition_text(head: Form, sections: Iterable[str]) -> str:
    """Write ``(define HEAD SECTION ...)`` with each section on lines of its own."""
    return "\n  ".join([f"(define {flat(head)}", *sections]) + ")\n"


def section_text(form: list[Form]) -> str:
    """Write a section; of declarations and facts, each on a line of its own."""
    return _broken(form, 2, 1) if form[0] in _ONE_A_LINE else form_text(form, 2)


def form_text(form: Form, indent: int, before: int = 0) -> str:
    """Write a form that begins in this column, or so many characters behind it."""
    one_line = flat(form)
    if isinstance(form, str) or indent + before + len(one_line) <= _WIDTH:
        return one_line
    return _broken(form, indent, sum(1 for _ in takewhile(lambda part: isinstance(part, str), form)))


def flat(form: Form) -> str:
    """Write a form on one line."""
    return form if isinstance(form, str) else f"({' '.join(map(flat, form))})"


def _broken(form: list[Form], indent: int, words: int) -> str:
    """Write the first words on this line and each other part on a line of its own."""
    first = " ".join(map(flat, form[:words]))
    return "(" + f"\n{' ' * (indent + 2)}".join([first, *(form_text(part, indent + 2) for part in form[words:])]) + ")"
