"""`pnm demo`: two robots deliver parcels, a way is blocked, and the goal is reached all the same.

`pnm demo mall`: a visitor asks a robot for the way, interrupts it, chats, answers late; and everything comes to its end. Robot, node
and visitor are processes of their own, over real ROS 2. The programs of robot and visitor lie beside the domain.
"""

from __future__ import annotations

import asyncio
import json
import os
import tempfile
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from rich.markup import escape
from rich.text import Text

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.run_console import ConsoleObserver, print_result
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.settings import Settings
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import read_faults
from pnm.clock import run_async
from pnm.core.logic.conditions import conjuncts
from pnm.errors import installation
from pnm.files.process import own_environment, own_python

_PACKAGE: Final = Path(__file__).parents[1]


def examples() -> Path:
    """Return the folder with `domains` and `problems`: of the checkout, or as installed."""
    return _PACKAGE / "examples" if (_PACKAGE / "examples").is_dir() else _PACKAGE.parent


def show_delivery(console: SafeConsole) -> int:
    """Run the delivery example with its faults and explain what is shown."""
    domain, problems = examples() / "domains" / "delivery", examples() / "problems" / "delivery"
    problem = load(domain / "domain.pddl", problems / "p01.pddl")
    settings = Settings(bindings=read_bindings(domain / "bindings.yaml", problem.vocabulary))
    faults = read_faults(problems / "faults.yaml", problem.vocabulary)
    backend = simulated_backend(problem, settings.bindings, faults)
    world = backend.robots.world

    console.print_text("Two robots and a goal, written in PDDL. A planner finds the plan; the plan becomes a Petri Net Machine.")
    for fault in faults.faults:
        console.print_text(f"The robots are simulated, and something will go wrong: {fault.what} fails, {fault.message}.")
    console.print_text(" ".join(map(str, conjuncts(problem.goal))), "[bold]goal[/]     ")
    result = run_async(achieve_at(backend, problem, settings, ConsoleObserver(console, settings.planner_timeout)), virtual=True)
    print_result(console, result)
    console.print_text("In the simulated world, which nobody but the simulation sees:")
    for part in conjuncts(problem.goal):
        console.print(Text(f"         {part} is ").append(*(("true", "green") if world.holds(part) else ("false", "red"))))
    advice = "pnm run DOMAIN PROBLEM with your own files, or pnm plan DOMAIN PROBLEM --format svg -o plan.svg to see a plan"
    console.print_text(f"Next: {advice}.")
    return 0 if result.goal_reached and world.holds(problem.goal) else 1


SPEED: Final = "1.2"
"""The speed of the robot relative to real time."""
BEGINNING: Final = 60.0
"""Seconds that a process may take until it is ready."""
LIMIT: Final = 120.0
"""Seconds that everything may take."""
SCRIPT: Final = {
    "late": 6.0,
    "patience": 60.0,
    "scripts": [
        {
            "name": "demo",
            "visitor": "ann",
            "requests": [
                {"shop": "shop_0", "replies": ["no"]},
                {"shop": "shop_1", "replies": ["late"], "on": "describe_route", "after": 0.8},
                {"topic": "films", "turns": 2, "replies": [], "on": "question", "after": 0.8},
            ],
        }
    ],
}
_SPEECH: Final = {"describe_route": "The way to {1} is as follows …", "ask_understood": "Do you know the way to {1} now?", "say": "{0}"}
"""The words of the robot at the beginning of an action, given its arguments."""
_STATES: Final = {"RUNNING": "green", "PAUSED": "yellow", "OVER": "bold green"}
"""The states of tasks that are printed, and their colours."""


def show_mall(console: SafeConsole) -> int:
    """Play the script, and print what there is to see."""
    needed = {"rclpy": installation("ros2"), "pnm_interfaces": "pip install ./ros/pnm_interfaces"}
    missing = [advice for module, advice in needed.items() if find_spec(module) is None]
    if missing:
        console.print(f"This demo needs ROS 2 and our interfaces: {' && '.join(missing)}")
        return 1
    return asyncio.run(_play(console))


async def _play(console: SafeConsole) -> int:
    console.print_text("A robot in a mall, over ROS 2. Every request is a task of its own; all share the robot's voice and arm.")
    story = StoryPrinter(console)
    try:
        async with asyncio.timeout(LIMIT), AsyncExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            script = Path(folder) / "script.json"
            script.write_text(json.dumps(SCRIPT), encoding="utf-8")
            domain, problem = examples() / "domains" / "mall", examples() / "problems" / "mall" / "p01.pddl"
            robot = await _start(stack, str(domain / "robot.py"), SPEED)
            world = ("--world", str(domain / "plans" / "world.yaml"))
            node = await _start(
                stack, "-m", "planner_bridge", "serve", str(domain / "domain.pddl"), str(problem), *world, "--journal", "none"
            )
            await asyncio.gather(_ready(robot, "the robot"), _ready(node, "the node"))
            visitor = await _start(stack, str(domain / "visitor.py"), str(script))
            quiet = asyncio.ensure_future(_each(node, lambda _: None))  # a full pipe would block it
            stack.callback(quiet.cancel)
            doing = asyncio.ensure_future(_each(robot, story.done))
            stack.callback(doing.cancel)
            await _each(visitor, story.seen)
            if await visitor.wait():
                raise ChildProcessError("the visitor has found nobody")
    except (TimeoutError, ChildProcessError) as error:
        console.print_text(str(error) or f"it is not over after {LIMIT:g} s", "[bold red]failed[/]   ")
        return 1
    story.sum_up()
    return 0 if story.reached == story.requests > 0 and not story.clashes else 1


async def _start(stack: AsyncExitStack, *arguments: str) -> Process:
    own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID") or str(os.getpid() % 100 + 1)}
    process = await asyncio.create_subprocess_exec(
        *own_python(*arguments), env=own_environment(**own), stdin=DEVNULL, stdout=PIPE, stderr=DEVNULL
    )

    async def end() -> None:
        if process.returncode is None:
            process.kill()
            await process.wait()

    stack.push_async_callback(end)
    return process


async def _lines(process: Process) -> AsyncIterator[str]:
    assert process.stdout is not None
    while line := await process.stdout.readline():
        yield line.decode(errors="replace")


async def _ready(process: Process, who: str) -> None:
    async with asyncio.timeout(BEGINNING):
        async for line in _lines(process):
            if line.startswith("ready"):
                return
    raise ChildProcessError(f"{who} has not started")


async def _each(process: Process, hear: Any) -> None:
    async for line in _lines(process):
        if line.startswith("{"):
            hear(json.loads(line))


@dataclass
class StoryPrinter:
    """Prints who speaks, and the states of tasks. All fields but the first change."""

    console: SafeConsole
    began: float | None = None
    names: dict[str, str] = field(default_factory=dict)
    """The subjects of tasks, by their ids."""
    states: dict[str, str] = field(default_factory=dict)
    paused: int = 0
    requests: int = 0
    reached: int = 0
    answers: int = 0
    clashes: int = 0

    def done(self, line: Mapping[str, Any]) -> None:
        """Print the acts of the robot."""
        self.clashes += "clash" in line
        name, _, arguments = line["call"].rstrip(")").partition("(")
        if line["event"] == "start" and name in _SPEECH:
            self._print(line, "[bold cyan]robot[/]  ", f'"{_SPEECH[name].format(*arguments.split(", "))}"')
        elif line["event"] == "start" and name == "point_at":
            self._print(line, "[bold cyan]robot[/]  ", f"points at {arguments.split(', ')[-1]}")
        elif line["event"] == "end" and line["outcome"] == "canceled":
            self._print(line, "[bold cyan]robot[/]  ", f"breaks off: {name}({arguments})")

    def seen(self, line: Mapping[str, Any]) -> None:
        """Print the acts and the view of the visitor."""
        match line["event"]:
            case "request":
                self.requests += 1
                shop = line["about"].startswith("shop")
                said = f"Where is {line['about']}?" if shop else f"Let us talk about {line['about']}!"
                self._print(line, "[bold magenta]ann  [/]  ", f'"{said}"')
            case "accepted":
                self.names[line["task"]] = line["about"]
            case "answer":
                self.answers += 1
                self._print(line, "[bold magenta]ann  [/]  ", f'"{line["value"].rpartition(" ")[0]}"  (about {line["about"]})')
            case "result":
                self.reached += line["reason"] == "goal_reached"
            case "state" if line["state"] in _STATES and self.states.get(line["task"]) != line["state"]:
                task, state = line["task"], line["state"]
                resumed = self.states.get(task) == "PAUSED" and state == "RUNNING"
                self.states[task] = state
                self.paused += state == "PAUSED"
                word = "resumed" if resumed else state.lower()
                about = escape(self.names.get(task, line["about"]))
                self._print(line, f"[bold]task [/]  [{_STATES[state]}]{about}: {word}[/]{', ' if line['reason'] else ''}", line["reason"])

    def _print(self, line: Mapping[str, Any], who: str, text: str) -> None:
        if self.began is None:
            self.began = line["time"]
        self.console.print_text(text, f"  {line['time'] - self.began:6.2f} s  {who}")

    def sum_up(self) -> None:
        """Print the sums."""
        self.console.print_text(
            f"{self.reached} of {self.requests} tasks reached their goal; {self.paused} times one was paused and resumed by itself; "
            f"{self.answers} answers found their question; {self.clashes} times voice or arm were used by two."
        )
