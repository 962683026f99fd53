"""Lines of events, and failures that are told once."""

from __future__ import annotations

from dataclasses import dataclass, field
from uuid import UUID

from rich.text import Text

from planner_bridge.cli.consoles.safe_console import SafeConsole, marked
from pnm.tasks import TraceKind


@dataclass
class EventLines:
    """Prints one line per event: the seconds since the beginning, a label, a word and a text.

    Args:
        label: what every line has after the time.
        began: the time from which seconds count; that of the first line when None. Mutable state.
    """

    console: SafeConsole
    label: str = ""
    began: float | None = None

    def print(self, now: float, word: str | Text, text: str) -> None:
        """Print a line; the word is markup of ours, or a `Text`."""
        if self.began is None:
            self.began = now
        self.console.print_text(text, Text.assemble(f"  {now - self.began:8.2f} s  {self.label}", marked(word), " "))


@dataclass
class ToldFailures:
    """Has a failure told once: that of a call does not say again what its request has ended with.

    The mutable state is how the last requests have ended, by task and call.
    """

    ends: dict[tuple[UUID, str], str] = field(default_factory=dict)

    def text(self, task: UUID, kind: int, subject: str, text: str) -> str:
        """Return what is to be said of an event of a task, behind its subject."""
        match kind:
            case TraceKind.ENDED:
                self.ends[task, subject] = text
            case TraceKind.FAILED if self.ends.pop((task, subject.rpartition("#")[0]), "") == text:
                return "it is not tried again in this plan"
            case TraceKind.STATE if text.startswith("over"):
                self.ends = {key: end for key, end in self.ends.items() if key[0] != task}
        return text
