"""`pnm serve`: a managed node that takes goals and plans over ROS 2, until somebody ends it."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias
from uuid import UUID

from planner_bridge.cli.console import TaskConsole, Terminal
from planner_bridge.loading import load
from planner_bridge.model.problem import Problem
from planner_bridge.node.initial_world import common_knowledge
from planner_bridge.node.options import PARAMETERS, Options
from planner_bridge.node.problem_service import NOTHING, ServedProblem
from planner_bridge.node.world_queries import read_goals
from planner_bridge.planning.solve import check_planner
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.scheduling.task_manager import CurrentProblem, TaskLimits, TaskManager
from planner_bridge.tasks.settings import Settings
from pnm.actions.bindings_file import read_bindings
from pnm.clock import short_pauses
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError, Tolerated
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import NO_SENSING
from pnm.knowledge.sources.registry import Surroundings, open_sources
from pnm.knowledge.sources.router import Sources
from pnm.knowledge.sources.source import Asker
from pnm.language.plan import all_bindings, all_sources, read_world
from pnm.language.runner import Performer, Program
from pnm.ros.backend import Ros2Site
from pnm.ros.node.parameters import ParameterValue
from pnm.tasks import Make, ServedWorld, Tasks

Warn: TypeAlias = Callable[[Iterable[Tolerated]], None]

NODE: Final = "pnm"
_PREPARED: Final = 1.0
"""Seconds in which the action servers that are there are found; plans are offered before those come that are not there yet."""

_LET_GO: Final = 0.5
"""Seconds for tasks that have had their time to end when the node is shut down."""


@dataclass(frozen=True)
class Room:
    """What all tasks of the node share."""

    options: Options
    problem: Problem | None
    performer: Performer
    """Of the plans of the world."""
    bindings: Bindings
    site: Ros2Site
    knowledge: KnowledgeBase
    sources: Sources


@dataclass(frozen=True)
class Opened:
    """Who pursues goals, and what else the node offers besides."""

    tasks: Tasks
    make: Make
    world: ServedWorld
    knowledge_of: Callable[[UUID], tuple[Layered, Asker] | None]
    """Finds the run whose request it is."""
    close: Callable[[], Awaitable[None]]


async def open_tasks(room: Room) -> Opened:
    """Return who pursues goals and carries out plans. This is the one place where it is made."""
    options = room.options
    settings = Settings(
        options.planner,
        options.planner_timeout,
        bindings=room.bindings,
        limits=Limits(replans=options.replans),
        on_failure=options.on_failure,
        on_change=options.on_change,
    )
    goals = read_goals(options.goals) if options.goals else {}
    try:
        plans = [program.plan for program in room.performer.programs.values()]
        current = CurrentProblem(room.problem or NOTHING)
        world = ServedProblem(current, room.knowledge, goals, settings, options.problems, plans)
    except InputError as error:
        raise InputError(f"{options.goals}: {error}") from error
    limits = TaskLimits(options.max_tasks, options.max_queue, options.on_conflict)
    manager = TaskManager(
        current, room.knowledge, room.site, settings, world.read_goal, source=room.sources, limits=limits, performer=room.performer
    )
    return Opened(manager, world.make, world, manager.knowledge_of, manager.close)


def serve(given: Mapping[str, ParameterValue], arguments: Sequence[str], terminal: Terminal, warn: Warn) -> None:
    """Serve until SIGINT or SIGTERM, or a transition that shuts the node down; the second signal leaves at once.

    Args:
        given: parameters that are not as they are by default; what ROS says about them comes before.
        arguments: for ROS 2, beginning with ``--ros-args``, or none.
        terminal: where people read along.
        warn: is told what in the files was not as it should be.

    Raises:
        InputError: a parameter or a file is wrong; nothing was served.
        RosError: ROS 2 is not there, or somebody else serves the same.
    """
    asyncio.run(_serve(given, arguments, terminal, warn))


async def _serve(given: Mapping[str, ParameterValue], arguments: Sequence[str], terminal: Terminal, warn: Warn) -> None:
    from pnm.ros.node.ros_thread import RosThread

    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    ros = RosThread(NODE, args=arguments, managed=True)
    try:
        await _live(ros, given, terminal, warn)
    except asyncio.CancelledError:
        task.uncancel()
    finally:
        await asyncio.to_thread(ros.close)


async def _live(ros: Any, given: Mapping[str, ParameterValue], terminal: Terminal, warn: Warn) -> None:
    from pnm.ros.node.lifecycle import Lifecycle  # here, because rclpy is an extra
    from pnm.ros.node.parameters import declare

    options = Options.of(await ros.ask(partial(declare, ros.node, PARAMETERS, given)))
    lifecycle = Lifecycle(ros, Serving(ros, options, terminal, warn))
    await lifecycle.open()
    try:
        if options.autostart:
            await lifecycle.change("configure")
            await lifecycle.change("activate")
        else:
            terminal.print("unconfigured: waits for its transitions", highlight=False)
        with short_pauses():
            await lifecycle.finalized.wait()
    finally:
        await lifecycle.close()


class Serving:
    """What the node does in each state of its life cycle.

    The mutable state is what is open, in the order in which it was opened; what tasks are offered with; and the names of the actions.
    """

    def __init__(self, ros: Any, options: Options, terminal: Terminal, warn: Warn) -> None:
        self._ros = ros
        self._options = options
        self._terminal = terminal
        self._warn = warn
        self._open = AsyncExitStack()
        self._tasks: Any = None
        self._names: tuple[str, ...] = ()

    async def configure(self) -> None:
        """Read and check all files, and bring up what rejects goals until the node is activated."""
        async with AsyncExitStack() as stack:
            room = await self._room(stack)
            await self._offer(room, stack)
            self._open = stack.pop_all()

    async def activate(self) -> None:
        """Take goals, and let tasks go on."""
        await self._tasks.activate()
        self._say(f"ready: {len(self._names)} action servers: {', '.join(self._names)}")

    async def deactivate(self) -> None:
        """Reject goals, and pause tasks."""
        await self._tasks.deactivate()
        self._say("inactive: goals are rejected, and tasks are paused")

    async def cleanup(self) -> None:
        """Cancel tasks, and let go of everything."""
        await self._open.aclose()

    async def _room(self, stack: AsyncExitStack) -> Room:
        options = self._options
        await _check_planner(options.planner)
        world = read_world(options.world, options.world_name) if options.world else None
        plans = tuple(world.plans.values()) if world else ()
        problem = load(options.domain, options.problem) if options.domain and options.problem else None
        self._warn(dict.fromkeys(warning for one in (*plans, *((problem,) if problem else ())) for warning in one.warnings))
        programs = {plan.name: Program.of(plan) for plan in plans}
        for name, program in programs.items():
            self._terminal.print(f"[bold]plan[/]     {name}: proved {program.proof}", highlight=False, soft_wrap=True)
        bindings = _bindings(options, problem).before(all_bindings(plans))
        knowledge = common_knowledge(plans, problem)
        sensing = read_sensing(options.sensing, problem.vocabulary if problem else None) if options.sensing else NO_SENSING
        site = Ros2Site(bindings, sensing, self._ros)
        stack.push_async_callback(site.close)
        await site.open(knowledge)
        folder = (options.world or options.domain or Path()).parent
        sources = open_sources(all_sources(plans), Surroundings(self._ros, folder), options.knowledge)
        stack.push_async_callback(sources.close)
        return Room(options, problem, Performer(programs, site, knowledge, sources), bindings, site, knowledge, sources)

    async def _offer(self, room: Room, stack: AsyncExitStack) -> None:
        from pnm.ros.action_server.goal_server import check_alone  # here, because rclpy is an extra
        from pnm.ros.tasks.task_node import TaskNode, action_names

        tasks, plans = await self._ros.ask(partial(action_names, self._ros, room.performer.programs))
        self._names = (*tasks, *plans.values())
        await check_alone(self._ros, self._names)
        opened = await open_tasks(room)
        await self._share(room, opened)
        await self._prepare(room.performer, stack)
        self._tasks = TaskNode(self._ros, opened.tasks, opened.make, opened.world, plans)
        stack.push_async_callback(_let_go, opened.close)
        stack.callback(opened.tasks.listen(TaskConsole(self._terminal, opened.tasks)))
        stack.push_async_callback(self._tasks.close, room.options.cancel)
        await self._tasks.open()

    async def _share(self, room: Room, opened: Opened) -> None:
        """Let action servers ask what whoever has sent them a goal knows."""

        def find(request: UUID) -> tuple[Layered, Asker] | None:
            found = room.performer.knowledge_of(request)
            return opened.knowledge_of(request) if found is None else found

        await room.site.share(room.performer.prefix, find, room.sources)

    async def _prepare(self, performer: Performer, stack: AsyncExitStack) -> None:
        """Look for the action servers that the plans need, and tell later which are missing."""
        preparing = asyncio.ensure_future(performer.prepare())
        stack.callback(preparing.cancel)
        await asyncio.wait((preparing,), timeout=_PREPARED)
        if preparing.done():
            preparing.result()  # raises what is wrong
        preparing.add_done_callback(self._miss)

    def _miss(self, preparing: asyncio.Future[tuple[str, ...]]) -> None:
        if preparing.cancelled():
            return
        if error := preparing.exception():
            self._terminal.print(f"[bold red]wrong[/]    {error}", highlight=False, soft_wrap=True)
            return
        for name in preparing.result():
            self._terminal.print(f"[bold yellow]missing[/]  there is no action server {name} yet", highlight=False, soft_wrap=True)

    def _say(self, text: str) -> None:
        self._terminal.print(text, highlight=False, soft_wrap=True, markup=False)


async def _check_planner(planner: str) -> None:
    cancel = threading.Event()
    try:
        await asyncio.to_thread(check_planner, planner, cancel)
    finally:
        cancel.set()


async def _let_go(close: Callable[[], Awaitable[None]]) -> None:
    """Close what pursues tasks; those that have not ended in their time by now are not waited for."""
    with suppress(TimeoutError):
        async with asyncio.timeout(_LET_GO):
            await close()


def _bindings(options: Options, problem: Problem | None) -> Bindings:
    beside = options.domain.parent / "bindings.yaml" if options.domain else None
    file = options.bindings or (beside if beside and beside.is_file() else None)
    return read_bindings(file, problem.vocabulary if problem else None) if file else Bindings()
