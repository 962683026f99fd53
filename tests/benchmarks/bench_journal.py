"""What the journal costs, as ratios to the same without one, in one process. Not a test.

usage: python -m tests.benchmarks.bench_journal [engine] [failures] [replays] [recoveries]

The engine: a run whose requests are answered at once, with every event committed to a file, and without; in turn, several times: as an
executor carries it out, and with its events alone, without an event loop. A failure: from knowing of it to the begin of the next plan.
A replay: of runs with 100000 firings, beside what is read of them without executing them. A recovery:
100 tasks, each with a machine and a request that is out, from opening the file until every one of them goes on.
"""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
import sqlite3
import sys
import tempfile
import time
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from statistics import median
from uuid import UUID

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.result import TASKS, Stopwatch
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend, SimulatedBackend
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async, short_pauses
from pnm.core.execution.machine_index import prepare
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Reporter, Request
from pnm.journal.journal import NO_JOURNAL, Journal, WrittenJournal
from pnm.journal.kept import DURABILITIES, JournalChoice
from pnm.journal.resume import replayed, take_up
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.e2e.page.busy_run import answered, executed, kept, rounds, with_journal, without_journal
from tests.support.files import ROOT
from tests.support.pddl.problems import fleet, read_goal
from tests.support.runs.timing import FailureClock, seconds

FIRINGS = 100_000
CALLS = 500
UNDER_WAY = 100


def engine(folder: Path) -> None:
    machine = generate(rounds(CALLS))
    prepare(machine)

    def handled(journal: Journal, world: KnowledgeBase) -> float:
        return seconds(lambda: answered(machine, journal, world), 1)

    async def as_executed(file: Path | None, is_durable: bool) -> float:
        with short_pauses(), kept(file, is_durable=is_durable) if file else nullcontext((NO_JOURNAL, KnowledgeBase())) as (journal, world):
            began = time.perf_counter()
            await executed(machine, journal, world)
            return time.perf_counter() - began

    for word, is_durable in DURABILITIES.items():
        name, found = word.replace("-", " "), dict[str, list[tuple[float, float]]]()
        for turn in range(7):
            file, other = folder / f"{word}{turn}", folder / f"{word}{turn}e"
            found.setdefault("with an executor", []).append(
                (asyncio.run(as_executed(None, is_durable)), asyncio.run(as_executed(other, is_durable)))
            )
            found.setdefault("events alone", []).append((without_journal(handled), with_journal(handled, file, is_durable=is_durable)))
        for what, pairs in found.items():
            without, with_one = (min(times) / CALLS for times in zip(*pairs, strict=True))
            bound = "no bound" if is_durable else "at most 3"
            print(
                f"a call, {what}, {name}: with / without a journal = {with_one / without:.2f} ({bound}); "
                f"{1e6 * with_one:.0f} / {1e6 * without:.0f} us, {file.stat().st_size / CALLS:.0f} bytes in the file"
            )


async def pursued(problem: Problem, settings: Settings, robots: SimulatedBackend, clock: FailureClock, file: Path | None) -> None:
    """Pursue the goal of the problem once, as a task of a manager."""
    journal = WrittenJournal(JournalFile(file, 0.0), TASKS) if file else NO_JOURNAL
    knowledge = initial_knowledge(problem)
    await robots.open(knowledge)
    runner = PlanRunner({}, robots, knowledge, None, journal)
    manager = TaskManager(problem, runner, settings, lambda _: problem.goal)
    journal.begin(knowledge, runner.resources)
    await manager.run(Wanted(UUID(int=1), ""), clock, Stopwatch())
    await manager.close()
    await robots.close()
    if isinstance(journal, WrittenJournal):
        journal.close()


def failures(folder: Path) -> None:
    """From a failure to the next request; both kinds in turn with the same seeds, so that the machine's load is the same."""
    found: dict[bool, list[float]] = {True: [], False: []}
    limits = Limits(replans=30, seconds=60.0, forbid_after=1, backoff=0.0)
    for number, file in enumerate(sorted((ROOT / "problems").glob("delivery/p*.pddl"))):
        problem = load(ROOT / "domains" / file.parent.name / "domain.pddl", file)
        settings = Settings(improve=0.0, limits=limits, on_failure=OnFailure.CONTINUE_OTHERS, on_change=OnChange.EAGER)
        for seed in range(16):
            for is_kept in (True, False) if seed % 2 else (False, True):
                faults = Faults(tuple(Fault(name, FaultKind.ABORT, chance=0.2) for name in problem.domain.actions), seed=seed)
                clock, backend = FailureClock(), SimulatedBackend(robots_of(problem, Bindings(), faults, speed=50.0))
                path = folder / f"{number}.{seed}" if is_kept else None
                run_async(pursued(problem, settings, backend, clock, path), virtual=False)
                found[is_kept] += (whole - planner for whole, planner in clock.found)
    times = {is_kept: 1000 * median(every) for is_kept, every in found.items()}
    extra = times[True] - times[False]
    counts = " and ".join(str(len(every)) for every in found.values())
    print(
        f"failure to next request, without the planner: {extra:+.2f} ms with a journal (at most 5); "
        f"medians of {counts} failures: {times[True]:.1f} and {times[False]:.1f} ms"
    )


def replays(folder: Path) -> None:
    """Replay what a node keeps: many tasks of a few calls each, some of them with the same plan."""
    machines = [generate(rounds(calls)) for calls in range(16, 24)]

    def execute(journal: Journal, world: KnowledgeBase) -> int:
        fired = number = 0
        while fired < FIRINGS:
            number += 1
            fired += answered(machines[number % len(machines)], journal, world, UUID(int=number))
        return fired

    fired = with_journal(execute, folder / "long")
    with short_pauses():  # as in every process of ours
        took, without = seconds(lambda: replayed(folder / "long", TASKS), 2), seconds(lambda: without_journal(execute), 2)
        told = seconds(lambda: JournalHistory.read(folder / "long"), 2)
    print(f"replay: {took * FIRINGS / fired:.2f} s for {FIRINGS} firings (at most 2); {took / without:.2f} times the runs themselves")
    print(f"history: what `pnm why` and timelines read takes {told / took:.2f} times the replay (at most 0.6)")


class Silent:
    """Robots that begin with everything, and say nothing more."""

    def __init__(self) -> None:
        self.asked: set[UUID] = set()
        self.all_are = asyncio.Event()

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        report(Accepted(request.id))
        self._note(request.id)

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        self.send(request, report)

    def cancel(self, request: UUID, /) -> None:
        """Ignore it."""

    def _note(self, request: UUID) -> None:
        self.asked.add(request)
        if len(self.asked) == UNDER_WAY:
            self.all_are.set()


async def until_under_way(problem: Problem, file: Path, copy: Path | None = None) -> float:
    """Begin with all tasks, or go on with them, until the requests of all are out; return the seconds that this took."""
    began = time.perf_counter()
    taken = take_up(JournalChoice(file, adopts=True), TASKS, "")
    journal, replay = taken.write(), taken.replay
    client, knowledge = Silent(), replay.world if replay else initial_knowledge(problem)
    runner = PlanRunner({}, ClientBackend(client), knowledge, None, journal, replay)
    settings, limits = Settings(improve=0.0), TaskLimits(active=UNDER_WAY, queue=UNDER_WAY)
    manager = TaskManager(problem, runner, settings, partial(read_goal, problem), limits=limits)
    if replay:
        manager.restore(replay)
    else:
        journal.begin(knowledge, runner.resources)
        for number in range(UNDER_WAY):
            manager.begin(Wanted(UUID(int=number + 1), f"(at r{number} a5)"))
    await client.all_are.wait()
    took = time.perf_counter() - began
    if copy:
        with closing(sqlite3.connect(file)) as source, closing(sqlite3.connect(copy)) as target:
            source.backup(target)
    return took


def recoveries(folder: Path) -> None:
    problem, file, crashed = fleet(robots=UNDER_WAY, parcels=1, places=10), folder / "node", folder / "crashed"
    logging.disable(logging.CRITICAL)
    begin = asyncio.run(until_under_way(problem, file, crashed))
    found = []
    for turn in range(3):
        shutil.copy(crashed, folder / f"recovered{turn}")
        found.append(asyncio.run(until_under_way(problem, folder / f"recovered{turn}")))
    print(f"recovery of {UNDER_WAY} tasks: {min(found):.2f} s (at most 2); to begin with them took {begin:.2f} s")


def main() -> None:
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    measures = {measure.__name__: measure for measure in (engine, failures, replays, recoveries)}
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:] or measures:
            measures[name](Path(folder))


if __name__ == "__main__":
    main()
