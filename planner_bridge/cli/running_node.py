"""`pnm serve`, and the words for a node that runs, from another terminal: `pnm status`, `watch`, `goal`, `pause`, `cancel`, `facts`…"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from getpass import getuser
from math import inf
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, TypeVar
from uuid import UUID, uuid4

import click
from rich.live import Live
from rich.table import Column, Table
from rich.text import Text

from planner_bridge.cli import options
from planner_bridge.cli.console import EventLines, SafeConsole, ToldFailures
from planner_bridge.cli.options import command
from planner_bridge.node.options import PARAMETERS
from pnm.clock import run_async
from pnm.core.machine.requests import OutcomeKind
from pnm.core.resources import Hand
from pnm.errors import InputError, PnmError
from pnm.files.database.place import place_of
from pnm.files.yaml_nodes import load_yaml
from pnm.journal.kept import Fenced
from pnm.ros.node.parameters import NodeParameter, ParameterValue
from pnm.ros.tasks.executor_topics import odds_of, task_as_json
from pnm.tasks import Code, OnConflict, TaskState, TraceEvent, TraceKind, percent, results_text

if TYPE_CHECKING:
    from pnm.ros.node_client import NodeClient

T = TypeVar("T")

SECOND: Final = 1.0
"""Seconds between two lines with feedback about the same call."""
_LAST: Final = 1.0
"""Seconds for the last events of a task after its result."""
_TRACE: Final = ("pnm_interfaces/msg/TraceEvent", "executor/trace")

namespace_option = click.option("-n", "--namespace", default="", help="the namespace of the node")
one_or_all = options.options(
    click.argument("task", default=""), click.option("--all", "every", is_flag=True, help="all tasks, also later ones"), namespace_option
)


def event_of(message: Any) -> TraceEvent:
    """Return an event of a task, as the node publishes it in a ``TraceEvent``."""
    task, time = UUID(bytes=bytes(message.task.uuid)), message.stamp.sec + message.stamp.nanosec / 1e9
    return TraceEvent(task, time, TraceKind(message.kind), message.subject, message.text)


@dataclass
class TaskBoard:
    """The running tasks and calls, shown below the events on a terminal, with seconds and feedback.

    The mutable state is the goal and the state of each task that is not over, and since when its calls are under way, with what
    their servers have said last.
    """

    goals: dict[UUID, str] = field(default_factory=dict)
    states: dict[UUID, str] = field(default_factory=dict)
    calls: dict[UUID, dict[str, tuple[float | None, str]]] = field(default_factory=dict)

    @staticmethod
    def of(message: Any) -> TaskBoard:
        """Read an ``ExecutorStatus``. Since when its calls are under way is not known."""
        board = TaskBoard()
        for task in message.tasks:
            if task.state != task.OVER:
                id = UUID(bytes=bytes(task.id.uuid))
                board.goals[id], board.states[id] = task.goal, ": ".join(filter(None, (TaskState(task.state).word, task.reason)))
                board.calls[id] = {call: (None, said) for call, said in zip(task.running, task.feedback, strict=True)}
        return board

    def note(self, event: TraceEvent, now: float) -> None:
        """Change as the event says, which is heard now."""
        calls = self.calls.setdefault(event.task, {})
        match event.kind:
            case TraceKind.GOAL:
                self.goals[event.task] = event.text
            case TraceKind.STATE if event.text.startswith("over"):
                for kept in (self.goals, self.states, self.calls):
                    kept.pop(event.task, None)
            case TraceKind.STATE:
                self.states[event.task] = event.text
            case TraceKind.SENT if event.subject:  # else a request to cancel
                calls[event.subject] = (now, "")
            case TraceKind.FEEDBACK:
                calls[event.subject] = (calls.get(event.subject, (None, ""))[0], event.text)
            case TraceKind.ENDED:
                calls.pop(event.subject, None)

    def shown(self, now: float) -> Table:
        """Return the tasks with their calls, as a table that fits any terminal."""
        table = Table.grid(Column(no_wrap=True), Column(overflow="fold"), padding=(0, 2))
        for task, state in self.states.items():
            table.add_row(Text(task.hex[:8], "bold"), Text.assemble((self.goals.get(task, ""), "bold"), f"  {state}"))
            for call, (since, said) in self.calls.get(task, {}).items():
                table.add_row("" if since is None else f"{now - since:6.0f} s", "  ".join(filter(None, (call, said))))
        return table


class EventPrinter:
    """Prints a line per event, and shows below them on a terminal what is going on; elsewhere feedback is printed once a second.

    The mutable state is what is going on, and when feedback was printed last, by task and call.
    """

    def __init__(self, console: SafeConsole, board: TaskBoard | None = None) -> None:
        self._lines = EventLines(console)
        self._board = board or TaskBoard()
        self._failures = ToldFailures()
        self._told: dict[tuple[UUID, str], float] = {}
        self._below = Live(get_renderable=lambda: self._board.shown(monotonic()), console=console, refresh_per_second=4, transient=True)
        if console.is_terminal:
            self._below.start()

    def close(self) -> None:
        """Show nothing below the lines any more."""
        self._below.stop()

    def print(self, event: TraceEvent, label: str = "") -> None:
        """Print an event; the label comes behind its time."""
        self._board.note(event, monotonic())
        words, key = self._failures.words(event), (event.task, event.subject)
        if event.kind is TraceKind.FEEDBACK:
            if self._below.is_started or event.time - self._told.get(key, -inf) < SECOND:
                return
            self._told[key] = event.time
        if event.kind is not TraceKind.FIRED:
            self._lines.print(event.time, Text(f"{event.kind.word:<7}"), words, label)


@click.command(epilog="Example: pnm status --json")
@namespace_option
@options.as_json_option
@command
def status(namespace: str, as_json: bool) -> int:
    """Show the tasks of the node.

    Lists running and waiting tasks, and those that ended last; and what people have in their hands.
    """

    async def ask(node: NodeClient) -> tuple[Any, list[dict[str, Any]]]:
        return await node.status(), await node.hands()

    message, hands = _with_node(namespace, ask)
    if as_json:
        options.print_json({"paused": message.paused, "hands": hands, "tasks": [task_as_json(task) for task in message.tasks]})
    else:
        _print_status(SafeConsole(), message, hands)
    return 0


@click.command(epilog="Example: pnm watch -n /robot1")
@namespace_option
@command
def watch(namespace: str) -> int:
    """Follow the tasks of the node until interrupted.

    Prints the tasks, and a line for every event; a terminal also shows the running calls below.
    """
    console = SafeConsole()

    async def show(node: NodeClient) -> None:
        async with node.hearing(*_TRACE) as heard:
            status = await node.status()
            _print_status(console, status, await node.hands())
            with closing(EventPrinter(console, TaskBoard.of(status))) as printer, suppress(asyncio.CancelledError):  # which is how it ends
                while True:
                    event = event_of(await heard.get())
                    printer.print(event, f"{event.task.hex[:8]}  ")

    _with_node(namespace, show)
    return 0


@click.command(epilog="Example: pnm goal '(at r1 hall)' --deadline 60")
@click.argument("goal", default="")
@click.option("--priority", type=click.IntRange(-(2**31), 2**31 - 1), default=0, show_default=True, help="higher ones come first")
@click.option("--deadline", type=options.Seconds(0.001), help="seconds from now by which it must be reached")
@click.option(
    "--policy",
    type=click.Choice([policy.word for policy in OnConflict]),
    default="default",
    show_default=True,
    help="what to do in conflict with other tasks",
)
@click.option(
    "--odds", "least", type=click.FloatRange(0.0, 1.0), help="print the odds, and send it only with this chance at least; a terminal asks"
)
@options.set_option
@namespace_option
@options.as_json_option
@command
def goal(
    *,
    goal: str,
    priority: int,
    deadline: float | None,
    policy: str,
    least: float | None,
    given: tuple[str, ...],
    namespace: str,
    as_json: bool,
) -> int:
    """Send a goal, and follow it to its end.

    GOAL is a condition in PDDL, or the name of a goal or of a hand-written plan of the node; by default the goal of the node's problem.
    Prints all events of the task. Ctrl-C cancels it. With --odds, the node makes a plan first, from the world as it is then.
    """
    console, task = SafeConsole(), uuid4()
    ranked = {"priority": priority, "deadline": deadline or 0.0}
    parameters = json.dumps(options.plan_parameters(given), default=str) if given else ""
    if given and (least is not None or policy != "default" or "(" in goal or not goal):
        raise InputError("--set is for a hand-written plan; expected its name as GOAL, without --odds and --policy")

    async def print_events(heard: asyncio.Queue[Any]) -> None:
        with closing(EventPrinter(console)) as printer:
            while not ((event := event_of(await heard.get())).task == task and event.text.startswith("over: ")):  # the last line has that
                if event.task == task and not as_json:
                    printer.print(event)

    async def achieve(node: NodeClient) -> Any:
        async with node.hearing(*_TRACE) as heard:
            printing = asyncio.create_task(print_events(heard))
            try:
                if parameters or (goal.replace("-", "_").isidentifier() and least is None and await node.has_plan(goal)):
                    outcome = await node.execute(goal, parameters, ranked, task)
                else:
                    outcome = await node.achieve({"goal": goal, "policy": int(OnConflict[policy.upper()]), **ranked}, task)
                if outcome.result:  # the last events may be on their way
                    await asyncio.wait([printing], timeout=_LAST)
                return outcome
            finally:
                printing.cancel()

    odds = None
    if least is not None:
        made: Any = _with_node(namespace, lambda node: node.plan(goal))
        odds = odds_of(SimpleNamespace(**made.result["odds"])) if "odds" in made.result else None
        words = f"{odds} ({odds.rests})" if odds else f"not known: {made.message}"
        if not as_json:
            console.print_text(words, "odds     ")
        if odds is None or odds.chance < least:
            wanted = f"expected {percent(least)} at least"
            if as_json or not sys.stdin.isatty() or not click.confirm(f"{wanted}; send it all the same?"):
                is_wrong = made.result.get("code") == Code.INVALID_GOAL
                raise (InputError if is_wrong else PnmError)(f"the goal is not sent: its odds are {words}; {wanted}")
    outcome = _with_node(namespace, achieve)
    is_reached = outcome.kind is OutcomeKind.SUCCEEDED
    if as_json:
        trace = {"trace": [f"{event['word']} {event['subject']} {event['text']}".strip() for event in outcome.result.get("trace", ())]}
        told = {"odds": odds.as_json()} if odds else {}
        options.print_json({"task": str(task), "goal_reached": is_reached, **outcome.result, "message": outcome.message, **trace, **told})
    else:
        if is_reached:
            console.print_text("holds", "[bold green]goal[/]     ")
            if results := json.loads(outcome.result.get("results", "{}")):
                console.print_text(results_text(results), "[bold]results[/]  ")
        else:
            console.print(Text.assemble(("goal", "bold red"), f"     not reached: {outcome.message or outcome.kind.value}"))
    return 0 if is_reached else 2 if outcome.result.get("code") == Code.INVALID_GOAL else 1


@click.command(epilog="Examples: pnm answer yes; pnm answer 3f2a 'the kitchen'")
@click.argument("words", nargs=-1, required=True, metavar="[TASK] TEXT")
@click.option("--name", default="", help="the variable that is asked for, if the task asks several questions")
@namespace_option
@command
def answer(words: tuple[str, ...], name: str, namespace: str) -> int:
    """Answer a question that a task asks a person.

    TASK is the beginning of its id; by default the only running task. `pnm status` lists the questions. The first answer counts.
    """
    *prefix, text = words
    if len(prefix) > 1:
        raise InputError("expected the beginning of the id of a task and one text; a text with spaces needs quotes")

    async def apply(node: NodeClient) -> str:
        task = await node.task("".join(prefix))
        await node.ask("pnm_interfaces/srv/UpdateKnowledge", "executor/answer", {"goal_id": task, "name": name, "value": text})
        return task.hex[:8]

    print(f"{_with_node(namespace, apply)}: answered")
    return 0


@click.command(epilog="Example: pnm pause 3f2a --at-once")
@one_or_all
@click.option("--at-once", is_flag=True, help="cancel running calls, instead of waiting for their ends")
@command
def pause(task: str, every: bool, namespace: str, at_once: bool) -> int:
    """Pause a task: it starts nothing more.

    TASK is the beginning of its id; by default the only running task.
    """
    return _command("pause", "paused", task, every=every, namespace=namespace, at_once=at_once)


@click.command(epilog="Examples: pnm resume --all; pnm resume tea.journal")
@one_or_all
@options.adopt_option
@click.option("--yes", "is_trusted", is_flag=True, help="continue a FILE that somebody else, or another computer, has begun")
@command
def resume(task: str, every: bool, namespace: str, adopt: bool, is_trusted: bool) -> int:
    """Continue a paused task, or a run that has died.

    TASK is the beginning of a task's id, by default of the only paused task. Or it is the file of `pnm run --journal FILE`: the run
    continues in this process, with its options. A file that you have not begun on this computer is like a script of somebody else:
    the command shows what it would do, and asks.
    """
    if task.strip("0123456789abcdefABCDEF-"):  # no id
        from planner_bridge.cli.journal import resume_run  # here, because it takes its time to import

        return resume_run(place_of(task), adopts=adopt, is_trusted=is_trusted)
    if adopt or is_trusted:
        raise InputError("--adopt and --yes are about a journal; expected its file")
    return _command("resume", "goes on", task, every=every, namespace=namespace)


@click.command(epilog="Example: pnm cancel 3f2a")
@one_or_all
@command
def cancel(task: str, every: bool, namespace: str) -> int:
    """Cancel a task, and wait for its robots.

    TASK is the beginning of its id; by default the only running task.
    """
    return _command("cancel", "cancelled", task, every=every, namespace=namespace)


@click.command(epilog="Example: pnm take r1 --reason 'the gripper is stuck'")
@click.argument("robot")
@click.option("--reason", default="", help="why, for everybody who reads the status of the node")
@click.option("--by", default="", help="who takes it; by default the name of the user")
@namespace_option
@command
def take(robot: str, reason: str, by: str, namespace: str) -> int:
    """Take a robot over: nothing is sent to it.

    ROBOT is the name of a robot, or of another object or resource. What needs it is cancelled; tasks go on without it, or wait.
    The command ends when the robot has confirmed that it stops. Exit status 1: it has not, and may still move.
    """
    said = _with_node(namespace, lambda node: node.put(robot, {"by": by or getuser(), "reason": reason}))
    print(f"{robot}: taken{f'; {said}' if said else ', and at rest'}")
    return 1 if said else 0


@click.command(epilog="Example: pnm give r1")
@click.argument("robot")
@namespace_option
@command
def give(robot: str, namespace: str) -> int:
    """Give a robot back that you have taken over.

    What sensors are asked for is asked for anew. Tasks go on with their plans if these still work, otherwise with new ones.
    """
    _with_node(namespace, lambda node: node.put(robot, None))
    print(f"{robot}: given back")
    return 0


@click.command(epilog="Example: pnm facts '(at r1 hall)' --add '(open door)'")
@click.argument("questions", nargs=-1)
@click.option("--add", multiple=True, metavar="FACT", help="record as true: '(at r1 hall)', '(= (battery r1) 0.8)'")
@click.option("--remove", multiple=True, metavar="FACT", help="record as false")
@click.option("--forget", multiple=True, metavar="FACT", help="record as unknown")
@namespace_option
@options.as_json_option
@command
def facts(
    *, questions: tuple[str, ...], add: tuple[str, ...], remove: tuple[str, ...], forget: tuple[str, ...], namespace: str, as_json: bool
) -> int:
    """Print or change the facts of the node.

    QUESTIONS are facts and numbers such as '(at r1 hall)' or '(battery r1)'; by default all.
    """
    changes = {"add": list(add), "remove": list(remove), "forget": list(forget)}

    async def exchange(node: NodeClient) -> dict[str, str]:
        if add or remove or forget:
            await node.ask("pnm_interfaces/srv/UpdateFacts", "knowledge/update", changes)
            if not questions:
                return {}
        answer = await node.ask("pnm_interfaces/srv/QueryFacts", "knowledge/query", {"questions": list(questions)})
        return dict(zip(answer.facts, answer.values, strict=True))

    known = _with_node(namespace, exchange)
    if as_json:
        options.print_json(known)
    else:
        for fact, value in sorted(known.items()):
            SafeConsole().print(f"{fact}  {value}")
    return 0


def _with_node(namespace: str, work: Callable[[NodeClient], Awaitable[T]]) -> T:
    """Do the work with a client in the namespace of the node."""
    from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

    async def connected() -> T:
        async with RosThread("pnm_client", namespace=namespace) as ros:
            from pnm.ros.node_client import NodeClient  # needs rclpy, which is there by now

            return await work(NodeClient(ros))

    return run_async(connected())


def _command(name: str, done: str, prefix: str, *, every: bool, namespace: str, **fields: object) -> int:
    async def apply(node: NodeClient) -> str:
        task = None if every else await node.task(prefix)
        await node.command(name, task, **fields)
        return "all tasks" if task is None else task.hex[:8]

    print(f"{_with_node(namespace, apply)}: {done}")
    return 0


def _print_status(console: SafeConsole, message: Any, hands: list[dict[str, Any]]) -> None:
    if message.paused:
        console.print("paused: nothing is started")
    for hand in hands:
        console.print_text(str(Hand(**hand)))
    if not message.tasks:
        console.print("no tasks")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("task", "state", "goal", "calls ended", "under way, and why"):
        table.add_column(column, overflow="fold")
    for status in message.tasks:
        task, odds = task_as_json(status), odds_of(status.odds)
        calls = (": ".join(filter(None, said)) for said in zip(task["running"], task["feedback"], strict=True))
        why = "; ".join(filter(None, (", ".join(calls), task["reason"])))
        table.add_row(task["id"][:8], task["code"] or task["state"], task["goal"], str(task["ended"]), why)
        if odds:
            table.add_row("", "", "", "", f"odds {odds} ({odds.rests})", style="dim")
    console.print(table, soft_wrap=False)


# --- serve ----------------------------------------------------------------------------------------
# `pnm serve`: options that are the parameters of a node, and arguments for ROS 2 behind them.


ROS_ARGUMENTS: Final = "--ros-args"
FENCED: Final = 3
"""The exit status of a node that may not write its journal any more; started again, it stands by, or goes on with what is kept."""


class RosCommand(options.ViewingCommand):
    """A command whose arguments from ``--ros-args`` on are for ROS 2, as `ros2 run` and `ros2 launch` pass them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Split off the arguments for ROS 2."""
        end = args.index(ROS_ARGUMENTS) if ROS_ARGUMENTS in args else len(args)
        ctx.meta[ROS_ARGUMENTS] = args[end:]
        return super().parse_args(ctx, args[:end])


def _option(parameter: NodeParameter) -> Callable[[Any], Any]:
    """Return the option for a parameter. It has no default: only what is given overrides that of the parameter."""
    name = (parameter.option or parameter.name).replace("_", "-")
    default = f"  [default: {parameter.default}]" if parameter.default not in ("", True) else ""
    about: dict[str, Any] = {"help": parameter.description + default, "default": None}
    match parameter.default:
        case bool():
            return click.option(f"--{name}/--no-{name}", parameter.name, **about)
        case int():
            about["type"] = click.IntRange(int(parameter.least))
        case float():
            about["type"] = click.FloatRange(parameter.least)
        case _ if parameter.choices:
            about["type"] = click.Choice(parameter.choices)
        case _:
            about["metavar"] = "TEXT"
    return click.option(f"--{name}", parameter.name, **about)


@click.command(cls=RosCommand, epilog="Example: pnm serve domain.pddl problem.pddl --planner-timeout 5 --ros-args -r __ns:=/robot1")
@click.argument("domain", required=False)
@click.argument("problem", required=False)
@click.option("--params-file", "files", multiple=True, type=options.FILE, help="a ROS file of parameters; may be repeated")
@options.options(*(_option(parameter) for parameter in PARAMETERS if parameter.name not in ("domain", "problem")))
@options.view_option
@options.controls_option
@command
def serve(files: tuple[Path, ...], view: int | None, controls: bool, **given: ParameterValue | None) -> int:
    """Take goals over ROS 2 until interrupted.

    This is the node of a robot. It offers actions for goals of DOMAIN and PROBLEM, and for each plan of a world.
    With --view, a page shows its journal; with --view-controls, people also send goals and control tasks there.
    Arguments after --ros-args are for ROS 2. Options override parameters that are given there, and files of parameters.
    """
    # here, because these take their time to import, which `pnm serve --help` need not wait for
    from planner_bridge.cli.console import SafeConsole
    from planner_bridge.cli.run_console import NodeConsole, NodePage
    from planner_bridge.node.node_journal import NONE
    from planner_bridge.node.node_log import NodeObserver
    from planner_bridge.node.serve import serve
    from planner_bridge.view.serving import Controlled, PageProcess
    from pnm.core.execution.events import broadcast

    for file in files:
        load_yaml(file)  # which says where it is wrong; what it means is for ROS
    named = [part for file in files for part in ("--params-file", str(file))]
    arguments = [ROS_ARGUMENTS, *named, *click.get_current_context().meta[ROS_ARGUMENTS]]
    chosen = {name: value for name, value in given.items() if value is not None}
    journal = str(chosen.get("journal", ""))
    if view is not None and journal == NONE:
        raise InputError(f"--view shows the journal; expected one, and not --journal {NONE}")
    controlled = options.controlled_by(view, Controlled.NODE, controls=controls)
    console: NodeObserver = NodeConsole(SafeConsole())
    try:
        if view is None:
            serve(chosen, arguments, console)
        else:
            with PageProcess(view, controlled) as page:
                options.announce(page)
                serve(chosen, arguments, broadcast(NodeObserver, (console, NodePage(page, journal))))
    except Fenced as error:
        print(error, file=sys.stderr)
        return FENCED
    return 0
