"""Runs without an executor: runs that have begun, what they command, and the resources they claim."""

from __future__ import annotations

from math import inf, nextafter
from uuid import UUID

from pnm.core.execution.events import Begin, Cancel, Command, Event, KnowledgeChanged, Send, Tick, Wake
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.requests import Accepted
from pnm.core.resources import Claim
from tests.support.runs.plan_graphs import plan

RUN = UUID(int=1)


def begun(
    graph: PlanGraph, bindings: Bindings | None = None, *, id: UUID = RUN, world: KnowledgeBase | None = None, **options: object
) -> tuple[Run, list[Command]]:
    """A run that has begun at 0 s, and its first commands."""
    run = Run(generate(graph, bindings), Layered(world or KnowledgeBase()), id=id, bindings=bindings, **options)  # type: ignore[arg-type]
    return run, run.handle(Begin(), 0.0)


def accepted(graph: PlanGraph | None = None, bindings: Bindings | None = None, *, at: float = 0.0, **options: object) -> Run:
    """A run whose first calls have been accepted; without a graph, of one call."""
    run, _ = begun(graph or plan(1), bindings, **options)  # type: ignore[arg-type]
    for request in run.open_requests:
        run.handle(Accepted(request), at)
    return run


def in_its_moment(run: Run, event: Event, now: float) -> list[Command]:
    """Handle an event and, as nothing else happens in its moment, what follows when that is over; all commands of both."""
    commands = run.handle(event, now)
    if Wake(nextafter(now, inf)) in commands:
        commands += run.handle(Tick(), nextafter(now, inf))
    return commands


def report(run: Run, fluent: Fluent, value: Value | Unknown, now: float) -> list[Command]:
    """Have sensors report a fact to a run, and nothing else happen in that moment; return all that is commanded."""
    run.knowledge.world.update({fluent: value})
    return in_its_moment(run, KnowledgeChanged(), now)


def sent(commands: list[Command]) -> list[str]:
    return [command.request.action.name for command in commands if isinstance(command, Send)]


def cancelled(commands: list[Command]) -> list[UUID]:
    return [command.request for command in commands if isinstance(command, Cancel)]


def claim(number: int, *names: str, priority: int = 0, task: int | None = None) -> Claim:
    return Claim(UUID(int=number if task is None else task), UUID(int=number), priority, names)
