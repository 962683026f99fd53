"""Lines of text with comments beside them, aligned in a column where the lines are short."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

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
    return "".join(
        _with_comments(line, column, format_comment)
        for _, group in groupby(lines, key=lambda line: line.indent)
        for run in (list(group),)
        for column in (_comment_column(run),)
        for line in run
    )


def _comment_column(lines: list[Line]) -> int:
    """Return the column at which comments beside neighbouring lines begin."""
    return max((length for line in lines if line.beside and (length := len(line.code)) <= _FAR), default=0) + 2


def _with_comments(line: Line, column: int, format_comment: Callable[[str], str]) -> str:
    if not line.beside:
        return f"{line.code if line.text else ''}\n"
    code = line.code.ljust(column - 2)
    below = f"\n{' ' * len(code)}  "
    return f"{code}  {below.join(map(format_comment, line.beside))}\n"
