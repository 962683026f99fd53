"""Output on the terminal: of one task, its plan, machine, events and result; of a node, its life cycle and the events of its tasks."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias
from uuid import UUID

from planner_bridge.cli.console import INDENT, EventLines, SafeConsole, ToldFailures
from planner_bridge.cli.options import planner_words, print_warnings, waiting
from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.node.node_log import NodeObserver, standing_words
from planner_bridge.tasks.replanning import BetterRest, Foreseen, PlanAgain, ResumePlan, decision_words
from planner_bridge.tasks.result import PlanResult, TaskResult, Violation
from planner_bridge.tasks.settings import TaskObserver
from planner_bridge.view.serving import Operator, PageProcess
from pnm.core.execution.call_results import Explanation, Failure, RunResult
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Step, step_words
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import Proof
from pnm.errors import Tolerated, counted
from pnm.tasks import Code, ServedWorld, TaskCommands, TaskEnding, TaskListener, Tasks, TraceEvent, results_text, shortened

if TYPE_CHECKING:
    from planner_bridge.pipeline.roll_outs import VettedPlan

_STEP: Final = re.compile(r" *[0-9.]+( s)? +")
"""The time of a step of a plan, in front of it."""


_SOON: Final = 0.2
"""Seconds within which a call that is being cancelled ends, if its server does nothing more: that it is late is not printed then."""


class _News(NamedTuple):
    """An event of a call, printed together with its consequence: time, word, subject, reason and details."""

    now: float
    word: str
    action: GroundAction
    cause: str
    details: str


_Key: TypeAlias = tuple[int, str]


def _key(step: Step) -> _Key:
    """Return the number of a step and its action: calls of a plan that another one calls have the same numbers."""
    return step.index, step.action.name if isinstance(step, ActionCall) else ""


class ConsoleObserver(TaskObserver):
    """Prints a line per event of a task; shows a spinner while it plans, when the output is a terminal.

    An end without success and what follows from it at once are one line.

    Args:
        limit: seconds that the planner may take.
        robots: who performs the actions; printed before the first event, if it is not empty.
        awaited: what is waited for between a plan and its machine, with the limit; empty for nothing.
        is_verbose: whether it prints how large machines are, and how they were proved.
        vetted: has the odds of the first plan, if these are known.

    The mutable state is whether that was printed, the time from which seconds count, the spinner, by call its attempts, why it is
    tried again and what is not printed yet, and what was printed of the failures of each action: the same is not printed again but
    at the end.
    """

    def __init__(
        self,
        console: SafeConsole,
        limit: float,
        *,
        robots: str = "",
        awaited: str = "",
        is_verbose: bool = False,
        vetted: VettedPlan | None = None,
    ) -> None:
        self._console = console
        self._vetted = vetted
        self._limit = limit
        self._robots = robots
        self._awaited = awaited
        self._is_verbose = is_verbose
        self._lines = EventLines(console)
        self._waiting = ExitStack()
        self._attempts: dict[_Key, int] = {}
        self._causes: dict[_Key, Failure] = {}
        self._news: dict[_Key, _News] = {}
        self._printed: set[tuple[str, str]] = set()

    def wait(self, text: str) -> None:
        """Show what is waited for, with its limit, until something happens."""
        self._waiting.close()
        self._waiting.enter_context(waiting(text, self._console))

    def close(self) -> None:
        """Show nothing any more."""
        self._waiting.close()

    def began(self, now: float) -> None:
        """Count seconds from the beginning of the task; a plan that goes on under a planner keeps its own."""
        if self._lines.began is None:
            self._lines.began = now

    def planning(self, planner: str) -> None:
        """Show that a planner is being asked."""
        self._print_robots()
        self.wait(planner_words(planner, self._limit))

    def restored(self) -> None:
        """Print that the task goes on."""
        self._waiting.close()
        self._print_robots()
        self._console.print_text("goes on where another process has left it", "[bold]resumed[/]  ")

    def planned(self, plan: Plan) -> None:
        """Print the plan."""
        self._waiting.close()
        first, *steps = str(plan).splitlines()
        self._console.print_text(first, "[bold]plan[/]     ")
        for step in steps:
            begins = _STEP.match(step)
            when = begins[0] if begins else ""
            self._console.print_text(step.removeprefix(when), when)
        if self._vetted and self._vetted.odds and self._vetted.odds.best:
            self._console.print_text(str(self._vetted.odds), "[bold]odds[/]     ")
        self._vetted = None  # only the first plan has any
        if self._awaited:
            self.wait(self._awaited)

    def unplanned(self, result: PlanningResult) -> None:
        """Stop showing that a planner is being asked; the result is printed at the end."""
        self._waiting.close()

    def blocked(self, reason: str) -> None:
        """Print why there is no plan, so that people can help."""
        self._console.print_reason("[bold yellow]help[/]    ", reason)

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Print that the machine is proved, in which calls have numbers of their own."""
        self._attempts.clear()
        self._causes.clear()
        self._waiting.close()
        self._print_robots()
        self._console.print_text("proved: whatever happens, it ends in the goal or in a named failure", "[bold]machine[/]  ")
        if self._is_verbose:
            net = machine.net
            size = f"{len(net.places)} places, {len(net.transitions)} transitions, {len(machine.orderings)} orderings"
            self._console.print_text(f"{size}; proved {proof}", " " * INDENT)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Print that a call starts, or is tried again and why."""
        self._attempts[_key(call)] = request.attempt
        if request.attempt == 1:
            self._print(now, "[blue]start[/] ", str(call.action))
            return
        cause = self._causes.pop(_key(call), None)
        self._news.pop(_key(call), None)
        after = f"{cause.cause}{self._new(call.action, cause.details)}" if cause else "a pause"
        self._print(now, "[yellow]retry[/] ", f"{call.action}: attempt {request.attempt}, after {after}")

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        """Keep the cause, which is printed with what follows from it: that the call is tried again, or fails; alone if nothing does."""
        self._causes[_key(call)] = failure = Failure(call, *cause)
        if _key(call) in self._news:
            self._news[_key(call)] = self._news[_key(call)]._replace(cause=str(cause.cause), details=failure.details)
        else:
            self._wait_for_more(call, _News(now, "[red]wrong[/] ", call.action, str(cause.cause), failure.details))

    def late(self, call: ActionCall, limit: float, now: float) -> None:
        """Print that a call has passed its limit, unless it ends as soon as it is cancelled: how it ends is printed when that is known."""
        cause = f"it has not ended within {limit:g} s, and is being cancelled"
        news = self._news[_key(call)] = _News(now, "[yellow]late[/]  ", call.action, cause, "")

        def print_late() -> None:
            if self._news.get(_key(call)) is news:  # nothing has followed yet
                self._print_news()

        asyncio.get_running_loop().call_later(_SOON, print_late)

    def spared(self, call: ActionCall, now: float) -> None:
        """Print that a call is not needed."""
        self._print(now, "[green]spared[/]", f"{call.action}: its effects hold already")

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Print how a request ended; of one without success together with what follows."""
        if outcome.kind is OutcomeKind.SUCCEEDED:
            self._news.pop(_key(call), None)
            self._print(now, "[green]done[/]  ", str(call.action.operation or call.action))
        else:
            self._wait_for_more(call, _News(now, "[red]ended[/] ", call.action, outcome.kind.value, outcome.message))

    def turned_out(self, call: ActionCall, outcome: str, now: float) -> None:
        """Print which of its outcomes a call has had."""
        self._print(now, "[green]found[/] ", f"{call.action}: {outcome}")

    def failed(self, failure: Failure, now: float) -> None:
        """Print that a failure place is marked."""
        step = failure.call
        self._news.pop(_key(step), None)
        attempts = self._attempts.pop(_key(step), 1)
        named = step_words(step)
        tried = f" in {attempts} attempts" if attempts > 1 else ""
        self._print(now, "[bold red]failed[/]", f"{named}{tried}: {failure.cause}{self._new(named, failure.details)}")

    def _print(self, now: float, word: str, text: str) -> None:
        self._print_news()
        self._lines.print(now, word, text)

    def _wait_for_more(self, call: ActionCall, news: _News) -> None:
        """Print the news at the end of what happens at this moment, unless it is printed with what follows from it."""
        self._news[_key(call)] = news
        asyncio.get_running_loop().call_soon(self._print_news)

    def _print_news(self) -> None:
        """Print the events that still waited for a consequence."""
        waiting, self._news = self._news, {}
        for now, word, action, cause, details in waiting.values():
            self._lines.print(now, word, f"{action}: {cause}{self._new(action, details)}")

    def _print_robots(self) -> None:
        self._waiting.close()
        if self._robots:
            self._console.print_text(self._robots, "[bold]robots[/]   ")
            self._robots = ""

    def _new(self, step: object, details: str) -> str:
        """Return the details of a step's failure with a colon before them, unless they were printed already."""
        if not details or (str(step), details) in self._printed:
            return ""
        self._printed.add((str(step), details))
        return f": {details}"

    def resigned(self, reason: str) -> None:
        """Print that a planner takes over."""
        self._console.print_reason("[bold yellow]replan[/]  ", reason)

    def replanning(self, decision: ResumePlan | PlanAgain | Foreseen, result: RunResult) -> None:
        """Print why there is to be another plan."""
        foreseen = "[bold green]better[/]  " if isinstance(decision, BetterRest) else "[bold]next[/]     "
        label = foreseen if isinstance(decision, Foreseen) else "[bold yellow]replan[/]  "
        self._console.print_reason(label, decision_words(decision))

    def violated(self, violation: Violation, now: float) -> None:
        """Print that a constraint is violated."""
        self._print(now, "[bold red]broken[/]", f"{violation.constraint}; observed {violation.observed}")


def print_result(console: SafeConsole, result: TaskResult) -> None:
    """Print how the task ended."""
    if result.goal_reached:
        console.print_text("holds", "[bold green]goal[/]     ")
    else:
        console.print_reason("[bold red]goal[/]     not reached:", result.reason)
    assumed = sum(call.assumed for call in result.calls)
    unreported = f"; {counted(assumed, 'result')} believed, which no sensor confirms (docs/guides/sensing.md)" if assumed else ""
    lines = [f"{result.counts}{unreported}"]
    for constraint in result.constraints:
        if constraint.violations:
            more = len(constraint.violations) - 1
            lines.append(f"constraint {constraint.violations[0]}{f', and for {more} more choices of objects' if more else ''}")
        else:
            lines.append(f"constraint {constraint.constraint} is {constraint.status}")
    for preference in result.preferences:
        times = f" {counted(preference.violated, 'time')}" if preference.violated else ""
        lines.append(f"preference {preference.name or '(without a name)'} is {preference.status}{times}")
    for line in lines:
        console.print_text(line, " " * INDENT)
    if isinstance(result, PlanResult) and result.results:
        console.print_text(results_text(result.results), "[bold]results[/]  ")


# --- the console of a node ------------------------------------------------------------------------
# Output on the terminal for a node with many tasks: its life cycle, and a line per event with the beginning of the task's id.


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
        if not place:
            self._console.print("journal: none, tasks end with this process")
        elif going_on is None:
            self._console.print(f"journal: {place}")
        else:
            tasks = f"{counted(going_on, 'task')} of another process go{'es' if going_on == 1 else ''} on" if going_on else ""
            self._console.print(f"journal: {place}; {tasks or 'goes on with what was known'}")

    def standing_by(self, place: str, holder: str) -> None:
        """Print who holds the journal."""
        self._console.print(standing_words(place, holder))

    def activated(self, actions: tuple[str, ...]) -> None:
        """Print the action servers of the node."""
        self._console.print(f"ready: {len(actions)} action servers: {', '.join(actions)}")

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
        given: the journal as it was given on the command line, with the password that others leave out; empty for none.

    The mutable state is the file of its rates.
    """

    def __init__(self, page: PageProcess, given: str) -> None:
        self._page = page
        self._given = given
        self._rates: Path | None = None

    def rated(self, file: Path | None) -> None:
        """Show odds by these rates."""
        self._rates = file

    def journalled(self, place: str, going_on: int | None) -> None:
        """Show the journal."""
        if place:
            self._page.follow(self._given or place, self._rates)
        else:
            print("view     there is no journal that could be shown", file=sys.stderr)

    def standing_by(self, place: str, holder: str) -> None:
        """Show the journal."""
        self._page.follow(self._given or place, self._rates)

    def configured(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld) -> None:
        """Have the page control the tasks, if it may."""
        self._page.operate(Operator(tasks, commands, world))


class TaskConsole(TaskListener):
    """Prints the events of tasks. The mutable state is what was told of failures."""

    def __init__(self, console: SafeConsole) -> None:
        self._loop = asyncio.get_running_loop()
        self._lines = EventLines(console, self._loop.time())
        self._failures = ToldFailures()

    def happened(self, moment: TraceEvent) -> None:
        """Print an event, but not every transition that fires."""
        told = self._failures.words(moment)
        if not moment.kind.is_frequent and not moment.text.startswith("over: "):  # `ended` prints the result
            self._lines.print(moment.time, f"{moment.kind.word:<7}", shortened(told), f"{moment.task.hex[:8]}  ")

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Print how a task ended."""
        word = "[bold green]reached[/]" if ending.code is Code.GOAL_REACHED else f"[bold red]{ending.code.word}[/]"
        message = f"{ending.message}; {results_text(ending.results)}" if ending.results else ending.message
        self._lines.print(self._loop.time(), word, shortened(message), f"{task.hex[:8]}  ")
