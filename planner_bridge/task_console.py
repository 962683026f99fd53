"""What a person sees in the terminal of many tasks at once: a line per moment, with the beginning of the task's id."""

from __future__ import annotations

import asyncio
import json
from typing import Final
from uuid import UUID

from planner_bridge.console import ConsoleObserver, Terminal
from pnm.tasking import Code, Moment, Status, TaskEnding, TaskListener, Tasks

_SHOWN: Final = 200
"""Characters of a goal, of parameters or of results that a line shows."""


class TaskConsole(TaskListener):
    """Prints what happens to tasks. The mutable state is a printer for every task that goes on."""

    def __init__(self, terminal: Terminal, tasks: Tasks) -> None:
        self._terminal = terminal
        self._tasks = tasks
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._lines: dict[UUID, ConsoleObserver] = {}

    def changed(self, task: UUID) -> None:
        """Print the goal of a task that is new."""
        self._lines_of(task)

    def happened(self, moment: Moment) -> None:
        """Print an event, but not every transition that fires."""
        if moment.kind != "fired" and not moment.text.startswith("over: "):  # how it has ended comes next
            said = ": ".join(filter(None, (moment.subject, moment.text)))
            self._line(moment.task, moment.time, f"{moment.kind:<7}", shortened(said))

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Print how a task ended."""
        word = "[bold green]reached[/]" if ending.code is Code.GOAL_REACHED else f"[bold red]{ending.code.word}[/]"
        self._line(task, self._loop.time(), word, shortened(ending.message))
        del self._lines[task]

    def _line(self, task: UUID, now: float, word: str, text: str) -> None:
        self._lines_of(task).line(now, word, text)

    def _lines_of(self, task: UUID) -> ConsoleObserver:
        if task not in self._lines:
            lines = self._lines[task] = ConsoleObserver(self._terminal, f"{task.hex[:8]}  ", self._began)
            goals = [_goal(status) for status in self._tasks.status() if status.id == task]
            lines.line(self._loop.time(), "[bold]goal[/]  ", shortened("".join(goals)))
        return self._lines[task]


def _goal(status: Status) -> str:
    given = (
        f"{name}: {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)}"
        for name, value in status.parameters.items()
    )
    return f"{status.goal}({', '.join(given)})" if status.parameters else status.goal


def shortened(text: str) -> str:
    """Return a text as a line can show it."""
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
