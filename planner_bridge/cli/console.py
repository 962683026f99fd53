"""Output on the terminal for one task: its plan, its machine, the events of its runs, its result."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.markup import escape

from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.tasks.replanning import PlanAgain, ResumePlan
from planner_bridge.tasks.result import ConstraintResult, PreferenceResult, TaskResult, Violation
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import Explanation, Failure, RunResult
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import Proof
from pnm.knowledge.sources.person_text import printable


class SafeConsole(Console):
    """A console that neither fails when its reader has closed the pipe nor prints control characters."""

    def on_broken_pipe(self) -> None:
        """Write to the null device from now on: whatever is running goes on undisturbed."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts without control characters and without what UTF-8 cannot encode."""
        safe = ("\n".join(map(printable, part.split("\n"))) if isinstance(part, str) else part for part in objects)
        super().print(*safe, **options)


@dataclass
class EventLines:
    """Prints one line per event: the seconds since the beginning, a label, a word and a text.

    Args:
        label: what every line has after the time.
        began: the time from which seconds count; that of the first line when None. Mutable state.
    """

    console: Console
    label: str = ""
    began: float | None = None

    def print(self, now: float, word: str, text: str) -> None:
        """Print a line; the word may have markup."""
        if self.began is None:
            self.began = now
        self.console.print(f"  {now - self.began:8.2f} s  {escape(self.label)}{word} {escape(text)}", highlight=False, soft_wrap=True)


class ConsoleObserver(TaskObserver):
    """Prints a line per event of a task; shows a spinner while it plans, when the output is a terminal.

    The mutable state is the time from which seconds count, the spinner, why calls are tried again, by number, and what was printed
    of failures: the same is not printed again but at the end.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines = EventLines(console)
        self._waiting = ExitStack()
        self._causes: dict[int, str] = {}
        self._printed: set[str] = set()

    def began(self, now: float) -> None:
        """Count seconds from the beginning of the task; a plan that goes on under a planner keeps its own."""
        if self._lines.began is None:
            self._lines.began = now

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

    def blocked(self, reason: str) -> None:
        """Print why there is no plan, so that people can help."""
        self._console.print(f"[bold yellow]help[/]     {escape(reason)}", highlight=False, soft_wrap=True)

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Print the size of the machine, in which calls have numbers of their own."""
        self._causes.clear()
        net = machine.net
        size = f"{len(net.places)} places, {len(net.transitions)} transitions, {len(machine.orderings)} orderings"
        self._console.print(f"[bold]machine[/]  {size}; proved {proof}", highlight=False, soft_wrap=True)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Print that a call starts."""
        again = f" (attempt {request.attempt}, after {self._causes.pop(call.index, 'a pause')})" if request.attempt > 1 else ""
        self._lines.print(now, "[blue]start[/] ", f"{call.action}{again}")

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        """Keep the cause for when the call is tried again; what was expected besides, if no report has said it."""
        self._causes[call.index] = f"{cause.cause}{self._new(Failure(call, *cause).details)}"

    def spared(self, call: ActionCall, now: float) -> None:
        """Print that a call is not needed."""
        self._lines.print(now, "[green]spared[/]", f"{call.action}: its effects hold already")

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Print how a request ended."""
        if outcome.kind is OutcomeKind.SUCCEEDED:
            self._lines.print(now, "[green]done[/]  ", str(call.action.operation or call.action))
        else:
            self._lines.print(now, "[red]ended[/] ", f"{call.action}: {outcome.kind.value}{self._new(outcome.message)}")

    def failed(self, failure: Failure, now: float) -> None:
        """Print that a failure place is marked."""
        step = failure.call.action if isinstance(failure.call, ActionCall) else failure.call
        self._lines.print(now, "[bold red]failed[/]", f"{step}: {failure.cause}{self._new(failure.details)}")

    def _new(self, details: str) -> str:
        """Return the details of a failure with a colon before them, unless they were printed already."""
        if not details or details in self._printed:
            return ""
        self._printed.add(details)
        return f": {details}"

    def resigned(self, reason: str) -> None:
        """Print that a planner takes over."""
        self._console.print(f"[bold yellow]replan[/]   {escape(reason)}", highlight=False, soft_wrap=True)

    def replanning(self, decision: ResumePlan | PlanAgain, result: RunResult) -> None:
        """Print what follows a failed run."""
        match decision:
            case ResumePlan(rest):
                text = f"the rest of the plan still works: going on with {len(rest.calls)} calls in a new machine"
            case PlanAgain(forbidden, why):
                without = f"; not again: {', '.join(sorted(map(str, forbidden)))}" if forbidden else ""
                text = f"a new plan is needed: {why}{without}"
        self._console.print(f"[bold yellow]replan[/]   {escape(text)}", highlight=False, soft_wrap=True)

    def violated(self, violation: Violation, now: float) -> None:
        """Print that a constraint is violated."""
        self._lines.print(now, "[bold red]broken[/]", f"{violation.constraint}; observed {violation.observed}")


def print_result(console: Console, result: TaskResult) -> None:
    """Print how the task ended."""
    word = "[bold green]goal[/]     holds" if result.goal_reached else "[bold red]goal[/]     not reached"
    console.print(f"{word}: {escape(result.reason)}" if not result.goal_reached else word, highlight=False, soft_wrap=True)
    sent = sum(call.attempts for call in result.calls)
    assumed = sum(call.assumed for call in result.calls)
    unreported = f"; {assumed} calls had effects that nothing reports" if assumed else ""
    planned = ((result.plans, "plan"), (result.replans, "replan")) if result.plans or not result.episodes else ()
    counts = ", ".join(_count(number, word) for number, word in (*planned, (sent, "request"), (len(result.failures), "failure")))
    console.print(f"         {counts}{unreported}", highlight=False, soft_wrap=True)
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
