"""From a failure to the first action of the new plan. Not a test: `python tests/benchmarks/bench_replanning.py [FOLDER...]`.

Simulated robots, in real time but fast, fail by chance; a folder holds domain.pddl and problem.pddl. Without any, the project's own
problems are measured. What is measured lies between two calls of an observer in one process: knowing that there is a failure,
deciding what follows, planning, the plan graph, the machine, its proof, and its begin, with which the first request goes out unless
it has to wait for a call that is under way. Only failures after which a planner was asked are counted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from pnm.actions.bindings_file import read_bindings
from pnm.core.machine.bindings import Bindings
from pnm.errors import PnmError
from tests.support.benchmarks.failures import measured


def problems_named(arguments: list[str]) -> list[tuple[str, Problem, Bindings]]:
    """The problems to be measured, those left out that cannot be read."""
    found = []
    if not arguments:
        for file in sorted((ROOT / "problems").glob("*/p*.pddl")):
            folder = ROOT / "domains" / file.parent.name
            problem = load(folder / "domain.pddl", file)
            bindings = folder / "bindings.yaml"
            found.append((f"{file.parent.name}/{file.stem}", problem, read_bindings(bindings) if bindings.exists() else Bindings()))
    for folder in map(Path, arguments):
        try:
            found.append((folder.name, load(folder / "domain.pddl", folder / "problem.pddl"), Bindings()))
        except PnmError as error:
            print(f"{folder.name}: {str(error)[:80]}")
    return found


def main(arguments: list[str]) -> None:
    every: list[tuple[float, float]] = []
    print(f"{'problem':34} {'failures':>8} {'median':>9} {'planner':>9} {'worst':>9}")
    for name, problem, bindings in problems_named(arguments):
        found = measured(problem, bindings)
        every += found
        if found:
            whole, planner = [one[0] for one in found], [one[1] for one in found]
            times = (median(whole), median(planner), max(whole))
            print(f"{name:34} {len(found):8} " + " ".join(f"{1000 * one:6.1f} ms" for one in times))
        else:
            print(f"{name:34} {0:8}")
    if every:
        share = sum(one[1] for one in every) / sum(one[0] for one in every)
        print(f"all: {len(every)} failures, median {1000 * median(one[0] for one in every):.1f} ms, the planner's share {share:.0%}")


if __name__ == "__main__":
    main(sys.argv[1:])
