"""`pnm serve`: a managed ROS 2 node that accepts goals and plans as tasks."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from planner_bridge.model.problem import Problem
from planner_bridge.node.fleet import FleetManager, open_fleet
from planner_bridge.node.node_context import NodeContext, open_context
from planner_bridge.node.node_log import NodeObserver, open_diagnoses
from planner_bridge.node.options import PARAMETERS, Options
from planner_bridge.node.problem_service import NOTHING, ProblemFolder, ServedProblem
from planner_bridge.node.spare_time import Foreteller, Learner, SpareTime
from planner_bridge.node.world_queries import SharedWorld, read_goals
from planner_bridge.pipeline.loading import RATES, rates_for
from planner_bridge.pipeline.odds import KnownRobots
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.clock import follow_real_time, run_async, short_pauses
from pnm.core.knowledge_base import KnowledgeBase
from pnm.errors import InputError, PnmError
from pnm.journal.kept import Fenced
from pnm.journal.replay import Replay
from pnm.ros.node.parameters import ParameterValue
from pnm.tasks import EVENTS, REMEMBERED, TaskEnding, Wanted

if TYPE_CHECKING:
    from pnm.ros.sim_time import SimClock


_log = logging.getLogger(__name__)

NODE: Final = "pnm"
_PREPARED: Final = 1.0
"""Seconds to find the action servers that plans need; the node offers its plans then, even if some servers are missing."""
_CLOSING: Final = 0.5
"""Seconds more for tasks that did not end within the parameter ``cancel`` when the node is shut down."""


def kept_tasks(replay: Replay | None) -> list[tuple[Wanted, TaskEnding | None]]:
    """Return the tasks that go on here, and those that ended last, whose clients may still ask for their results."""
    tasks = [(task.accepted.wanted, task.ending) for task in replay.tasks.values()] if replay else []
    ended = [task for task in tasks if task[1] is not None]
    return [*ended[-REMEMBERED:], *(task for task in tasks if task[1] is None)]


def make_task_manager(context: NodeContext) -> tuple[TaskManager, ServedProblem]:
    """Make the task manager of a node and the problem that it serves."""
    options, bindings = context.options, context.bindings
    learned = rates_for(options.domain, options.rates, grows=options.learn)
    if options.learned_limits and context.problem:
        bindings = learned.limiting(bindings, context.problem.domain.actions)
    settings = Settings(
        options.planner,
        options.planner_timeout,
        options.improve,
        bindings=bindings,
        learned=learned,
        limits=Limits(options.replans, options.without_progress, patience=options.patience),
        on_failure=options.on_failure,
        on_change=options.on_change,
    )
    folder = ProblemFolder(options.problems, options.problem)
    goals = context.robots.goals if context.robots else read_goals(options.goals) if options.goals else {}
    plans = [program.plan for program in context.runner.programs.values()]

    def begin_anew(problem: Problem, initial: KnowledgeBase) -> None:
        manager.begin_anew(problem)  # may refuse, so it comes before the first change
        new = SharedWorld(problem, initial)
        replace = partial(context.runner.world.begin_anew, initial.facts(), initial.objects_by_type(), initial.rules)
        context.begin_journal(replace, (new.domain_text(), new.problem_text()))
        context.backend.declare(context.names_of(problem))

    problem, began = context.problem or NOTHING, context.replay.began if context.replay else None
    try:
        world = ServedProblem(
            problem, context.runner.world, settings, folder, begin_anew, goals=goals, plans=plans, began=began, check=context.check
        )
    except InputError as error:
        raise InputError(f"{options.goals}: {error}") from error
    limits = TaskLimits(options.max_tasks, options.max_queue, options.on_conflict)
    helper = context.sources if options.ask_for_help else None
    make = partial(FleetManager, context.robots, open_fleet(options)) if context.robots else TaskManager
    manager = make(problem, context.runner, settings, world.read_goal, helper=helper, limits=limits)
    return manager, world


def serve(given: Mapping[str, ParameterValue], arguments: Sequence[str], observer: NodeObserver) -> None:
    """Serve until a signal, or a transition that shuts the node down; the second signal leaves at once.

    Args:
        given: parameters that differ from their defaults; ROS arguments override them.
        arguments: for ROS 2, beginning with ``--ros-args``, or none.

    Raises:
        InputError: a parameter or a file is wrong; nothing was served.
        RosError: ROS 2 is missing, or another process serves under the same names.
    """

    async def serving() -> None:
        from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

        task = asyncio.current_task()
        assert task is not None
        async with RosThread(NODE, args=arguments, managed=True) as ros:
            try:
                await _run_lifecycle(ros, given, observer)
            except PnmError as error:  # which the command prints, and nothing else
                EVENTS.error("%s", error)
                raise
            except asyncio.CancelledError:
                task.uncancel()

    run_async(serving())


async def _run_lifecycle(ros: Any, given: Mapping[str, ParameterValue], observer: NodeObserver) -> None:
    from pnm.ros.node.lifecycle import Lifecycle  # here, because rclpy is an extra
    from pnm.ros.node.parameters import declare
    from pnm.ros.sim_time import follow_sim_time

    clock = await follow_sim_time(ros)
    options = Options.of(await ros.ask(partial(declare, ros.node, PARAMETERS, given)))
    serving = ServingNode(ros, options, observer, clock)
    lifecycle = Lifecycle(ros, serving)
    await lifecycle.open()
    try:
        if options.autostart:
            await lifecycle.change("configure")
            await lifecycle.change("activate")
        else:
            observer.unconfigured()
            EVENTS.info("unconfigured: waits for its transitions")
        with short_pauses():  # once more, with the files that have been read
            finalized = asyncio.ensure_future(lifecycle.finalized.wait())
            await asyncio.wait((finalized, serving.fenced), return_when=asyncio.FIRST_COMPLETED)
            if serving.fenced.done():
                raise serving.fenced.result()
    finally:
        await lifecycle.close()


class ServingNode:
    """The transitions of the node's life cycle, as `pnm.ros.node.lifecycle.ManagedTransitions`.

    The mutable state is the stack of open resources, the task node, and the names of its actions.
    """

    def __init__(self, ros: Any, options: Options, observer: NodeObserver, clock: SimClock | None = None) -> None:
        self._ros = ros
        self._clock = clock
        self._options = options
        self._observer = observer
        self._open = AsyncExitStack()
        self._node: Any = None
        self._state = "inactive"
        self._actions: tuple[str, ...] = ()
        self._restore: Callable[[], None] | None = None
        self.fenced: asyncio.Future[Fenced] = asyncio.get_running_loop().create_future()
        """Done when another node has taken the journal over."""

    async def configure(self) -> None:
        """Read and check all files, and bring up the actions, which reject goals until the node is activated."""
        if self._clock is not None:
            self._clock.follow()
        async with AsyncExitStack() as stack:
            context = await open_context(self._ros, self._options, self._observer, self.fenced.set_result, stack)
            self._actions = context.actions
            await self._open_node(context, stack)
            self._open = stack.pop_all()

    async def activate(self) -> None:
        """Accept goals, and resume tasks."""
        await self._node.activate()
        self._state = "active"
        self._observer.activated(self._actions)
        EVENTS.info("active: goals are accepted by %s", ", ".join(self._actions))
        if self._restore is not None:
            self._restore()  # once: a node that was deactivated has its tasks still
            self._restore = None

    async def deactivate(self) -> None:
        """Reject goals, and pause tasks."""
        await self._node.deactivate()
        self._state = "inactive"
        self._observer.deactivated()
        EVENTS.warning("inactive: goals are rejected, and tasks are paused")

    async def cleanup(self) -> None:
        """Cancel tasks, and close all resources. What another node has taken over is left alone: it goes on there.

        All limits of this are on real time: a simulation may have ended before.
        """
        follow_real_time()
        if self.fenced.done():
            self._open.pop_all()
        await self._open.aclose()

    async def _open_node(self, context: NodeContext, stack: AsyncExitStack) -> None:
        from pnm.ros.tasks.task_node import TaskNode  # here, because rclpy is an extra

        runner = context.runner
        manager, world = make_task_manager(context)

        def prepared(preparing: asyncio.Future[tuple[str, ...]]) -> None:
            if preparing.cancelled():
                return
            if error := preparing.exception():
                self._observer.failed(error)
                EVENTS.error("%s", error)
                return
            for name in preparing.result():
                self._observer.missing(name)
                EVENTS.warning("there is no action server %s yet", name)

        def restore() -> None:
            if (replay := context.replay) is not None:
                manager.restore(replay)
                self._node.restored(replay.is_held, {task.accepted.wanted.id for task in replay.unfinished if task.is_held})
            if isinstance(manager, FleetManager):
                stack.callback(asyncio.ensure_future(manager.attend()).cancel)

        await context.backend.share(runner.prefix, runner.knowledge_of, context.sources)
        preparing = asyncio.ensure_future(runner.prepare())
        stack.callback(preparing.cancel)
        await asyncio.wait((preparing,), timeout=_PREPARED)
        if preparing.done():
            preparing.result()  # raises what is wrong
        preparing.add_done_callback(prepared)
        kept = manager.go_on() if isinstance(manager, FleetManager) else kept_tasks(context.replay)
        self._node = TaskNode(self._ros, manager, world, context.plan_actions, kept)
        self._restore = restore
        look = partial(context.backend.look, runner.actions)
        await open_diagnoses(stack, self._ros, look, manager, lambda: self._state, self._clock, runner.journal, self._options)
        self._observer.configured(manager, self._node, world)

        beside_tasks: list[SpareTime] = []
        if self._options.learn and context.place is not None:
            beside = self._options.domain or self._options.world
            assert beside is not None
            beside_tasks.append(Learner(context.place, self._options.rates or beside.parent / RATES))
        if self._options.odds and (known := KnownRobots(manager.settings.learned)):
            beside_tasks.append(Foreteller(manager, known, runner.world))
        for work in beside_tasks:
            manager.listen(work)
            stack.push_async_callback(work.close)

        # The stack closes in reverse: first the node, which gives tasks their time to end and answers all goals; then the task manager.
        async def close() -> None:  # tasks that have not ended by now are left alone
            with suppress(TimeoutError):
                async with asyncio.timeout(_CLOSING):
                    await manager.close()

        stack.push_async_callback(close)
        stack.push_async_callback(self._node.close, context.options.cancel)
        await self._node.open()
