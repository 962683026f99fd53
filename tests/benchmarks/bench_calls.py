"""What a checked call costs: two preconditions, one effect, servers that do nothing. Not a test: `python tests/benchmarks/bench_calls.py`.

Inline, requests are answered where they are returned; otherwise by a server on the event loop, a moment later.
"""

from __future__ import annotations

import asyncio
import os
import sys
from dataclasses import replace
from pathlib import Path
from uuid import UUID

sys.path.insert(0, str(Path(__file__).parents[2]))

from pnm.clock import short_pauses
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.executor import Executor
from tests.benchmarks.bench_engine import checked, inline
from tests.support.runs.timing import seconds


class Server:
    """Answers every request a moment later."""

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        loop = asyncio.get_running_loop()
        loop.call_soon(report, Accepted(request.id))
        loop.call_soon(report, Ended(request.id, Outcome(OutcomeKind.SUCCEEDED)))

    def cancel(self, request: UUID, /) -> None:
        """Ignore it."""


def run_of(machine: PetriNetMachine, known: dict[tuple[str, ...], bool]) -> Run:
    return Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1))


def report(what: str, calls: int, *, in_parallel: bool = False) -> None:
    """Print how long a call takes, with a machine that was executed before."""
    plan, known = checked(calls)
    machine = generate(replace(plan, orderings=()) if in_parallel else plan)
    inline(run_of(machine, known))
    times = max(3, 10_000 // calls)
    with short_pauses():  # as in every process of ours
        alone = seconds(lambda: inline(run_of(machine, known)), times) / calls * 1e6
        served = seconds(lambda: asyncio.run(Executor(run_of(machine, known), Server()).execute()), times) / calls * 1e6
    print(f"{calls} {what}: {alone:.0f} us a call inline (at most 25), {served:.0f} us asynchronous (at most 50)")


if __name__ == "__main__":
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    for count in (100, 1_000, 10_000):
        report("in a row", count)
    report("in parallel", 1_000, in_parallel=True)
