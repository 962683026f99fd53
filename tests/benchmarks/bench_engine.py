"""What the table of `tests.benchmarks` leaves out of machines and runs, as ratios within one run. Not a test.

usage: python -m tests.benchmarks.bench_engine

The parts of the way from a plan to its end; plans by hand, whose reading is compared with PyYAML's own, and exporting and importing with
reading the PDDL files that they start from; proofs of wide plans and of many recoveries, runs side by side, and changes of facts among
many conditions and constraints. The unit is one turn of a plain Python loop over integers, measured in the same process.
"""

from __future__ import annotations

import gc
import tempfile
import tracemalloc
from pathlib import Path
from uuid import UUID

import yaml

from planner_bridge.cli.convert import exported, imported
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.settings import OnChange
from pnm.core.execution.events import Begin, Command, Send
from pnm.core.execution.machine_index import prepare
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, Moment, Ordering, PlanEvent, PlanGraph, Recovery, Then
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.verify import forget_proofs, verify
from pnm.language.plan import read_plans
from tests.support.benchmarks.waiting import CHARGE, OTHER, constrained, fact, fleet, heard
from tests.support.benchmarks.workloads import checked, in_a_row, inline, loop, side_by_side
from tests.support.files import ROOT
from tests.support.runs.timing import seconds

WORDS = ("generate", "prove", "compile", "run inline")
HEAD = "actions:\n  go: {params: [place]}\n  set: {type: kb_action}\nplan:\n"
STEP = (
    "  - concurrent_actions:\n      - go: {place: a}\n      - - go: {place: b}\n"
    "        - if: {Comparison: [eq, [{LocalQuery: n}, 1]]}\n          then: [go: {place: c}]\n          else: [go: {place: d}]\n"
    "  - while: {condition: {Comparison: [lt, [{LocalQuery: n}, 0]]}, actions: [set: {operation: {LocalUpdate: [n, 1]}}]}\n"
)
PER_STEP = 7
"""Steps in one `STEP`, those inside others included."""


def parts(unit: float) -> None:
    """From a plan to the end of its run, part by part."""
    for calls in (100, 1_000, 10_000):
        told(no_ops(calls), calls, "calls", unit)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plan.yaml"
        for blocks in (10, 100, 1000):
            text, steps = HEAD + STEP * blocks, blocks * PER_STEP
            file.write_text(text, encoding="utf-8")
            plain, read = seconds(lambda: yaml.safe_load(text)), seconds(lambda: read_plans(file))
            print(f"{steps} steps by hand: read {read / steps / unit:.0f} units, {read / plain:.1f} times as long as PyYAML's loading")
            told(read_plans(file)["plan"].graph, steps, "steps", unit)
        for name in ("delivery", "mall_guide", "patrol"):
            domain, problem = ROOT / "domains" / name / "domain.pddl", ROOT / "problems" / name / "p01.pddl"
            reading, writing = seconds(lambda: load(domain, problem)), seconds(lambda: exported(domain, problem))
            file.write_text(exported(domain, problem).text, encoding="utf-8")
            back = seconds(lambda: imported(file))
            print(f"{name}: export {writing / reading:.1f}, import {back / reading:.1f} times as long as reading the PDDL")


def told(plan: PlanGraph, count: int, what: str, unit: float) -> None:
    """Print what each part takes."""
    machine = generate(plan)
    made = seconds(lambda: generate(plan), 1)
    proved = seconds(lambda: verify(machine), 1)
    compiled = seconds(lambda: prepare(machine), 1)
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables={"n": 1}))
    ran = seconds(lambda: inline(Run(machine, knowledge, id=UUID(int=1))), 1)
    each = (f"{word} {took / count / unit:.0f}" for word, took in zip(WORDS, (made, proved, compiled, ran), strict=True))
    total = f"{made:.2f} + {proved:.2f} + {compiled:.2f} + {ran:.2f} s; {kept(plan) / count:.0f} bytes"
    print(f"{count} {what} ({len(machine.net.transitions)} transitions), each: {', '.join(each)} units; {total}")


def no_ops(calls: int) -> PlanGraph:
    """Calls that need nothing and change nothing; each waits for one of the twenty before it."""
    action = GroundAction("no_op")
    found = tuple(ActionCall(index, action) for index in range(calls))
    before = (index - 1 - (index * 7) % min(index, 20) for index in range(1, calls))
    orderings = tuple(Ordering(PlanEvent(one, Moment.END), PlanEvent(index, Moment.START)) for index, one in enumerate(before, 1))
    return PlanGraph(found, orderings)


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


def beside() -> None:
    """Runs side by side, and one alone."""
    plan, known = checked(100)
    machine = generate(plan)
    inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1)))
    alone = seconds(lambda: inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1))))
    others = [Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=number << 96)) for number in range(1, 1_001)]
    took = seconds(lambda: side_by_side_inline(others), 1) / len(others)
    print(f"1000 runs of 100 calls side by side / one alone, a call = {took / alone:.2f} (at most 1.5)")


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


def nodes(machine: PetriNetMachine) -> int:
    return len(machine.net.places) + len(machine.net.transitions)


def changes() -> None:
    """A fact changes: one that nothing mentions, and one that one of many conditions over all, or constraints, does."""
    for count in (100, 1_000):
        for on_change in OnChange:
            of_none, of_one = (fact(fleet(count), fluent, on_change) for fluent in (OTHER, CHARGE))
            print(f"a change among {count} calls, {on_change.value}: {of_none:.1f} us if none reads it, {of_one:.1f} us if one does")
        world, look = constrained(10 * count)
        of_none, of_one = (heard(world, look, fluent) for fluent in (OTHER, ("fit", "r5")))
        print(f"a change among {10 * count} constraints: {of_none:.1f} us if none reads it (at most 5), {of_one:.1f} us if one does (50)")


def main() -> None:
    unit = seconds(loop) / 1_000_000
    print(f"unit: one turn of a plain loop, {unit * 1e9:.0f} ns")
    parts(unit)
    beside()
    proofs()
    changes()


if __name__ == "__main__":
    main()
