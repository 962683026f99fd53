"""Comments of a file, kept beside the model: a table from the places of things to what is said about them.

Models know no comments and no positions. So each file that is read gives a table besides its model, and who
writes a file asks the table about every thing that is written. A *path* names a thing by what it says, whatever
the format: ``("domain", "action", "move", "condition", "(at ?r ?from)")``. What was said about something that
is not written goes to the nearest thing around it, so that no comment is lost.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

Path: TypeAlias = tuple[str, ...]

BLANK: Final = ""
"""Stands among comments for an empty line."""


@dataclass(frozen=True, slots=True)
class Note:
    """The comments on one thing, each beginning with one mark or several, as in PDDL."""

    before: tuple[str, ...] = ()
    """On lines of their own above it."""
    beside: tuple[str, ...] = ()
    """On the line it begins in, and on lines that go on with that."""
    below: tuple[str, ...] = ()
    """On lines of their own under it, where nothing else follows."""

    def __bool__(self) -> bool:
        return bool(self.before or self.beside or self.below)

    def joined(self, other: Note) -> Note:
        """Return both."""
        return Note(self.before + other.before, self.beside + other.beside, self.below + other.below)


NO_NOTE: Final = Note()
Table: TypeAlias = Mapping[Path, Note]


@dataclass(slots=True)
class _Ledger:
    """Who has been asked about. The mutable state is what is still to be told, and every path that was asked for."""

    table: dict[Path, Note]
    around: frozenset[Path]
    """The paths of all notes and of what is around them."""
    asked: set[Path] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class Notes:
    """The table, looked at from a path; every note is told once."""

    _ledger: _Ledger
    path: Path = ()

    @staticmethod
    def of(table: Table) -> Notes:
        """Return the table, looked at from outside."""
        return Notes(_Ledger(dict(table), frozenset(path[:length] for path in table for length in range(len(path) + 1))))

    def at(self, *keys: str) -> Notes:
        """Look from inside a thing."""
        return Notes(self._ledger, self.path + keys) if self._ledger.around else self

    def take(self) -> Note:
        """Return what is said about the thing here, and never again."""
        if not self._ledger.table:
            return NO_NOTE
        self._ledger.asked.add(self.path)
        return self._ledger.table.pop(self.path, NO_NOTE)

    def __bool__(self) -> bool:
        """Whether something is said about the thing or what is in it."""
        return self.path in self._ledger.around

    def left(self) -> dict[Path, Note]:
        """Return the notes that nobody took."""
        return dict(self._ledger.table)

    def nearest(self, path: Path) -> Path:
        """Return the innermost thing around the path that was asked about."""
        while path and path not in self._ledger.asked:
            path = path[:-1]
        return path


NO_NOTES: Final = Notes.of({})


def with_all(table: Table, write: Callable[[Notes], str]) -> str:
    """Write a text with all notes: those about things that are not written go to what is around these.

    Args:
        table: the notes.
        write: writes the text, and takes the notes it writes; the one about the empty path, too.
    """
    notes = Notes.of(table)
    text = write(notes)
    left = notes.left()
    if not left:
        return text
    moved = {path: note for path, note in table.items() if path not in left}
    for path, note in left.items():
        near = notes.nearest(path)
        every = Note(note.before + note.beside + note.below)
        moved[near] = moved.get(near, NO_NOTE).joined(every)
    return write(Notes.of(moved))


# --- which comment belongs to which thing --------------------------------------------------


@dataclass(frozen=True, slots=True)
class Item:
    """A thing in a file."""

    path: Path
    start: int
    """The offset of its first character."""
    end: int
    """The offset behind its last character."""
    opaque: bool = False
    """Whether comments in it are part of it."""


@dataclass(frozen=True, slots=True)
class Remark:
    """A comment in a file, with its mark."""

    text: str
    offset: int


@dataclass(frozen=True, slots=True)
class Lines:
    """Where the lines of a text begin."""

    text: str
    starts: tuple[int, ...]

    @staticmethod
    def of(text: str) -> Lines:
        """Find the lines."""
        return Lines(text, (0, *(found.end() for found in re.finditer(r"\r\n?|\n", text))))

    def number(self, offset: int) -> int:
        """Return the number of the line, from 0."""
        return bisect_right(self.starts, offset) - 1

    def start(self, offset: int) -> int:
        """Return the offset at which the line begins."""
        return self.starts[self.number(offset)]

    def column(self, offset: int) -> int:
        """Return the column, from 0."""
        return offset - self.start(offset)

    def indent(self, offset: int) -> int:
        """Return the column of the first thing in the line."""
        start = self.start(offset)
        return len(self.text[start:offset]) - len(self.text[start:offset].lstrip())

    def is_blank(self, number: int) -> bool:
        """Tell whether there is such a line, and nothing in it."""
        if number + 1 >= len(self.starts):
            return False
        return not self.text[self.starts[number] : self.starts[number + 1]].strip()


Below: TypeAlias = Callable[[Remark, Item | None, Item | None], Path | None]
"""Given a comment on a line of its own, the last thing that begins before it and the first that begins after it:
the thing it stands under; None if it belongs to what follows."""


def attached(remarks: Iterable[Remark], items: Sequence[Item], lines: Lines, below: Below) -> dict[Path, Note]:
    """Return the notes for the comments, which are in the order of the file; the things are in any order."""
    items = sorted(items, key=lambda item: item.start)
    starts = [item.start for item in items]
    table: dict[Path, Note] = {}
    beside: tuple[Path, int, int] | None = None
    for remark in remarks:
        following = bisect_left(starts, remark.offset)
        last = items[following - 1] if following else None
        after = items[following] if following < len(items) else None
        number, column = lines.number(remark.offset), lines.column(remark.offset)
        if last and last.start >= lines.start(remark.offset):
            path, note = last.path, Note(beside=(remark.text,))
            beside = path, number, column
        elif beside and beside[1:] == (number - 1, column):
            path, note = beside[0], Note(beside=(remark.text,))
            beside = path, number, column
        else:
            under = below(remark, last, after)
            if under is not None:
                gap = lines.is_blank(number - 1) and bool(table.get(under, NO_NOTE).below)
                path, note = under, Note(below=(BLANK, remark.text) if gap else (remark.text,))
            else:
                gap = lines.is_blank(number + 1)
                path, note = (after or items[-1]).path, Note(before=(remark.text, BLANK) if gap else (remark.text,))
        table[path] = table.get(path, NO_NOTE).joined(note)
    return table
