"""Our firings and calls, and what plain Python takes for the same: nets that only count, and asyncio with the same checks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from uuid import UUID

from pnm.core.execution.machine_index import prepare
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.net.block_net import block_net
from pnm.executor import Executor
from pnm.journal.journal import NO_JOURNAL
from tests.support.benchmarks.peers import nets, worker
from tests.support.benchmarks.peers.worker import Measure, each
from tests.support.benchmarks.workloads import checked, firings, in_a_row, inline, loop, net_of
from tests.support.e2e.page.busy_run import AtOnce, answered

_TURNS = 1_000_000


def plain_loop(_: int) -> float:
    """One turn of a plain loop, the unit of the gate."""
    return each(lambda: loop(_TURNS), _TURNS)


# --- firings ---------------------------------------------------------------------------------------


def counted(make: Callable[[int], nets.Arcs]) -> Measure:
    """Return the measure of firing with nothing but a count of missing tokens for each transition."""

    def measure(size: int) -> float:
        arcs = make(size)
        consumers: list[list[int]] = [[] for _ in nets.places_of(arcs)]
        missing, fired = [], 0
        for number, (before, _) in enumerate(arcs):
            missing.append(len(before))
            for place in before:
                consumers[place].append(number)

        def run() -> None:
            nonlocal fired
            agenda = [0]
            while agenda:
                for number in consumers[agenda.pop()]:
                    missing[number] -= 1
                    if not missing[number]:
                        fired += 1
                        agenda.extend(arcs[number][1])

        took = each(run, len(arcs))
        assert fired == len(arcs)
        return took

    return measure


def engine(make: Callable[[int], nets.Arcs]) -> Measure:
    """Return the measure of a firing of the engine."""

    def measure(size: int) -> float:
        net = block_net(net_of(make(size)))
        firings(net)  # what is known of a transition is worked out when it fires for the first time
        return each(lambda: firings(net), net.count_transitions)

    return measure


def forks(calls: int) -> PlanGraph:
    """A call, eight that wait for it, one that waits for these, and so on."""
    stage = nets.WIDTH + 1
    steps = tuple(ActionCall(index, GroundAction("no_op")) for index in range(calls))
    pairs = []
    for index in range(calls):
        middle = index - index % stage  # that of the stage: the others wait for it, and it waits for those of the stage before
        pairs += [(middle, index)] if index % stage else [(before, index) for before in range(max(0, index - stage + 1), index)]
    return PlanGraph(steps, tuple(Ordering(PlanEvent(one, Moment.END), PlanEvent(other, Moment.START)) for one, other in pairs))


def through_run(make: Callable[[int], PlanGraph]) -> Measure:
    """Return the measure of a firing of a run: conditions, calls, requests and results included."""

    def measure(size: int) -> float:
        machine = generate(make(max(2, size // 4)))  # a call that all goes well with fires about four times
        fired = answered(machine, NO_JOURNAL, KnowledgeBase())
        return each(lambda: answered(machine, NO_JOURNAL, KnowledgeBase()), fired)

    return measure


# --- calls -----------------------------------------------------------------------------------------


def checked_run(calls: int, parallel: bool = False) -> Run:
    """A run of calls with two preconditions and an effect, of a machine that was not executed before."""
    plan, known = checked(calls)
    machine = generate(replace(plan, orderings=()) if parallel else plan)
    return _run(machine, KnowledgeBase(known))


def _run(machine: PetriNetMachine, known: KnowledgeBase) -> Run:
    prepare(machine)
    return Run(machine, Layered(known), id=UUID(int=1))


def call_inline(size: int) -> float:
    run = checked_run(size)
    return each(lambda: inline(run), size)


def call_known(size: int) -> float:
    """The same with a machine that was executed once before."""
    plan, known = checked(size)
    machine = generate(plan)
    inline(_run(machine, KnowledgeBase(known)))
    run = _run(machine, KnowledgeBase(known))
    return each(lambda: inline(run), size)


def call_asynchronous(size: int) -> float:
    return _executed(checked_run(size), size)


def calls_in_parallel(size: int) -> float:
    return _executed(checked_run(size, parallel=True), size)


def _executed(run: Run, size: int) -> float:
    async def execute() -> None:
        assert (await Executor(run, AtOnce()).execute()).goal

    return each(lambda: asyncio.run(execute()), size)


async def _task(robot: str, known: dict[str, bool]) -> None:
    """The same checks around an action that does nothing."""
    assert known.get(f"ready {robot}")
    assert known.get("free kitchen")
    await asyncio.sleep(0)
    known[f"done {robot}"] = True
    assert known.get(f"done {robot}")


def tasks_in_a_row(size: int) -> float:
    known = worker.known(size)

    async def execute() -> None:
        for number in range(size):
            await asyncio.create_task(_task(f"r{number}", known))

    return each(lambda: asyncio.run(execute()), size)


def tasks_in_parallel(size: int) -> float:
    known = worker.known(size)

    async def execute() -> None:
        await asyncio.gather(*(_task(f"r{number}", known) for number in range(size)))

    return each(lambda: asyncio.run(execute()), size)


def locked(size: int) -> float:
    """So many tasks of asyncio that want one lock."""

    async def want(lock: asyncio.Lock) -> None:
        async with lock:
            await asyncio.sleep(0)

    async def execute() -> None:
        lock = asyncio.Lock()
        await asyncio.gather(*(want(lock) for _ in range(size)))

    return each(lambda: asyncio.run(execute()), size)


MEASURES: dict[str, Measure] = {
    "loop": plain_loop,
    "counters-chain": counted(nets.chain),
    "counters-fork": counted(nets.fork_join),
    "engine-chain": engine(nets.chain),
    "engine-fork": engine(nets.fork_join),
    "run-chain": through_run(in_a_row),
    "run-fork": through_run(forks),
    "call-inline": call_inline,
    "call-known": call_known,
    "call-asynchronous": call_asynchronous,
    "calls-parallel": calls_in_parallel,
    "tasks-row": tasks_in_a_row,
    "tasks-parallel": tasks_in_parallel,
    "locked": locked,
}
