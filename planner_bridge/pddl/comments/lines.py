"""Lines of text with comments beside them, aligned where that looks well."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

_FAR: Final = 64
"""Comments beside lines that are longer are not aligned with the others."""


@dataclass(slots=True)
class Line:
    """A line: the mutable state is what it says, to which its writer may still add something."""

    indent: int
    text: str
    """Empty for an empty line."""
    beside: Sequence[str] = ()
    """Comments: all but the first stand on lines of their own below that one."""

    @property
    def code(self) -> str:
        """The line without its comments."""
        return " " * self.indent + self.text


def rendered(lines: Iterable[Line], said: Callable[[str], str] = str) -> str:
    """Return the text; `said` turns a comment into one of the format."""
    return "".join(
        _with_comments(line, column, said)
        for _, group in groupby(lines, key=lambda line: line.indent)
        for run in (list(group),)
        for column in (_column(run),)
        for line in run
    )


def _column(lines: list[Line]) -> int:
    """Return where comments beside neighbouring lines begin."""
    return max((length for line in lines if line.beside and (length := len(line.code)) <= _FAR), default=0) + 2


def _with_comments(line: Line, column: int, said: Callable[[str], str]) -> str:
    if not line.beside:
        return f"{line.code if line.text else ''}\n"
    code = line.code.ljust(column - 2)
    below = f"\n{' ' * len(code)}  "
    return f"{code}  {below.join(map(said, line.beside))}\n"
