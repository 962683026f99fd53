"""What commands say on stderr: warnings about files, and what is being waited for."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from planner_bridge.pipeline.loading import warning_lines
from pnm.errors import Tolerated

if TYPE_CHECKING:
    from rich.console import Console


def searching(planner: str, limit: float) -> AbstractContextManager[object]:
    """Return what shows on stderr, while it is entered, that a planner is being asked; see `waiting`."""
    return waiting(planner_words(planner, limit)) if sys.stderr.isatty() else nullcontext()


def planner_words(planner: str, limit: float) -> str:
    """Return what is being waited for while a planner is asked."""
    return f"{planner} is looking for a plan, {limit:g} s at most"


def waiting(text: str, console: Console | None = None) -> AbstractContextManager[object]:
    """Return what shows, while it is entered, what is being waited for with its limit, and for how long already; on terminals only.

    Args:
        text: what is waited for, with its limit.
        console: that of the output; by default stderr.
    """
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from planner_bridge.cli.consoles.safe_console import SafeConsole  # here, because most commands have no use for it

    console = console or SafeConsole(stderr=True)
    if not console.is_terminal:
        return nullcontext()
    progress = Progress(
        SpinnerColumn(), TextColumn("{task.description}:", markup=False), TimeElapsedColumn(), console=console, transient=True
    )
    progress.add_task(text)
    return progress


def print_warnings(warnings: Iterable[Tolerated]) -> None:
    """Print warnings about files on stderr."""
    for line in warning_lines(warnings):
        print(line, file=sys.stderr)
