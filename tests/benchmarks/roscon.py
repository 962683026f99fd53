"""The four problems of the ROSCon 2024 deliberation workshop. Not a test: `python -m tests.benchmarks.roscon --seeds 200 --worlds FOLDER`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from planner_bridge.loading import load
from planner_bridge.pipeline import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.bindings_file import read_bindings
from pnm.clock import run_async
from pnm.knowledge.sensor_file import read_sensing
from tests.support.e2e.household.in_process import SimulatorBackend
from tests.support.e2e.household.simulator import has_reached, load_world, without_waiting
from tests.support.files import ROOT

HOUSEHOLD = ROOT / "domains" / "household"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--problem", type=int)
    parser.add_argument("--worlds", type=Path)
    options = parser.parse_args()
    for number in [options.problem] if options.problem else (1, 2, 3, 4):
        problem = load(HOUSEHOLD / "domain.pddl", HOUSEHOLD / f"problem{number}.pddl")
        bindings = read_bindings(HOUSEHOLD / "bindings.yaml", problem.vocabulary)
        sensing = read_sensing(HOUSEHOLD / "sensing.yaml", problem.vocabulary)
        for seed in range(options.first, options.first + options.seeds):
            world = load_world(options.worlds / f"world{number}.yaml", seed)
            backend = SimulatorBackend(world, bindings, sensing)
            began = time.perf_counter()
            with without_waiting():
                result = run_async(achieve_at(backend, problem, Settings(bindings=bindings, limits=Limits())), virtual=True)
            took = time.perf_counter() - began
            print(
                number,
                seed,
                result.goal_reached,
                has_reached(world, number),
                backend.client.actions,
                result.replans,
                f"{took:.2f}",
                round(world.robots[0].battery_level),
                "" if result.goal_reached else result.reason,
                flush=True,
            )


if __name__ == "__main__":
    main()
