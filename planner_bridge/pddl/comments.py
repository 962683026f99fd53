"""Comments of a file, kept beside the model: a table from anchors, which name things, to the comments on them.

Models hold no comments and no positions. So each file that is read gives a table besides its model, and a
writer asks the table about every thing that it writes. An *anchor path* names a thing by its content, whatever
the format: ``("domain", "action", "move", "condition", "(at ?r ?from)")``. A comment on something that is not
written goes to the nearest thing around it, so that no comment is lost.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Final, NamedTuple, TypeAlias

AnchorPath: TypeAlias = tuple[str, ...]

BLANK: Final = ""
"""An empty line among comments."""


class Note(NamedTuple):
    """The comments on one thing, each beginning with one mark or several, as in PDDL."""

    before: tuple[str, ...] = ()
    """On lines of their own above it."""
    beside: tuple[str, ...] = ()
    """On the line it begins in, and continued on the lines below."""
    below: tuple[str, ...] = ()
    """On lines of their own under it, at the end of the thing around it."""

    def __bool__(self) -> bool:
        return bool(self.before or self.beside or self.below)

    def joined(self, other: Note) -> Note:
        """Return the comments of both."""
        return Note(self.before + other.before, self.beside + other.beside, self.below + other.below)


NO_NOTE: Final = Note()
CommentTable: TypeAlias = Mapping[AnchorPath, Note]
NO_COMMENTS: Final[CommentTable] = {}


@dataclass(slots=True)
class _NoteStore:
    """Notes that are to be written. The mutable state is the notes left, and every path that was asked for."""

    notes: dict[AnchorPath, Note]
    around: frozenset[AnchorPath]
    """The paths of all notes and of the things around them."""
    asked: set[AnchorPath] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class Notes:
    """A view of the comment table from one path; every note can be taken once."""

    store: _NoteStore
    path: AnchorPath = ()

    @staticmethod
    def of(table: CommentTable) -> Notes:
        """Return the view of the table from the empty path."""
        return Notes(_NoteStore(dict(table), frozenset(path[:length] for path in table for length in range(len(path) + 1))))

    def at(self, *keys: str) -> Notes:
        """Return the view from a thing inside this one."""
        return Notes(self.store, self.path + keys) if self.store.around else self

    def take(self) -> Note:
        """Remove the note on this thing from the table, and return it."""
        if not self.store.notes:
            return NO_NOTE
        self.store.asked.add(self.path)
        return self.store.notes.pop(self.path, NO_NOTE)

    def __bool__(self) -> bool:
        """Whether there are notes on the thing or on something in it."""
        return self.path in self.store.around


NO_NOTES: Final = Notes.of({})


def write_with_notes(table: CommentTable, write: Callable[[Notes], str]) -> str:
    """Write a text with all notes: `write` takes those that it writes, also that on the empty path; others go to the thing around."""
    notes = Notes.of(table)
    text = write(notes)
    remaining = notes.store.notes
    if not remaining:
        return text
    moved = {path: note for path, note in table.items() if path not in remaining}
    for path, note in remaining.items():
        near = path
        while near and near not in notes.store.asked:
            near = near[:-1]
        moved[near] = moved.get(near, NO_NOTE).joined(Note(note.before + note.beside + note.below))
    return write(Notes.of(moved))


class Anchor(NamedTuple):
    """A thing in a file that comments can be about."""

    path: AnchorPath
    start: int
    """The offset of its first character."""
    end: int
    """The offset behind its last character."""
    opaque: bool = False
    """Whether comments in it are part of it."""


class Comment(NamedTuple):
    """A comment in a file, with its mark."""

    text: str
    offset: int


class LineIndex(NamedTuple):
    """The offsets at which the lines of a text begin."""

    text: str
    starts: tuple[int, ...]

    @staticmethod
    def of(text: str) -> LineIndex:
        """Return the index of a text."""
        return LineIndex(text, (0, *(match.end() for match in re.finditer(r"\r\n?|\n", text))))

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
        """Return the column of the first character in the line that is no space."""
        start = self.start(offset)
        return len(self.text[start:offset]) - len(self.text[start:offset].lstrip())

    def is_blank(self, number: int) -> bool:
        """Whether there is such a line, and it is blank."""
        if number + 1 >= len(self.starts):
            return False
        return not self.text[self.starts[number] : self.starts[number + 1]].strip()


OwnerAbove: TypeAlias = Callable[[Comment, Anchor | None, Anchor | None], AnchorPath | None]
"""For a comment on a line of its own, the last anchor that begins before it and the first that begins after it:
the path of the thing it stands under; None if it belongs to the following one."""


def attach(comments: Iterable[Comment], anchors: Sequence[Anchor], lines: LineIndex, owner_above: OwnerAbove) -> dict[AnchorPath, Note]:
    """Return the comment table of a file; the comments are in the order of the file, the anchors in any order."""
    anchors = sorted(anchors, key=lambda anchor: anchor.start)
    starts = [anchor.start for anchor in anchors]
    table: dict[AnchorPath, Note] = {}
    beside: tuple[AnchorPath, int, int] | None = None
    for comment in comments:
        index = bisect_left(starts, comment.offset)
        last = anchors[index - 1] if index else None
        following = anchors[index] if index < len(anchors) else None
        number, column = lines.number(comment.offset), lines.column(comment.offset)
        # beside a thing; below such a comment, in its column; under a thing; or above the following one
        if last and last.start >= lines.start(comment.offset):
            path, note = last.path, Note(beside=(comment.text,))
            beside = path, number, column
        elif beside and beside[1:] == (number - 1, column):
            path, note = beside[0], Note(beside=(comment.text,))
            beside = path, number, column
        else:
            under = owner_above(comment, last, following)
            if under is not None:
                gap = lines.is_blank(number - 1) and bool(table.get(under, NO_NOTE).below)
                path, note = under, Note(below=(BLANK, comment.text) if gap else (comment.text,))
            else:
                gap = lines.is_blank(number + 1)
                path, note = (following or anchors[-1]).path, Note(before=(comment.text, BLANK) if gap else (comment.text,))
        table[path] = table.get(path, NO_NOTE).joined(note)
    return table


_FAR: Final = 64
"""Comments beside lines that are longer than this are not aligned with the others."""


@dataclass(slots=True)
class Line:
    """A line of text with the comments beside it. The mutable state is its text, which its writer may extend."""

    indent: int
    text: str
    """Empty for an empty line."""
    beside: Sequence[str] = ()
    """Comments: all but the first stand on lines of their own below that one."""

    @property
    def code(self) -> str:
        """The line without its comments."""
        return " " * self.indent + self.text


def render_lines(lines: Iterable[Line], format_comment: Callable[[str], str] = str) -> str:
    """Return the text; `format_comment` turns a comment into one of the file's format."""
    parts: list[str] = []
    for _, group in groupby(lines, key=lambda line: line.indent):
        neighbours = list(group)
        width = max((length for line in neighbours if line.beside and (length := len(line.code)) <= _FAR), default=0)
        for line in neighbours:
            if not line.beside:
                parts.append(f"{line.code if line.text else ''}\n")
                continue
            code = line.code.ljust(width)
            below = f"\n{' ' * len(code)}  "
            parts.append(f"{code}  {below.join(map(format_comment, line.beside))}\n")
    return "".join(parts)
