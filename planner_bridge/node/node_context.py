"""The context of a node: what all of its tasks share, opened from its files when it is configured."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import names_of_world
from planner_bridge.node.fleet import DealtRobots
from planner_bridge.node.node_journal import checked_names, journal_of, origin_of, resume
from planner_bridge.node.node_log import NodeObserver
from planner_bridge.node.options import Options, RobotFiles
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import check_planner
from pnm.actions.backend import check_ready
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import Bindings
from pnm.files.database.place import Place
from pnm.journal.kept import Fenced
from pnm.journal.records import SharedBegan
from pnm.journal.replay import Replay
from pnm.knowledge.sources import Sources, Surroundings, open_sources
from pnm.language.plan import merge_bindings, read_world, sources_of
from pnm.language.runner import PREFIX, PlanRunner, Program
from pnm.ros.backend import Ros2Backend
from pnm.tasks import EVENTS


@dataclass(frozen=True)
class NodeContext:
    """The resources that all tasks of a node share."""

    options: Options
    files: RobotFiles
    problem: Problem | None
    runner: PlanRunner
    """Runs the plans of the world; its knowledge and journal are those of all tasks."""
    bindings: Bindings
    backend: Ros2Backend
    sources: Sources
    replay: Replay | None
    """The tasks that another process has begun, and that go on here."""
    actions: tuple[str, ...]
    """The actions of the node, those of plans among them."""
    plan_actions: Mapping[str, str]
    """The actions of plans, by plan."""
    origin: str
    """The source of the world at the start of the node."""
    robots: DealtRobots | None
    """The robots of a fleet, if the node serves a part of one."""
    place: Place | None
    """Where the tasks are kept."""

    def begin_journal(self, anew: Callable[[], None] = lambda: None, loaded: tuple[str, ...] = ()) -> None:
        """Begin the journal anew, in the world as `anew` leaves it; it is not that of the files if other domain and problem were loaded."""
        began = SharedBegan(self.runner.resources.capacities, self.runner.prefix, self.origin, loaded=loaded)
        self.runner.journal.begin(self.runner.world, self.runner.resources, anew, began)

    async def check(self, problem: Problem) -> Callable[[], Awaitable[None]]:
        """Refuse a problem that does not fit the robots that are there; return what has the sensors speak of its objects."""
        _, sensing = await asyncio.to_thread(self.files.read, problem.vocabulary, strangers=True)
        await self.backend.check_sensors(sensing, initial_knowledge(problem).objects)
        await check_ready(self.backend, self.runner.actions, self.names_of(problem))
        return partial(self.backend.sense_objects, sensing)

    def names_of(self, problem: Problem | None) -> Vocabulary:
        """Return the names of a problem and of the plans."""
        return names_of_world(problem, [program.plan for program in self.runner.programs.values()])


async def open_context(
    ros: Any, options: Options, observer: NodeObserver, fenced: Callable[[Fenced], None], stack: AsyncExitStack
) -> NodeContext:
    """Read and check all files of a node, and open what its tasks share."""
    cancel = threading.Event()
    try:
        await asyncio.to_thread(check_planner, options.planner, cancel)
    finally:
        cancel.set()
    world = read_world(options.world, options.world_name) if options.world else None
    plans = tuple(world.plans.values()) if world else ()
    problem = load(options.domain, options.problem) if options.domain and options.problem else None
    robots = DealtRobots.of(problem, options) if problem and options.part else None
    problem = robots.problem if robots else problem
    models = (*plans, *((problem,) if problem else ()))
    warnings = dict.fromkeys(warning for model in models for warning in model.warnings)
    observer.tolerated(warnings)
    for warning in warnings:
        EVENTS.warning("%s", warning)
    programs = {plan.name: Program.of(plan) for plan in plans}
    for name, program in programs.items():
        observer.proved(name, program.proof)
        EVENTS.info("plan %s: proved %s", name, program.proof)
    files = RobotFiles.of(options)
    own, sensing = files.read(problem.vocabulary if problem else None)
    bindings = own.before(merge_bindings(plans))
    node, domain_id = await ros.ask(lambda: (ros.node.get_fully_qualified_name(), ros.node.context.get_domain_id()))
    place = journal_of(options.journal, node, domain_id, origin := origin_of(options))
    if robots:
        robots.check(bindings)
        place, origin = robots.part.journal(place), f"{origin} {options.robots} {robots.part}"
    actions, plan_actions = await checked_names(ros, programs, place)
    journal, replay = await resume(options, place, node, origin, observer, fenced, stack)
    if replay and replay.shared and replay.shared.loaded:  # in place of that of the files
        domain, text = replay.shared.loaded
        problem = parse_problem(text, parse_domain(domain))
        own, sensing = files.read(problem.vocabulary, strangers=True)
        bindings = own.before(merge_bindings(plans))
    knowledge = replay.world if replay else initial_knowledge(*((problem,) if problem else ()), *plans)
    own_prefix = sha256(node.encode()).digest()[:PREFIX]
    prefix = (replay.shared.prefix if replay and replay.shared else b"") or own_prefix
    kept = replay.open_requests if replay else ()
    backend = Ros2Backend(bindings, sensing, names_of_world(problem, plans), ros, prefix=prefix, kept=kept, may_act=journal.may_act)
    stack.push_async_callback(backend.close)
    await backend.open(knowledge)
    folder = (options.world or options.domain or Path()).parent
    sources = open_sources(sources_of(plans), Surroundings(ros, folder), options.knowledge)
    stack.push_async_callback(sources.close)
    runner = PlanRunner(programs, backend, knowledge, sources, journal, replay)
    runner.prefix = prefix
    await check_ready(backend, runner.actions)
    context = NodeContext(options, files, problem, runner, bindings, backend, sources, replay, actions, plan_actions, origin, robots, place)
    if replay is None:
        context.begin_journal()
    return context
