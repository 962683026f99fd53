"""A console for texts of any kind, and lines of events on it."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import IO, Any, Final
from uuid import UUID

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from pnm.errors import printable_lines
from pnm.tasks import TraceEvent, TraceKind

INDENT: Final = 9
"""Columns before what belongs to the line above."""


class SafeConsole(Console):
    """A console that neither fails when its reader has closed the pipe, nor prints control characters, nor takes texts for markup."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"markup": False, "highlight": False, "emoji": False, "soft_wrap": True, **options})

    @property
    def file(self) -> IO[str]:
        """The stream that is written: the one behind those that let no control characters through."""
        stream = super().file
        while hasattr(stream, "rich_proxied_file"):
            stream = stream.rich_proxied_file
        return stream

    @file.setter
    def file(self, new: IO[str]) -> None:
        self._file = new

    def on_broken_pipe(self) -> None:
        """Write to the null device from now on: whatever is running goes on undisturbed."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as it can be rendered, without control characters and without what UTF-8 cannot encode."""
        return super().render_str(printable_lines(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield printable text; control characters only where the console itself moves the cursor."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable_lines(segment.text))

    def print_text(self, text: str, head: str | Text = "") -> None:
        """Print a text behind its head: on a terminal in lines that are not too long, behind the head as well.

        Args:
            text: from anywhere.
            head: markup of ours, or a text.
        """
        whole = marked(head)
        indent = whole.cell_len
        lines = textwrap.wrap(text, max(20, self.width - indent), break_on_hyphens=False) if self.is_terminal else [text]
        first, *others = lines or [""]
        self.print(whole.append(first), *(" " * indent + line for line in others), sep="\n")

    def print_reason(self, head: str | Text, reason: str) -> None:
        """Print a reason behind its head, as `print_text` does: on a terminal each part on lines of its own that are not too long."""
        whole, lines = marked(head), [reason]
        if self.is_terminal:
            parts = re.split(r"(?<=;) ", reason)
            lines = [line for part in parts for line in textwrap.wrap(part, max(20, self.width - INDENT), break_on_hyphens=False)]
            if whole.cell_len >= INDENT:
                lines = ["", *lines]
        first, *others = lines or [""]
        whole.append(f" {first}").rstrip()
        self.print(whole, *(" " * INDENT + line for line in others), sep="\n")


def marked(head: str | Text) -> Text:
    """Return a text that is markup of ours as it is printed; one that is a `Text` as it is."""
    return Text.from_markup(head, emoji=False) if isinstance(head, str) else head


@dataclass
class EventLines:
    """Prints one line per event: the seconds since the beginning, a label, a word and a text.

    Args:
        began: the time from which seconds count; that of the first line when None. Mutable state.
    """

    console: SafeConsole
    began: float | None = None

    def print(self, now: float, word: str | Text, text: str, label: str = "") -> None:
        """Print a line; the word is markup of ours, or a `Text`. The label stands behind the time."""
        if self.began is None:
            self.began = now
        self.console.print_text(text, Text.assemble(f"  {now - self.began:8.2f} s  {label}", marked(word), " "))


@dataclass
class ToldFailures:
    """Has a failure told once: that of a call does not say again what its request has ended with.

    The mutable state is how the last requests have ended, by task and call.
    """

    ends: dict[tuple[UUID, str], str] = field(default_factory=dict)

    def words(self, event: TraceEvent) -> str:
        """Return the words for an event of a task."""
        task, subject, text = event.task, event.subject, event.text
        match event.kind:
            case TraceKind.ENDED:
                self.ends[task, subject] = text
            case TraceKind.FAILED if self.ends.pop((task, subject.rpartition("#")[0]), "") == text:
                text = "it is not tried again in this plan"
            case TraceKind.STATE if text.startswith("over"):
                self.ends = {key: end for key, end in self.ends.items() if key[0] != task}
        return ": ".join(filter(None, (subject, text)))
