"""Standard output and standard error without control characters, whoever writes: our commands, libraries, tracebacks, warnings of logs."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TextIO, cast

from pnm.errors import printable_lines


class SafeStream:
    """A stream of lines, each of them printable. A terminal's library writes its own control sequences past it.

    Args:
        rich_proxied_file: the stream behind it; named as `rich` looks for it.
    """

    def __init__(self, rich_proxied_file: TextIO) -> None:
        self.rich_proxied_file = rich_proxied_file

    def write(self, text: str) -> int:
        """Write a text as it may be shown; return its length."""
        self.rich_proxied_file.write(printable_lines(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def make_streams_safe() -> None:
    """Have everything that this process writes to its standard streams be safe; to be called once, at its beginning."""
    sys.stdout = cast(TextIO, SafeStream(sys.stdout))
    sys.stderr = cast(TextIO, SafeStream(sys.stderr))
