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
