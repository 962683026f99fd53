"""What plans cost: the first one, that of the default, and the best that Kairos finds in a long time. A table, not a test.

usage: python tests/benchmarks/bench_plan_cost.py [FOLDER ...] [--seconds N]      (N for the long search, by default 30)

A folder has a manifest.json with the names of its pairs, each a folder with domain.pddl and problem.pddl. The gap is that of the
default's plan to the best one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from statistics import median
from time import perf_counter

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

import kairos

from planner_bridge.loading import load
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import IMPROVE, parse_for_kairos
from planner_bridge.planning.solve import solve
from pnm.errors import InputError

KNOWN = ROOT.parent / "shared" / "pddl"


def cost(plan: Plan) -> float:
    """What is minimised: the metric, or the time, or the number of calls."""
    return plan.cost if plan.cost is not None else plan.makespan if plan.temporal else float(len(plan.steps))


def costs(problem: Problem, seconds: float) -> list[tuple[float, float]] | None:
    """Cost and seconds of the first plan, of the default's, and of the best of a search that goes on; None if there is no plan."""
    found: list[tuple[float, float]] = []
    for improve in (0.0, IMPROVE):
        began = perf_counter()
        plan = solve(problem, improve=improve).plan
        if plan is None:
            return None
        found.append((cost(plan), perf_counter() - began))
    best = kairos.solve(parse_for_kairos(problem), timeout=seconds, anytime=True, threads=1).plan
    reference = found[-1][0] if best is None else min(found[-1][0], best.cost if plan.cost is not None else best.makespan())
    return [*found, (reference, seconds)]


def main() -> None:
    arguments = sys.argv[1:]
    seconds = float(arguments.pop(arguments.index("--seconds") + 1)) if "--seconds" in arguments else 30.0
    folders = [Path(name) for name in arguments if not name.startswith("--")] or [KNOWN / "robots", KNOWN / "ipc"]
    gaps: list[float] = []
    print(f"| problem | first | default | {seconds:g} s | gap |\n|---|---:|---:|---:|---:|")
    for name in (folder / pair["name"] for folder in folders for pair in json.loads((folder / "manifest.json").read_text())):
        try:
            found = costs(load(name / "domain.pddl", name / "problem.pddl"), seconds)
        except InputError:
            continue
        if found is not None:
            (first, _), (default, took), (best, _) = found
            gaps.append(default / best - 1.0 if best else 0.0)
            print(f"| {name.name} | {first:g} | {default:g} in {took:.2f} s | {best:g} | {gaps[-1]:.1%} |", flush=True)
    print(f"\nmedian gap {median(gaps):.1%} over {len(gaps)} problems")


if __name__ == "__main__":
    main()
