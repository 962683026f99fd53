"""How long firings and machines take, as ratios within one run. Not a test: `python tests/benchmarks/bench_engine.py`.

The unit is one turn of a plain Python loop over integers, measured in the same process.
"""

from __future__ import annotations

import sys
from pathlib import Path
from uuid import UUID

sys.path.insert(0, str(Path(__file__).parents[2]))

from pnm.core.execution.events import Begin, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.verify import verify
from pnm.core.net.firing_engine import CompiledNet, Engine
from pnm.core.net.net import NetBuilder, PetriNet
from tests.support.runs.timing import seconds


def loop(turns: int = 1_000_000) -> None:
    total = 0
    for turn in range(turns):
        total += turn & 1


def chain_net(length: int) -> PetriNet:
    """p0 -> t0 -> p1 -> … of so many transitions."""
    net = NetBuilder()
    places = [net.place(f"p{index}") for index in range(length + 1)]
    for index in range(length):
        net.transition(f"t{index}", [places[index]], [places[index + 1]])
    return net.build()


def fork_join(length: int, width: int = 8) -> PetriNet:
    """Forks into `width` branches that join again, one after the other, until there are so many transitions."""
    net = NetBuilder()
    last = net.place("p")
    for stage in range(max(1, length // (width + 2))):
        before = [net.place(f"a{stage}.{branch}") for branch in range(width)]
        after = [net.place(f"b{stage}.{branch}") for branch in range(width)]
        net.transition(f"fork{stage}", [last], before)
        for branch in range(width):
            net.transition(f"t{stage}.{branch}", [before[branch]], [after[branch]])
        last = net.place(f"p{stage}")
        net.transition(f"join{stage}", after, [last])
    return net.build()


def firings(compiled: CompiledNet, first: str) -> int:
    """Fire until nothing is enabled, following the tokens; return the number of firings."""
    engine = Engine(compiled, {first: 1})
    agenda, fired = [compiled.place_id[first]], 0
    while agenda:
        place = agenda.pop()
        for transition, _ in compiled.consumers[place]:
            if engine.is_enabled(transition):
                engine.fire(transition)
                fired += 1
                agenda.extend(one for one, _ in compiled.outputs[transition])
    return fired


def no_ops(calls: int) -> PlanGraph:
    """Calls that need nothing and change nothing; each waits for one of the twenty before it."""
    action = GroundAction("no_op")
    found = tuple(ActionCall(index, action) for index in range(calls))
    before = (index - 1 - (index * 7) % min(index, 20) for index in range(1, calls))
    orderings = tuple(Ordering(PlanEvent(one, Moment.END), PlanEvent(index, Moment.START)) for index, one in enumerate(before, 1))
    return PlanGraph(found, orderings)


def inline(run: Run) -> int:
    """Answer every request at once; return how many there were."""
    waiting, answered = run.handle(Begin(), 0.0), 0
    while waiting:
        command = waiting.pop()
        if isinstance(command, Send):
            answered += 1
            waiting += run.handle(Accepted(command.request.id), 0.0)
            waiting += run.handle(Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED)), 0.0)
    assert run.result().goal
    return answered


def main() -> None:
    unit = seconds(loop) / 1_000_000
    print(f"unit: one turn of a plain loop, {unit * 1e9:.0f} ns")
    for make in (chain_net, fork_join):
        costs = {}
        for size in (100, 1_000, 10_000, 100_000):
            compiled = CompiledNet(make(size))
            first = compiled.net.places[0]
            rounds = max(1, 100_000 // size)
            fired = firings(compiled, first) * rounds
            costs[size] = seconds(lambda: [firings(compiled, first) for _ in range(rounds)]) / fired
        row = ", ".join(f"{size}: {cost / unit:.0f} units" for size, cost in costs.items())
        print(f"{make.__name__}: a firing at {row}; ratio 100000 / 100 = {costs[100_000] / costs[100]:.2f} (at most 4)")
    for calls in (100, 1_000, 10_000):
        plan = no_ops(calls)
        machine = generate(plan)
        made = seconds(lambda: generate(plan), 1)
        proved = seconds(lambda: verify(machine), 1)
        machine.compiled  # noqa: B018
        ran = seconds(lambda: inline(Run(machine, Layered(KnowledgeBase()), id=UUID(int=1))), 1)
        print(
            f"{calls} calls ({len(machine.net.transitions)} transitions), per call: "
            f"generate {made / calls / unit:.0f}, prove {proved / calls / unit:.0f}, run inline {ran / calls / unit:.0f} units; "
            f"{made:.2f} + {proved:.2f} + {ran:.2f} s"
        )


if __name__ == "__main__":
    main()
