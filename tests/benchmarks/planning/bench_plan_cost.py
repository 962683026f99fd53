"""What plans cost: the first, those of the default, and the best that Kairos finds in a long time. A table, not a test.

usage: python -m tests.benchmarks.planning.bench_plan_cost [FOLDER ...] [--seconds N]      (N for the long search, by default 30)

A folder has a manifest.json with the names of its pairs, each a folder with domain.pddl and problem.pddl. "Tenth" is what is
found in a tenth of the longest time. Gaps are to what Kairos finds by itself in the long time: below 0
where the default is better. Of each plan of the default every call is left out in turn, and with it those that Kairos' validator then
says cannot be carried out: if what is left is valid and costs no more, the call was needless.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter

import kairos

from planner_bridge.model.plan import Plan, plan_text
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.kairos import LONGEST, parse_for_kairos
from planner_bridge.planning.solve import solve
from pnm.errors import InputError
from tests.support.files import SHARED

KNOWN = SHARED / "pddl"
WORST = 6
"""Problems in the list of the worst."""


@dataclass(frozen=True)
class Row:
    """What the plans for one problem cost."""

    name: str
    has_metric: bool
    first: float
    tenth: float
    default: float
    seconds: float
    """Of the default."""
    best: float | None
    """Of the long search; None if it finds nothing."""
    calls: int
    needless: int
    sign: float
    """-1 where more is better."""

    def gap(self, cost: float) -> float:
        """Return by how much a cost is above that of the long search."""
        return self.sign * (cost - self.best) / abs(self.best) if self.best else 0.0

    def __str__(self) -> str:
        best = "" if self.best is None else f"{self.best:g}"
        costs = f"{self.first:g} | {self.tenth:g} | {self.default:g} in {self.seconds:.2f} s | {best} | {self.gap(self.default):.1%}"
        return f"| {self.name} | {'yes' if self.has_metric else ''} | {costs} | {self.needless} of {self.calls} |"


def cost(plan: Plan) -> float:
    """What is minimised: the metric, or the time, or the number of calls."""
    return plan.cost if plan.cost is not None else plan.makespan if plan.temporal else float(len(plan.steps))


def needless(parsed: kairos.Problem, plan: Plan) -> int:
    """Return how many calls can be left out, alone or with those that rest on them; by Kairos' validator alone."""

    def report(steps: list[int]) -> kairos.ValidationReport:
        return kairos.validate(parsed, kairos.parse_plan(plan_text(replace(plan, steps=tuple(plan.steps[number] for number in steps)))))

    every = [*range(len(plan.steps))]
    whole, count = report(every), 0
    for number in every:
        left = [other for other in every if other != number]
        while not (shorter := report(left)).valid and shorter.failed_step is not None and left:
            del left[shorter.failed_step]
        count += shorter.valid and (whole.metric is None or shorter.metric is None or shorter.metric <= whole.metric + 1e-6)
    return count


def row(name: str, problem: Problem, seconds: float) -> Row | None:
    """Return what the plans for a problem cost; None if there is no plan."""
    plans: list[tuple[Plan, float]] = []
    for improve in (0.0, LONGEST / 10.0, None):
        began = perf_counter()
        plan = solve(problem, improve=improve).plan
        if plan is None:
            return None
        plans.append((plan, perf_counter() - began))
    (first, _), (tenth, _), (default, took) = plans
    parsed = parse_for_kairos(problem)
    best = kairos.Planner().solve(parsed, timeout=seconds, anytime=True, threads=1).plan
    found = None if best is None else best.cost if default.cost is not None else best.makespan() if default.temporal else len(best.steps)
    sign = -1.0 if problem.metric is not None and problem.metric.direction == "maximize" else 1.0
    costs = (cost(first), cost(tenth), cost(default))
    return Row(name, problem.metric is not None, *costs, took, found, len(default.steps), needless(parsed, default), sign)


def rows(folders: list[Path], seconds: float) -> Iterator[Row]:
    """Yield the rows of all problems that are read and have a plan, as they come."""
    for pair in (folder / entry["name"] for folder in folders for entry in json.loads((folder / "manifest.json").read_text())):
        try:
            found = row(pair.name, load(pair / "domain.pddl", pair / "problem.pddl"), seconds)
        except InputError:
            continue
        if found is not None:
            yield found


def main() -> None:
    arguments = sys.argv[1:]
    seconds = 30.0
    if "--seconds" in arguments:
        position = arguments.index("--seconds")
        seconds = float(arguments[position + 1])
        del arguments[position : position + 2]
    folders = [Path(name) for name in arguments] or [KNOWN / "robots", KNOWN / "ipc"]
    print(f"| problem | metric | first | tenth | default | {seconds:g} s | gap | needless |\n|---|---|---:|---:|---:|---:|---:|---:|")
    table: list[Row] = []
    for found in rows(folders, seconds):
        table.append(found)
        print(found, flush=True)
    for title, chosen in (("with a metric", [found for found in table if found.has_metric]), ("all", table)):
        if chosen:
            gaps = {way: median(found.gap(getattr(found, way)) for found in chosen) for way in ("first", "tenth", "default")}
            said = ", ".join(f"{way} {gap:.1%}" for way, gap in gaps.items())
            print(f"\n{title}, {len(chosen)} problems: median gap to {seconds:g} s: {said}")
            print(f"plans with a needless call: {sum(found.needless > 0 for found in chosen)}")
    worst = sorted(table, key=lambda found: -found.gap(found.default))[:WORST]
    print(f"\nworst: {', '.join(f'{found.name} {found.gap(found.default):.0%}' for found in worst)}")


if __name__ == "__main__":
    main()
