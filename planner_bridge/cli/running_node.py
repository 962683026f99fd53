"""`pnm status`, `watch`, `goal`, `pause`, `resume`, `cancel` and `facts`: words for a node that runs, from another terminal."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar
from uuid import UUID, uuid4

import click
from rich.console import Console
from rich.table import Table

from planner_bridge.cli.console import EventLines, SafeConsole
from planner_bridge.cli.options import Seconds, as_json_option, command, options
from pnm.clock import run_async
from pnm.core.machine.requests import OutcomeKind
from pnm.tasks import OnConflict, TaskState

if TYPE_CHECKING:
    from pnm.ros.node_client import NodeClient

T = TypeVar("T")

_TRACE: Final = ("pnm_interfaces/msg/TraceEvent", "executor/trace")
_POLICIES: Final = ("default", *(policy.value for policy in OnConflict))
"""The conflict policies, at their numbers in goals."""

namespace_option = click.option("-n", "--namespace", default="", help="the namespace of the node")
one_or_all = options(
    click.argument("task", default=""),
    click.option("--all", "every", is_flag=True, help="all tasks, those to come as well"),
    namespace_option,
)


@dataclass(frozen=True)
class Event:
    """One event of a task, as the node publishes it."""

    task: UUID
    kind: str
    text: str
    time: float

    @staticmethod
    def of(message: Any) -> Event:
        """Read a ``TraceEvent``."""
        text = ": ".join(filter(None, (message.subject, message.text)))
        return Event(UUID(bytes=bytes(message.task.uuid)), message.kind, text, message.stamp.sec + message.stamp.nanosec / 1e9)


@click.command()
@namespace_option
@as_json_option
@command
def status(namespace: str, as_json: bool) -> int:
    """Show the tasks of the node: those that are not over, and those that ended last."""
    message = _with_node(namespace, lambda node: node.status())
    if as_json:
        print(json.dumps({"paused": message.paused, "tasks": [_task_data(task) for task in message.tasks]}))
    else:
        _print_status(SafeConsole(), message)
    return 0


@click.command()
@namespace_option
@command
def watch(namespace: str) -> int:
    """Show the tasks of the node, and a line for whatever happens to them, until interrupted."""
    console = SafeConsole()

    async def show(node: NodeClient) -> None:
        async with node.hearing(*_TRACE) as heard:
            _print_status(console, await node.status())
            lines = EventLines(console)
            with suppress(asyncio.CancelledError):  # which is how it ends
                while True:
                    event = Event.of(await heard.get())
                    _print_event(lines, event, f"{event.task.hex[:8]}  ")

    _with_node(namespace, show)
    return 0


@click.command()
@click.argument("goal", default="")
@click.option("--priority", type=click.IntRange(-(2**31), 2**31 - 1), default=0, show_default=True, help="higher ones come first")
@click.option("--deadline", type=Seconds(0.001), help="seconds from now by which it must be reached")
@click.option("--policy", type=click.Choice(_POLICIES), default="default", show_default=True, help="what to do if others are in its way")
@namespace_option
@as_json_option
@command
def goal(*, goal: str, priority: int, deadline: float | None, policy: str, namespace: str, as_json: bool) -> int:
    """Have a GOAL reached: a condition in PDDL, or a name that the node knows; by default that of its problem.

    Prints what happens until the task is over. Ctrl-C cancels it.
    """
    console, task = SafeConsole(), uuid4()
    fields = {"goal": goal, "priority": priority, "deadline": deadline or 0.0, "policy": _POLICIES.index(policy)}

    async def print_events(heard: asyncio.Queue[Any]) -> None:
        lines = EventLines(console)
        while True:
            event = Event.of(await heard.get())
            if event.task == task and not as_json:
                _print_event(lines, event, "")

    async def achieve(node: NodeClient) -> Any:
        async with node.hearing(*_TRACE) as heard:
            printing = asyncio.create_task(print_events(heard))
            try:
                return await node.achieve(fields, task)
            finally:
                printing.cancel()

    outcome = _with_node(namespace, achieve)
    is_reached = outcome.kind is OutcomeKind.SUCCEEDED
    if as_json:
        trace = {"trace": [f"{event['kind']} {event['subject']} {event['text']}".strip() for event in outcome.result.get("trace", ())]}
        print(json.dumps({"task": str(task), "goal_reached": is_reached, **outcome.result, "message": outcome.message, **trace}))
    else:
        word = "[bold green]goal[/]     holds" if is_reached else "[bold red]goal[/]     not reached: "
        console.print(word, end="" if not is_reached else "\n")
        if not is_reached:
            console.print(outcome.message or outcome.kind.value, markup=False, highlight=False, soft_wrap=True)
    return 0 if is_reached else 1


@click.command()
@one_or_all
@click.option("--at-once", is_flag=True, help="cancel what is under way, in place of waiting for its end")
@command
def pause(task: str, every: bool, namespace: str, at_once: bool) -> int:
    """Pause a TASK, by the beginning of its id: nothing more is started. By default the only one that is going on."""
    return _command("pause", "paused", task, every=every, namespace=namespace, at_once=at_once)


@click.command()
@one_or_all
@command
def resume(task: str, every: bool, namespace: str) -> int:
    """Let a TASK go on that was paused."""
    return _command("resume", "goes on", task, every=every, namespace=namespace)


@click.command()
@one_or_all
@command
def cancel(task: str, every: bool, namespace: str) -> int:
    """Cancel a TASK, and wait until what its robots do is over."""
    return _command("cancel", "cancelled", task, every=every, namespace=namespace)


@click.command()
@click.argument("questions", nargs=-1)
@click.option("--add", multiple=True, metavar="FACT", help="record that it is so: '(at r1 hall)', '(= (battery r1) 0.8)'")
@click.option("--remove", multiple=True, metavar="FACT", help="record that it is not so")
@click.option("--forget", multiple=True, metavar="FACT", help="record that nothing is known of it")
@namespace_option
@as_json_option
@command
def facts(
    *, questions: tuple[str, ...], add: tuple[str, ...], remove: tuple[str, ...], forget: tuple[str, ...], namespace: str, as_json: bool
) -> int:
    """Print what the node knows: the answers to QUESTIONS such as '(at r1 hall)' or '(battery r1)', or everything."""
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
        print(json.dumps(known))
    else:
        print(*(f"{fact}  {value}" for fact, value in sorted(known.items())), sep="\n", end="\n" if known else "")
    return 0


def _with_node(namespace: str, work: Callable[[NodeClient], Awaitable[T]]) -> T:
    """Do the work with a client in the namespace of the node."""
    from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

    async def connected() -> T:
        ros = RosThread("pnm_client", namespace=namespace)
        try:
            from pnm.ros.node_client import NodeClient  # needs rclpy, which is there by now

            return await work(NodeClient(ros))
        finally:
            await asyncio.to_thread(ros.close)

    return run_async(connected())


def _command(name: str, done: str, prefix: str, *, every: bool, namespace: str, **fields: object) -> int:
    async def apply(node: NodeClient) -> str:
        task = None if every else await node.task(prefix)
        await node.command(name, task, **fields)
        return "all tasks" if task is None else task.hex[:8]

    print(f"{_with_node(namespace, apply)}: {done}")
    return 0


def _print_event(lines: EventLines, event: Event, label: str) -> None:
    if event.kind != "fired":
        lines.label = label
        lines.print(event.time, f"{event.kind:<7}", event.text)


def _print_status(console: Console, message: Any) -> None:
    if message.paused:
        console.print("paused: nothing is started")
    if not message.tasks:
        console.print("no tasks")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("task", "state", "goal", "ended", "under way, or why"):
        table.add_column(column, overflow="fold")
    for task in map(_task_data, message.tasks):
        why = ", ".join(task["running"]) or task["reason"]
        table.add_row(task["id"][:8], task["state"], task["goal"], str(task["ended"]), why)
    console.print(table, markup=False)


def _task_data(task: Any) -> dict[str, Any]:
    return {
        "id": str(UUID(bytes=bytes(task.id.uuid))),
        "goal": task.goal,
        "priority": task.priority,
        "state": TaskState(task.state).name.lower(),
        "reason": task.reason,
        "running": list(task.running),
        "ended": task.ended,
        "replans": task.replans,
    }
