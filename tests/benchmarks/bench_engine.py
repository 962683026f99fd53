"""How long firings and machines take, as ratios within one run. Not a test: `python tests/benchmarks/bench_engine.py`.

The unit is one turn of a plain Python loop over integers, measured in the same process.
"""

from __future__ import annotations

import gc
import sys
import tracemalloc
from pathlib import Path
from uuid import UUID

sys.path.insert(0, str(Path(__file__).parents[2]))

from pnm.core.execution.events import Begin, Command, Send
from pnm.core.execution.machine_index import prepare
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import (
    ActionCall,
    Flow,
    GroundAction,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Then,
)
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.verify import forget_proofs, verify
from pnm.core.net.block_net import block_net
from tests.support.benchmarks.executives.plans import machine as from_plan
from tests.support.benchmarks.workloads import chain_net, checked, firings, fork_join, in_a_row, inline, loop, side_by_side
from tests.support.runs.timing import seconds


def no_ops(calls: int) -> PlanGraph:
    """Calls that need nothing and change nothing; each waits for one of the twenty before it."""
    action = GroundAction("no_op")
    found = tuple(ActionCall(index, action) for index in range(calls))
    before = (index - 1 - (index * 7) % min(index, 20) for index in range(1, calls))
    orderings = tuple(Ordering(PlanEvent(one, Moment.END), PlanEvent(index, Moment.START)) for index, one in enumerate(before, 1))
    return PlanGraph(found, orderings)


def recovering(count: int) -> PlanGraph:
    """One call with so many recoveries, each of which may be used three times."""
    causes = [cause for cause in Cause if cause not in (Cause.INVARIANT_FALSE, Cause.TOO_LATE, Cause.DEADLINE_MISSED, Cause.LOOP_LIMIT)]
    chains = (Flow((ActionCall(index + 1, GroundAction("wait")),)) for index in range(count))
    recoveries = (Recovery(frozenset({cause}), Then.RETRY, chain, 3, TRUE) for cause, chain in zip(causes, chains, strict=False))
    return PlanGraph((ActionCall(0, GroundAction("no_op"), recoveries=tuple(recoveries)),))


def proof_seconds(machine: PetriNetMachine) -> float:
    """The time of a proof that knows no shape yet."""

    def prove() -> None:
        forget_proofs()
        verify(machine)

    return seconds(prove)


def main() -> None:
    unit = seconds(loop) / 1_000_000
    print(f"unit: one turn of a plain loop, {unit * 1e9:.0f} ns")
    for make in (chain_net, fork_join):
        costs = {}
        for size in (100, 1_000, 10_000, 100_000):
            net = block_net(make(size))
            rounds = max(1, 100_000 // size)
            fired = firings(net) * rounds
            costs[size] = seconds(lambda: [firings(net) for _ in range(rounds)]) / fired
        row = ", ".join(f"{size}: {cost / unit:.0f} units" for size, cost in costs.items())
        print(f"{make.__name__}: a firing at {row}; ratio 100000 / 100 = {costs[100_000] / costs[100]:.2f} (at most 4)")
    for calls in (100, 1_000, 10_000):
        plan = no_ops(calls)
        machine = generate(plan)
        made = seconds(lambda: generate(plan), 1)
        proved = seconds(lambda: verify(machine), 1)
        compiled = seconds(lambda: prepare(machine), 1)
        ran = seconds(lambda: inline(Run(machine, Layered(KnowledgeBase()), id=UUID(int=1))), 1)
        print(
            f"{calls} calls ({len(machine.net.transitions)} transitions), per call: "
            f"generate {made / calls / unit:.0f}, prove {proved / calls / unit:.0f}, compile {compiled / calls / unit:.0f}, "
            f"run inline {ran / calls / unit:.0f} units; {made:.2f} + {proved:.2f} + {compiled:.2f} + {ran:.2f} s; "
            f"{kept(plan) / calls:.0f} bytes"
        )

    checked_calls(unit)
    proofs()
    whole()


def whole() -> None:
    """From a plan of a planner to a machine that is proved and compiled."""
    costs = {calls: from_plan(calls) for calls in (1_000, 10_000, 100_000)}
    row = ", ".join(f"{calls}: {cost:.0f} us" for calls, cost in costs.items())
    print(f"from a plan to its machine, a call: {row}; ratio 100000 / 1000 = {costs[100_000] / costs[1_000]:.2f} (at most 1.5)")


def kept(plan: PlanGraph) -> int:
    """The bytes of a machine that was proved and compiled."""
    gc.collect()
    tracemalloc.start()
    machine = generate(plan)
    verify(machine)
    prepare(machine)
    gc.collect()
    found, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return found


def checked_calls(unit: float) -> None:
    """A checked call that is answered at once, with a machine that is executed for the first time, and again; alone and among others."""
    for calls in (100, 1_000, 10_000):
        plan, known = checked(calls)
        took: list[list[float]] = [[], []]
        for _ in range(max(1, 3_000 // calls)):
            machine = generate(plan)
            prepare(machine)
            for times in took:
                run = Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1))
                times.append(seconds(lambda run=run: inline(run), 1))  # type: ignore[misc]
        first, again = (min(times) / calls for times in took)
        print(
            f"{calls} checked calls in a row, inline: "
            f"{first / unit:.0f} units a call for a new machine, {again / unit:.0f} for one that is known; "
            f"{first * 1e6:.0f}, {again * 1e6:.0f} us"
        )
    plan, known = checked(100)
    machine = generate(plan)
    inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1)))
    alone = seconds(lambda: inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1))))
    others = [Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=number << 96)) for number in range(1, 1_001)]
    beside = seconds(lambda: side_by_side_inline(others), 1) / len(others)
    print(f"1000 runs of 100 calls side by side / one alone, a call = {beside / alone:.2f} (at most 1.5)")


def side_by_side_inline(runs: list[Run]) -> None:
    """Answer the requests of all runs in turn."""
    waiting = [(run, command) for run in runs for command in run.handle(Begin(), 0.0)]
    while waiting:
        then: list[tuple[Run, Command]] = []
        for run, command in waiting:
            if isinstance(command, Send):
                for event in (Accepted(command.request.id), Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED))):
                    then += [(run, new) for new in run.handle(event, 0.0)]
        waiting = then


def proofs() -> None:
    """Ratios of proofs: the proof is linear in the width of a plan and in the recoveries of a call."""
    for calls in (1_000, 10_000):
        chain, wide = generate(in_a_row(calls)), generate(side_by_side(calls))
        ratio = (proof_seconds(wide) / nodes(wide)) / (proof_seconds(chain) / nodes(chain))
        print(f"{calls} calls: a node of a proof side by side / in a row = {ratio:.2f} (at most 2)")
    few, many = generate(recovering(2)), generate(recovering(11))
    ratio = proof_seconds(many) / proof_seconds(few)
    print(f"recoveries of one call: 11 / 2 = {ratio:.1f} (at most 11); 11 take {proof_seconds(many) * 1000:.0f} ms")


def nodes(machine: PetriNetMachine) -> int:
    return len(machine.net.places) + len(machine.net.transitions)


if __name__ == "__main__":
    main()
