"""A console for texts of any kind."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.text import Text

from pnm.files.text import printable

INDENT: Final = 9
"""Columns before what belongs to the line above."""


class SafeConsole(Console):
    """A console that neither fails when its reader has closed the pipe nor prints control characters."""

    def on_broken_pipe(self) -> None:
        """Write to the null device from now on: whatever is running goes on undisturbed."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts without control characters and without what UTF-8 cannot encode."""
        safe = ("\n".join(map(printable, part.split("\n"))) if isinstance(part, str) else part for part in objects)
        super().print(*safe, **options)

    def print_text(self, text: str, head: str = "") -> None:
        """Print a text behind its head, which may have markup: on a terminal in lines that are not too long, behind the head as well."""
        indent = Text.from_markup(head).cell_len
        lines = textwrap.wrap(text, max(20, self.width - indent), break_on_hyphens=False) if self.is_terminal else [text]
        first, *others = lines or [""]
        self.print(f"{head}{escape(first)}", *(" " * indent + escape(line) for line in others), sep="\n", highlight=False, soft_wrap=True)

    def print_reason(self, head: str, reason: str) -> None:
        """Print a reason behind its head, which may have markup: on a terminal each part on lines of its own that are not too long."""
        lines = [reason]
        if self.is_terminal:
            parts = re.split(r"(?<=;) ", reason)
            lines = [line for part in parts for line in textwrap.wrap(part, max(20, self.width - INDENT), break_on_hyphens=False)]
            if Text.from_markup(head).cell_len >= INDENT:
                lines = ["", *lines]
        first, *others = lines
        self.print(
            f"{head} {escape(first)}".rstrip(),
            *(" " * INDENT + escape(line) for line in others),
            sep="\n",
            highlight=False,
            soft_wrap=True,
        )
