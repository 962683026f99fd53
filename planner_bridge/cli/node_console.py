"""Output on the terminal for a node with many tasks: its life cycle, and a line per event with the beginning of the task's id."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable
from typing import Final
from uuid import UUID

from rich.console import Console

from planner_bridge.cli.console import EventLines
from planner_bridge.cli.options import print_warnings
from planner_bridge.node.serve import NodeObserver
from pnm.core.machine.verification.verify import Proof
from pnm.errors import Tolerated
from pnm.tasks import Code, TaskEnding, TaskListener, Tasks, TaskStatus, TraceEvent

_SHOWN: Final = 200
"""Characters of a goal, of parameters or of results that a line shows."""


class NodeConsole(NodeObserver):
    """Prints what happens to a node and to its tasks; warnings about its files go to stderr."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def unconfigured(self) -> None:
        """Print that a lifecycle manager is waited for."""
        self._console.print("unconfigured: waits for its transitions", highlight=False)

    def tolerated(self, warnings: Iterable[Tolerated]) -> None:
        """Print warnings on stderr."""
        print_warnings(warnings)

    def proved(self, plan: str, proof: Proof) -> None:
        """Print the proof of a plan."""
        self._console.print(f"[bold]plan[/]     {plan}: proved {proof}", highlight=False, soft_wrap=True)

    def activated(self, actions: tuple[str, ...]) -> None:
        """Print the action servers of the node."""
        text = f"ready: {len(actions)} action servers: {', '.join(actions)}"
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)

    def deactivated(self) -> None:
        """Print that goals are rejected."""
        self._console.print("inactive: goals are rejected, and tasks are paused", highlight=False, soft_wrap=True, markup=False)

    def missing(self, server: str) -> None:
        """Print that a server is missing."""
        self._console.print(f"[bold yellow]missing[/]  there is no action server {server} yet", highlight=False, soft_wrap=True)

    def failed(self, error: BaseException) -> None:
        """Print why servers cannot be used."""
        self._console.print(f"[bold red]wrong[/]    {error}", highlight=False, soft_wrap=True)

    def listener(self, tasks: Tasks) -> TaskListener:
        """Return a listener that prints the events of tasks."""
        return TaskConsole(self._console, tasks)


class TaskConsole(TaskListener):
    """Prints the events of tasks. The mutable state is a printer for every task that is not over."""

    def __init__(self, console: Console, tasks: Tasks) -> None:
        self._console = console
        self._tasks = tasks
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._lines: dict[UUID, EventLines] = {}

    def changed(self, task: UUID) -> None:
        """Print the goal of a task that is new."""
        self._lines_of(task)

    def happened(self, moment: TraceEvent) -> None:
        """Print an event, but not every transition that fires."""
        if moment.kind != "fired" and not moment.text.startswith("over: "):  # `ended` prints the result
            text = ": ".join(filter(None, (moment.subject, moment.text)))
            self._lines_of(moment.task).print(moment.time, f"{moment.kind:<7}", shortened(text))

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Print how a task ended."""
        word = "[bold green]reached[/]" if ending.code is Code.GOAL_REACHED else f"[bold red]{ending.code.word}[/]"
        self._lines_of(task).print(self._loop.time(), word, shortened(ending.message))
        del self._lines[task]

    def _lines_of(self, task: UUID) -> EventLines:
        """Return the printer of a task; prints its goal first if the task is new."""
        if task not in self._lines:
            lines = self._lines[task] = EventLines(self._console, f"{task.hex[:8]}  ", self._began)
            goals = [_goal(status) for status in self._tasks.status() if status.id == task]
            lines.print(self._loop.time(), "[bold]goal[/]  ", shortened("".join(goals)))
        return self._lines[task]


def _goal(status: TaskStatus) -> str:
    given = (
        f"{name}: {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)}"
        for name, value in status.parameters.items()
    )
    return f"{status.goal}({', '.join(given)})" if status.parameters else status.goal


def shortened(text: str) -> str:
    """Return a text on one line, cut off where lines end."""
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
