"""Runs and executors that hand over to others, and a server that answers when it is told to."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from uuid import UUID

from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from pnm.knowledge.source import Source
from tests.support.runs.commands import RUN, accepted
from tests.support.runs.plan_graphs import plan_of, plan_of_steps

CANCELED, SUCCEEDED, ABORTED = (Outcome(kind) for kind in (OutcomeKind.CANCELED, OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED))


def going(*actions: GroundAction, bindings: Bindings | None = None, **options: object) -> Run:
    """A run whose calls were all accepted at 1 s."""
    return accepted(plan_of(*actions), bindings, at=1.0, **options)


def successor(
    old: Run,
    *more: GroundAction,
    taken: int | None = None,
    orders: tuple[str, ...] = (),
    bindings: Bindings | None = None,
    **options: object,
) -> Run:
    """A run that takes over what is under way, and does more."""
    there = old.under_way()[:taken]
    calls = [ActionCall(number, one.call.action, under_way=True) for number, one in enumerate(there)]
    calls += [ActionCall(number, action) for number, action in enumerate(more, len(there))]
    machine = generate(plan_of_steps(*calls, orders=orders), bindings)
    verify(machine)
    adopted = dict(enumerate(there))
    options = {"resources": old.resources, "id": UUID(int=2), **options}
    return Run(machine, old.knowledge, bindings=bindings, adopted=adopted, **options)  # type: ignore[arg-type]


class ManualClient:
    """Accepts everything at once; ends what it is told to. The mutable state is what it was asked for."""

    def __init__(self) -> None:
        self.reporters: dict[str, tuple[Request, Reporter]] = {}
        self.cancelled: list[str] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return ()

    def send(self, request: Request, report: Reporter, /) -> None:
        self.reporters[request.action.name] = request, report
        report(Accepted(request.id))

    def cancel(self, request: UUID, /) -> None:
        self.cancelled += [name for name, (one, _) in self.reporters.items() if one.id == request]

    def end(self, name: str, outcome: Outcome = SUCCEEDED) -> None:
        request, report = self.reporters[name]
        report(Ended(request.id, outcome))


def carried(
    scenario: Callable[[Executor, ManualClient], object],
    *actions: GroundAction,
    bindings: Bindings | None = None,
    source: Source | None = None,
) -> RunResult:
    """Have a run of these actions carried out, and something done to it after a second."""
    server = ManualClient()
    world = KnowledgeBase(sensed={"seen": 2.0})
    machine = generate(plan_of(*actions), bindings)
    run = Run(machine, Layered(world), id=RUN, bindings=bindings, asks=source is not None)
    executor = Executor(run, server, source)

    async def main() -> RunResult:
        task = asyncio.ensure_future(executor.execute())
        await asyncio.sleep(1)
        scenario(executor, server)
        result = await asyncio.wait_for(task, 1000)
        assert asyncio.get_running_loop().time() < 500, "it ends by itself"
        return result

    return run_async(main(), virtual=True)
