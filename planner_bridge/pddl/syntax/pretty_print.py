"""Pretty printer: nested lists of words as text. A list that fits is one line, any other has a line for each of its parts.

Comments stand above their part, or behind the line it begins in.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Final, TypeAlias

from planner_bridge.pddl.comments.lines import Line, render_lines
from planner_bridge.pddl.comments.table import NO_NOTE, Note


@dataclass(frozen=True, slots=True)
class Noted:
    """A form with comments."""

    form: Form
    note: Note


@dataclass(frozen=True, slots=True)
class Keyed:
    """A keyword and its form."""

    key: str
    form: Form


@dataclass(frozen=True, slots=True)
class Verbatim:
    """A text of several lines that is written as it stands."""

    text: str


Form: TypeAlias = "str | list[Form] | Noted | Keyed | Verbatim"
WIDTH: Final = 100
_ONE_A_LINE: Final = (":types", ":constants", ":objects", ":predicates", ":functions", ":init")


def noted(form: Form, note: Note) -> Form:
    """Return the form with the comments, if there are any."""
    return Noted(form, note) if note else form


def definition_text(head: Form, sections: Iterable[Form], note: Note = NO_NOTE) -> str:
    """Write ``(define HEAD SECTION ...)`` with each section on lines of its own."""
    first = Line(0, f"(define {flat(head)}", note.beside)
    lines = [first, *(line for section in sections for line in _lines(section, 2))]
    _close(lines, 0)
    return render_lines([*_comments(note.before, 0), *lines, *_comments(note.below, 0)])


def flat(form: Form) -> str:
    """Write a form on one line, without comments."""
    match form:
        case list():
            return f"({' '.join([part if isinstance(part, str) else flat(part) for part in form])})"
        case Noted(inner, _):
            return flat(inner)
        case Keyed(key, inner):
            return f"{key} {flat(inner)}"
        case Verbatim(text):
            return text
        case _:
            return form


def _comments(texts: Iterable[str], indent: int) -> Iterator[Line]:
    return (Line(indent, text) for text in texts)


def _lines(form: Form, indent: int, lead: str = "") -> list[Line]:
    """Write a form that begins in this column, behind a keyword if there is one."""
    match form:
        case Noted(inner, note):
            lines = _lines(inner, indent, lead)
            first = next(line for line in lines if line.text[:1] not in ("", ";"))
            first.beside = (*note.beside, *first.beside)
            return [*_comments(note.before, indent), *lines, *_comments(note.below, indent)]
        case Keyed(key, inner):
            return _lines(inner, indent, f"{key} ")
        case list():
            is_tall = len(form) > 1 if form and form[0] in _ONE_A_LINE else any(map(_is_tall, form))
            text = "" if is_tall else lead + flat(form)
            if not is_tall and indent + len(text) <= WIDTH:
                return [Line(indent, text)]
            words = 1 if form[0] in _ONE_A_LINE else sum(1 for _ in takewhile(lambda part: isinstance(part, str), form))
            opening = f"{lead}({' '.join(map(flat, form[:words]))}"
            lines = [Line(indent, opening), *(line for part in form[words:] for line in _lines(part, indent + 2))]
            _close(lines, indent)
            return lines
        case _:
            return [Line(indent, lead + flat(form))]


def _is_tall(form: Form) -> bool:
    """Whether the form needs lines of its own: it is an action's part, or has comments."""
    return not isinstance(form, str) and (not isinstance(form, list) or any(map(_is_tall, form)))


def _close(lines: list[Line], indent: int) -> None:
    if lines[-1].text[:1] in ("", ";"):
        lines.append(Line(indent, ")"))
    else:
        lines[-1].text += ")"
