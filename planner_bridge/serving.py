"""`pnm serve`: the plans of a world as ROS 2 action servers, until somebody ends it."""

from __future__ import annotations

import asyncio
import re
import signal
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from planner_bridge.console import ConsoleObserver, Terminal
from planner_bridge.written import sources_of, together
from pnm.errors import InputError
from pnm.expressions import Fluent, Value, show
from pnm.knowledge import KnowledgeBase
from pnm.language.plan import HandWrittenPlan
from pnm.language.world import World
from pnm.performing import Performer, Program
from pnm.ros.served_goals import Audience, Ending, ServedGoal
from pnm.rules import Rule, Rules
from pnm.sites import Ros2Site
from pnm.sources.registry import Surroundings, open_sources

_PREPARED: Final = 1.0
"""Seconds in which the action servers that are there are found; plans are offered before those come that are not there yet."""
_SHOWN: Final = 200
"""Characters of parameters and results that a line shows."""


def serve(world: World, folder: Path, knowledge: Path | None, terminal: Terminal) -> None:
    """Serve until SIGINT or SIGTERM; the second one leaves at once.

    Args:
        world: what is served.
        folder: what paths in its files are relative to.
        knowledge: the file in which global knowledge is kept, in place of what the world chose.
        terminal: where people read along.

    Raises:
        InputError: a name or a type is wrong; nothing was served.
        RosError: ROS 2 is not there, or somebody else serves these plans.
    """
    programs = {name: Program.of(plan) for name, plan in world.plans.items()}
    for name, program in programs.items():
        terminal.print(f"[bold]plan[/]     {name}: proved {program.proof}", highlight=False, soft_wrap=True)
    asyncio.run(_serve(world, programs, folder, knowledge, terminal))


async def _serve(world: World, programs: Mapping[str, Program], folder: Path, knowledge: Path | None, terminal: Terminal) -> None:
    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    plans = tuple(world.plans.values())
    site = Ros2Site(together(plans), "pnm_" + re.sub(r"\W", "_", world.name, flags=re.ASCII))
    shared = common_knowledge(plans)
    try:
        await site.open(shared)
        sources = open_sources(sources_of(plans), Surroundings(site.ros, folder), knowledge)
        try:
            await _offer(Performer(programs, site, shared, sources), site, terminal)
        finally:
            await sources.close()
    except asyncio.CancelledError:
        task.uncancel()
    finally:
        await site.close()


async def _offer(performer: Performer, site: Ros2Site, terminal: Terminal) -> None:
    from pnm.ros.plan_servers import PlanServers  # here, because rclpy is an extra

    servers = PlanServers(site.ros, performer, Reporter(terminal))
    names = await servers.names()
    preparing = asyncio.ensure_future(performer.prepare())
    try:
        await asyncio.wait((preparing,), timeout=_PREPARED)
        if preparing.done():
            preparing.result()  # raises what is wrong
        await servers.open(names)
        terminal.print(f"ready: {len(names)} action servers: {', '.join(names.values())}", highlight=False, soft_wrap=True, markup=False)
        for name in await preparing:
            terminal.print(f"[bold yellow]missing[/]  there is no action server {name} yet", highlight=False, soft_wrap=True)
        await asyncio.Event().wait()
    finally:
        preparing.cancel()
        await servers.close()


def common_knowledge(plans: Iterable[HandWrittenPlan]) -> KnowledgeBase:
    """Return the world that all runs share, which begins as the plans say.

    Raises:
        InputError: two plans say different things.
    """
    facts: dict[Fluent, Value] = {}
    said: dict[Fluent, str] = {}
    objects: dict[str, tuple[str, ...]] = {}
    rules: dict[str, Rule] = {}
    for plan in plans:
        for fluent, value in plan.facts.items():
            if facts.setdefault(fluent, value) != value:
                raise InputError(f"{said[fluent]} and {plan.name} begin with different values of {show(fluent)}: {facts[fluent]}, {value}")
            said.setdefault(fluent, plan.name)
        for kind, names in plan.objects.items():
            objects[kind] = tuple(dict.fromkeys((*objects.get(kind, ()), *names)))
        rules |= {str(rule): rule for rule in plan.rules.rules}
    return KnowledgeBase(facts, objects=objects, rules=Rules(tuple(rules.values())))


class Reporter(Audience):
    """Prints a line per moment of every goal. The mutable state is the lines' common beginning of time."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self._began = asyncio.get_running_loop().time()
        self._goals: dict[ServedGoal, ConsoleObserver] = {}

    def began(self, goal: ServedGoal) -> ConsoleObserver:
        """Print that a goal was accepted."""
        observer = self._goals[goal] = ConsoleObserver(self._terminal, f"{goal.plan} {goal.id.hex[:8]}  ", self._began)
        observer.line(asyncio.get_running_loop().time(), "[bold]goal[/]  ", _shortened(goal.parameters or "{}"))
        return observer

    def ended(self, goal: ServedGoal, ending: Ending) -> None:
        """Print how a goal ended."""
        word = "[bold green]reached[/]" if ending.success else "[bold red]ended[/]  "
        said = _shortened(", ".join(f"{name}: {value}" for name, value in ending.results.items())) if ending.success else ending.message
        self._goals.pop(goal).line(asyncio.get_running_loop().time(), word, said)


def _shortened(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
