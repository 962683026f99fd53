"""Output on the terminal for a node with many tasks: its life cycle, and a line per event with the beginning of the task's id."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterable
from uuid import UUID

from planner_bridge.cli.consoles.event_lines import EventLines, ToldFailures
from planner_bridge.cli.consoles.on_stderr import print_warnings
from planner_bridge.cli.consoles.safe_console import SafeConsole
from planner_bridge.node.node_log import NodeObserver, journal_words, standing_words
from planner_bridge.view.control.operator import Operator
from planner_bridge.view.process import PageProcess
from pnm.core.machine.verification.verify import Proof
from pnm.errors import Tolerated
from pnm.tasks import Code, ServedWorld, TaskCommands, TaskEnding, TaskListener, Tasks, TraceEvent, shortened


class NodeConsole(NodeObserver):
    """Prints what happens to a node and to its tasks; warnings about its files go to stderr."""

    def __init__(self, console: SafeConsole) -> None:
        self._console = console

    def unconfigured(self) -> None:
        """Print that a lifecycle manager is waited for."""
        self._console.print("unconfigured: waits for its transitions")

    def tolerated(self, warnings: Iterable[Tolerated]) -> None:
        """Print warnings on stderr."""
        print_warnings(warnings)

    def proved(self, plan: str, proof: Proof) -> None:
        """Print the proof of a plan."""
        self._console.print_text(f"{plan}: proved {proof}", "[bold]plan[/]     ")

    def journalled(self, place: str, going_on: int | None) -> None:
        """Print where tasks are kept."""
        self._console.print(journal_words(place, going_on))

    def standing_by(self, place: str, holder: str) -> None:
        """Print who holds the journal."""
        self._console.print(standing_words(place, holder))

    def activated(self, actions: tuple[str, ...]) -> None:
        """Print the action servers of the node."""
        text = f"ready: {len(actions)} action servers: {', '.join(actions)}"
        self._console.print(text)

    def deactivated(self) -> None:
        """Print that goals are rejected."""
        self._console.print("inactive: goals are rejected, and tasks are paused")

    def missing(self, server: str) -> None:
        """Print that a server is missing."""
        self._console.print_text(f"there is no action server {server} yet", "[bold yellow]missing[/]  ")

    def failed(self, error: BaseException) -> None:
        """Print why servers cannot be used."""
        self._console.print_text(str(error), "[bold red]wrong[/]    ")

    def configured(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld) -> None:
        """Print the events of tasks from now on."""
        tasks.listen(TaskConsole(self._console))


class NodePage(NodeObserver):
    """Shows a node on a page as soon as it is known which journal is its own, also while another process holds that.

    Args:
        page: where it is shown.
        given: the journal as it was given on the command line, with the password that others leave out; empty for none.
    """

    def __init__(self, page: PageProcess, given: str) -> None:
        self._page = page
        self._given = given

    def journalled(self, place: str, going_on: int | None) -> None:
        """Show the journal."""
        if place:
            self._page.follow(self._given or place)
        else:
            print("view     there is no journal that could be shown", file=sys.stderr)

    def standing_by(self, place: str, holder: str) -> None:
        """Show the journal."""
        self._page.follow(self._given or place)

    def configured(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld) -> None:
        """Have the page control the tasks, if it may."""
        self._page.operate(Operator(tasks, commands, world))


class TaskConsole(TaskListener):
    """Prints the events of tasks. The mutable state is a printer for every task that is not over, and what was told."""

    def __init__(self, console: SafeConsole) -> None:
        self._console = console
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._lines: dict[UUID, EventLines] = {}
        self._failures = ToldFailures()

    def happened(self, moment: TraceEvent) -> None:
        """Print an event, but not every transition that fires."""
        told = self._failures.text(moment.task, moment.kind, moment.subject, moment.text)
        if not moment.kind.is_frequent and not moment.text.startswith("over: "):  # `ended` prints the result
            text = ": ".join(filter(None, (moment.subject, told)))
            self._lines_of(moment.task).print(moment.time, f"{moment.kind.word:<7}", shortened(text))

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Print how a task ended."""
        word = "[bold green]reached[/]" if ending.code is Code.GOAL_REACHED else f"[bold red]{ending.code.word}[/]"
        self._lines_of(task).print(self._loop.time(), word, shortened(ending.message))
        del self._lines[task]

    def _lines_of(self, task: UUID) -> EventLines:
        """Return the printer of a task."""
        if task not in self._lines:
            self._lines[task] = EventLines(self._console, f"{task.hex[:8]}  ", self._began)
        return self._lines[task]
