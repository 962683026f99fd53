"""What a person sees in the terminal: plans, machines, the course of a run, the end of a task.

What a person sees in the terminal of many tasks at once: a line per moment, with the beginning of the task's id.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import ExitStack
from typing import Any, Final
from uuid import UUID

from rich.console import Console
from rich.markup import escape

from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.tasks.replanning import PlanAgain, Resume
from planner_bridge.tasks.result import ConstraintResult, PreferenceResult, TaskResult, Violation
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import Failure, RunResult
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import Proof
from pnm.knowledge.sources.person_text import printable
from pnm.tasks import Code, Moment, Status, TaskEnding, TaskListener, Tasks


class Terminal(Console):
    """Where a person reads along; when nobody reads any more, what goes on is not disturbed by that."""

    def on_broken_pipe(self) -> None:
        """Write nowhere from now on."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts without what could make a terminal do something, or cannot be written at all."""
        super().print(*(_printable(one) if isinstance(one, str) else one for one in objects), **options)


def _printable(text: str) -> str:
    return "\n".join(map(printable, text.split("\n")))


class ConsoleObserver(TaskObserver):
    """Prints a line per moment; shows what it waits for when the output is a terminal.

    The mutable state is the time at which the current task began, and the spinner.

    Args:
        console: where it prints.
        label: what every line begins with, after the time.
        began: the time from which lines count; that of the first line when not given.
    """

    def __init__(self, console: Console, label: str = "", began: float | None = None) -> None:
        self._console = console
        self._label = label
        self._waiting = ExitStack()
        self._began = began

    def planning(self, planner: str) -> None:
        """Show that a planner is being asked."""
        if self._console.is_terminal:
            self._waiting.enter_context(self._console.status(f"{planner} is looking for a plan"))

    def planned(self, plan: Plan) -> None:
        """Print the plan."""
        self._waiting.close()
        self._console.print(f"[bold]plan[/]     {escape(str(plan))}", highlight=False, soft_wrap=True)

    def unplanned(self, result: PlanningResult) -> None:
        """Stop showing that a planner is being asked; the result is printed at the end."""
        self._waiting.close()

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Print the size of the machine."""
        net = machine.net
        size = f"{len(net.places)} places, {len(net.transitions)} transitions, {len(machine.orderings)} orderings"
        self._console.print(f"[bold]machine[/]  {size}; proved {proof}", highlight=False, soft_wrap=True)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Print that a call starts."""
        again = f" (attempt {request.attempt})" if request.attempt > 1 else ""
        self.line(now, "[blue]start[/] ", f"{call.action}{again}")

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Print how a request ended."""
        if outcome.kind is OutcomeKind.SUCCEEDED:
            self.line(now, "[green]done[/]  ", str(call.action.operation or call.action))
        else:
            self.line(now, "[red]ended[/] ", f"{call.action}: {outcome.kind.value}{f': {outcome.message}' if outcome.message else ''}")

    def failed(self, failure: Failure, now: float) -> None:
        """Print that a failure place is marked."""
        step = failure.call.action if isinstance(failure.call, ActionCall) else failure.call
        self.line(now, "[bold red]failed[/]", f"{step}: {failure.cause}; expected {failure.expected}; observed {failure.observed}")

    def resigned(self, reason: str) -> None:
        """Print that a planner takes over."""
        self._console.print(f"[bold yellow]replan[/]   {escape(reason)}", highlight=False, soft_wrap=True)

    def replanning(self, decision: Resume | PlanAgain, result: RunResult) -> None:
        """Print what follows a failed run."""
        match decision:
            case Resume(rest):
                text = f"the rest of the plan still works: going on with {len(rest.calls)} calls in a new machine"
            case PlanAgain(forbidden, why):
                without = f"; not again: {', '.join(sorted(map(str, forbidden)))}" if forbidden else ""
                text = f"a new plan is needed: {why}{without}"
        self._console.print(f"[bold yellow]replan[/]   {escape(text)}", highlight=False, soft_wrap=True)

    def violated(self, violation: Violation, now: float) -> None:
        """Print that a constraint is violated."""
        self.line(now, "[bold red]broken[/]", f"{violation.constraint}; observed {violation.observed}")

    def line(self, now: float, word: str, text: str) -> None:
        """Print a line about a moment."""
        if self._began is None:
            self._began = now
        self._console.print(f"  {now - self._began:8.2f} s  {escape(self._label)}{word} {escape(text)}", highlight=False, soft_wrap=True)


def print_result(console: Console, result: TaskResult) -> None:
    """Print how the task ended."""
    word = "[bold green]goal[/]     holds" if result.goal_reached else "[bold red]goal[/]     not reached"
    console.print(f"{word}: {escape(result.reason)}" if not result.goal_reached else word, highlight=False, soft_wrap=True)
    sent = sum(call.attempts for call in result.calls)
    assumed = sum(call.assumed for call in result.calls)
    told = f"; {assumed} calls had effects that nothing reports" if assumed else ""
    planned = ((result.plans, "plan"), (result.replans, "replan")) if result.plans or not result.episodes else ()
    counts = ", ".join(_count(number, word) for number, word in (*planned, (sent, "request"), (len(result.failures), "failure")))
    console.print(f"         {counts}{told}", highlight=False, soft_wrap=True)
    for line in (*map(_constraint, result.constraints), *map(_preference, result.preferences)):
        console.print(f"         {escape(line)}", highlight=False, soft_wrap=True)


def _constraint(result: ConstraintResult) -> str:
    if not result.violations:
        return f"constraint {result.constraint} is {result.status}"
    more = len(result.violations) - 1
    return f"constraint {result.violations[0]}{f', and for {more} more choices of objects' if more else ''}"


def _preference(result: PreferenceResult) -> str:
    times = f" {_count(result.violated, 'time')}" if result.violated else ""
    return f"preference {result.name or '(without a name)'} is {result.status}{times}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


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
