"""`pnm serve`: a managed ROS 2 node that accepts goals and plans as tasks."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final
from uuid import UUID

from planner_bridge.loading import bindings_for, load
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan_world import names_of_world
from planner_bridge.model.problem import Problem
from planner_bridge.node.options import PARAMETERS, Options
from planner_bridge.node.problem_folder import ProblemFolder
from planner_bridge.node.problem_service import NOTHING, LoadedProblem, ServedProblem
from planner_bridge.node.world_queries import read_goals
from planner_bridge.planning.solve import check_planner
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.scheduling.task_manager import TaskLimits, TaskManager
from planner_bridge.tasks.settings import Settings
from pnm.actions.backend import check_ready
from pnm.clock import run_async, short_pauses
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.verification.verify import Proof
from pnm.errors import InputError, Tolerated
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import NO_SENSING
from pnm.knowledge.sources.registry import Surroundings, open_sources
from pnm.knowledge.sources.router import Sources
from pnm.knowledge.sources.source import Asker
from pnm.language.plan import merge_bindings, read_world, sources_of
from pnm.language.runner import PlanRunner, Program
from pnm.ros.backend import Ros2Backend
from pnm.ros.node.parameters import ParameterValue
from pnm.tasks import Make, ServedWorld, TaskListener, Tasks

NODE: Final = "pnm"
_PREPARED: Final = 1.0
"""Seconds to find the action servers that plans need; the node offers its plans then, even if some servers are missing."""
_CLOSING: Final = 0.5
"""Seconds more for tasks that did not end within the parameter ``cancel`` when the node is shut down."""


@dataclass(frozen=True)
class NodeContext:
    """The resources that all tasks of a node share."""

    options: Options
    problem: Problem | None
    runner: PlanRunner
    """Runs the plans of the world."""
    bindings: Bindings
    backend: Ros2Backend
    knowledge: KnowledgeBase
    sources: Sources


@dataclass(frozen=True)
class NodeApi:
    """What a node offers over ROS 2: tasks, plan requests, and the knowledge of its world."""

    tasks: Tasks
    make: Make
    world: ServedWorld
    knowledge_of: Callable[[UUID], tuple[Layered, Asker] | None]
    """Finds the run that sent a request."""
    close: Callable[[], Awaitable[None]]


class NodeObserver:
    """Follows the life cycle of a node: one empty method per event."""

    def unconfigured(self) -> None:
        """Note that the node waits for a lifecycle manager."""

    def tolerated(self, warnings: Iterable[Tolerated]) -> None:
        """Note what is doubtful in the files that were read."""

    def proved(self, plan: str, proof: Proof) -> None:
        """Note that the machine of a plan is verified."""

    def activated(self, actions: tuple[str, ...]) -> None:
        """Note that goals are accepted, by the action servers of these names."""

    def deactivated(self) -> None:
        """Note that goals are rejected and tasks are paused."""

    def missing(self, server: str) -> None:
        """Note that an action server that a plan needs is missing."""

    def failed(self, error: BaseException) -> None:
        """Note that the action servers that plans need cannot be used."""

    def listener(self, tasks: Tasks) -> TaskListener:
        """Return the listener for the events of tasks."""
        return TaskListener()


async def make_task_manager(context: NodeContext) -> NodeApi:
    """Make the task manager of a node and the problem that it serves."""
    options = context.options
    settings = Settings(
        options.planner,
        options.planner_timeout,
        options.improve,
        bindings=context.bindings,
        limits=Limits(replans=options.replans, patience=options.patience),
        on_failure=options.on_failure,
        on_change=options.on_change,
    )
    folder = ProblemFolder(options.problems, options.problem)
    goals = read_goals(options.goals) if options.goals else {}
    plans = [program.plan for program in context.runner.programs.values()]
    try:
        loaded = LoadedProblem(context.problem or NOTHING, context.knowledge, goals, settings, plans)
    except InputError as error:
        raise InputError(f"{options.goals}: {error}") from error
    manager = TaskManager(
        loaded.problem,
        context.knowledge,
        context.backend,
        settings,
        loaded.read_goal,
        source=context.sources,
        limits=TaskLimits(options.max_tasks, options.max_queue, options.on_conflict),
        runner=context.runner,
    )

    def begin_anew(problem: Problem) -> None:
        manager.begin_anew(problem)
        context.backend.declare(names_of_world(problem, plans))

    world = ServedProblem(loaded, folder, begin_anew)
    return NodeApi(manager, loaded.make, world, manager.knowledge_of, manager.close)


def serve(given: Mapping[str, ParameterValue], arguments: Sequence[str], observer: NodeObserver) -> None:
    """Serve until a signal, or a transition that shuts the node down; the second signal leaves at once.

    Args:
        given: parameters that differ from their defaults; ROS arguments override them.
        arguments: for ROS 2, beginning with ``--ros-args``, or none.

    Raises:
        InputError: a parameter or a file is wrong; nothing was served.
        RosError: ROS 2 is missing, or another process serves under the same names.
    """
    run_async(_serve(given, arguments, observer))


async def _serve(given: Mapping[str, ParameterValue], arguments: Sequence[str], observer: NodeObserver) -> None:
    from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

    task = asyncio.current_task()
    assert task is not None
    ros = RosThread(NODE, args=arguments, managed=True)
    try:
        await _run_lifecycle(ros, given, observer)
    except asyncio.CancelledError:
        task.uncancel()
    finally:
        await asyncio.to_thread(ros.close)


async def _run_lifecycle(ros: Any, given: Mapping[str, ParameterValue], observer: NodeObserver) -> None:
    from pnm.ros.node.lifecycle import Lifecycle  # here, because rclpy is an extra
    from pnm.ros.node.parameters import declare
    from pnm.ros.sim_time import follow_sim_time

    await follow_sim_time(ros)
    options = Options.of(await ros.ask(partial(declare, ros.node, PARAMETERS, given)))
    lifecycle = Lifecycle(ros, ServingNode(ros, options, observer))
    await lifecycle.open()
    try:
        if options.autostart:
            await lifecycle.change("configure")
            await lifecycle.change("activate")
        else:
            observer.unconfigured()
        with short_pauses():  # once more, with the files that have been read
            await lifecycle.finalized.wait()
    finally:
        await lifecycle.close()


class ServingNode:
    """The transitions of the node's life cycle, as `pnm.ros.node.lifecycle.ManagedTransitions`.

    The mutable state is the stack of open resources, the task node, and the names of its actions.
    """

    def __init__(self, ros: Any, options: Options, observer: NodeObserver) -> None:
        self._ros = ros
        self._options = options
        self._observer = observer
        self._open = AsyncExitStack()
        self._node: Any = None
        self._actions: tuple[str, ...] = ()

    async def configure(self) -> None:
        """Read and check all files, and bring up the actions, which reject goals until the node is activated."""
        async with AsyncExitStack() as stack:
            context = await self._open_context(stack)
            await self._open_node(context, stack)
            self._open = stack.pop_all()

    async def activate(self) -> None:
        """Accept goals, and resume tasks."""
        await self._node.activate()
        self._observer.activated(self._actions)

    async def deactivate(self) -> None:
        """Reject goals, and pause tasks."""
        await self._node.deactivate()
        self._observer.deactivated()

    async def cleanup(self) -> None:
        """Cancel tasks, and close all resources."""
        await self._open.aclose()

    async def _open_context(self, stack: AsyncExitStack) -> NodeContext:
        options = self._options
        cancel = threading.Event()
        try:
            await asyncio.to_thread(check_planner, options.planner, cancel)
        finally:
            cancel.set()
        world = read_world(options.world, options.world_name) if options.world else None
        plans = tuple(world.plans.values()) if world else ()
        problem = load(options.domain, options.problem) if options.domain and options.problem else None
        models = (*plans, *((problem,) if problem else ()))
        self._observer.tolerated(dict.fromkeys(warning for model in models for warning in model.warnings))
        programs = {plan.name: Program.of(plan) for plan in plans}
        for name, program in programs.items():
            self._observer.proved(name, program.proof)
        bindings = bindings_for(options.domain, options.bindings, problem.vocabulary if problem else None).before(merge_bindings(plans))
        knowledge = initial_knowledge(*((problem,) if problem else ()), *plans)
        sensing = read_sensing(options.sensing, problem.vocabulary if problem else None) if options.sensing else NO_SENSING
        backend = Ros2Backend(bindings, sensing, names_of_world(problem, plans), self._ros)
        stack.push_async_callback(backend.close)
        await backend.open(knowledge)
        folder = (options.world or options.domain or Path()).parent
        sources = open_sources(sources_of(plans), Surroundings(self._ros, folder), options.knowledge)
        stack.push_async_callback(sources.close)
        runner = PlanRunner(programs, backend, knowledge, sources)
        await check_ready(backend, runner.actions)
        return NodeContext(options, problem, runner, bindings, backend, knowledge, sources)

    async def _open_node(self, context: NodeContext, stack: AsyncExitStack) -> None:
        from pnm.ros.node.alone import check_alone  # here, because rclpy is an extra
        from pnm.ros.tasks.task_node import TaskNode, action_names

        runner = context.runner
        task_actions, plan_actions = await self._ros.ask(partial(action_names, self._ros, runner.programs))
        self._actions = (*task_actions, *plan_actions.values())
        await check_alone(self._ros, self._actions)
        api = await make_task_manager(context)

        def knowledge_of(request: UUID) -> tuple[Layered, Asker] | None:
            return runner.knowledge_of(request) or api.knowledge_of(request)

        await context.backend.share(runner.prefix, knowledge_of, context.sources)
        preparing = asyncio.ensure_future(runner.prepare())
        stack.callback(preparing.cancel)
        await asyncio.wait((preparing,), timeout=_PREPARED)
        if preparing.done():
            preparing.result()  # raises what is wrong
        preparing.add_done_callback(self._prepared)
        self._node = TaskNode(self._ros, api.tasks, api.make, api.world, plan_actions)
        # The stack closes in reverse: first the node, which gives tasks their time to end and answers all goals;
        # then what prints, so that it has seen every task end; then the task manager.
        stack.push_async_callback(_close_in_time, api.close)
        stack.callback(api.tasks.listen(self._observer.listener(api.tasks)))
        stack.push_async_callback(self._node.close, context.options.cancel)
        await self._node.open()

    def _prepared(self, preparing: asyncio.Future[tuple[str, ...]]) -> None:
        if preparing.cancelled():
            return
        if error := preparing.exception():
            self._observer.failed(error)
            return
        for name in preparing.result():
            self._observer.missing(name)


async def _close_in_time(close: Callable[[], Awaitable[None]]) -> None:
    """Close the task manager; tasks that have not ended by now are left alone."""
    with suppress(TimeoutError):
        async with asyncio.timeout(_CLOSING):
            await close()
