"""The four problems of the ROSCon 2024 deliberation workshop, in PyRoboSim's simulator. Not a test: `python -m tests.benchmarks.roscon`.

Each seed is a run of the real planner and executor on a world in this process, without drawing or waiting, with the household's bindings
and sensors. Whether its goal is reached is judged by the simulator's own state: a run that says so wrongly is a false success.
Beside it stand two baselines: the workshop's linear solution, which ends with the first action that fails, and the same with retries.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from statistics import mean
from typing import Final

from tests.support.e2e.household.in_process import in_world, pursue
from tests.support.e2e.household.simulator import has_reached, load_world, perform, without_waiting
from tests.support.files import SHARED

SNACKS: Final = ("navigate pantry", "pick snacks0", "navigate table", "place snacks0")
WASTE: Final = (
    *("navigate hall_dining_trash", "open hall_dining_trash", "navigate dumpster", "open dumpster"),
    *("navigate desk", "pick waste0", "navigate dumpster", "place waste0"),
    *("navigate bin", "pick waste1", "navigate dumpster", "place waste1", "close dumpster"),
)
BREAKFAST: Final = (
    *("navigate pantry", "open pantry", "detect bread0", "pick bread0", "navigate table", "place bread0"),
    *("navigate fridge", "open fridge", "detect butter0", "pick butter0", "navigate table", "place butter0"),
    *("navigate fridge", "close fridge", "navigate pantry", "close pantry"),
)
CHARGE: Final = ("navigate hall_closet_dining", "open hall_closet_dining", "navigate charger")
LINEAR: Final = {1: SNACKS, 2: WASTE, 3: BREAKFAST, 4: (*BREAKFAST, *CHARGE, *WASTE)}
"""The workshop's solutions by hand, up to the goal."""


@dataclass(frozen=True)
class Trial:
    """What became of one seed."""

    seed: int
    claimed: bool
    """Whether the run says that the goal is reached."""
    reached: bool
    """Whether it is, by the simulator."""
    actions: int
    """Attempts that failed included."""
    replans: int
    seconds: float
    ours: float
    """Seconds of these that were spent on planning, on machines and on their proofs; most of the others go into the simulator's paths."""
    why: str = ""
    """Of a failure."""


def our_way(problem: int, folder: Path | None, seed: int) -> Trial:
    """Pursue the goal with planner, executor and replanning."""
    backend, began = in_world(problem, seed, folder), time.perf_counter()
    result = pursue(backend)
    seconds, reached = time.perf_counter() - began, has_reached(backend.world, problem)
    why = "" if result.goal_reached and reached else f"{'the battery is empty' if backend.spent else result.code.word}: {result.reason}"
    ours = sum(result.seconds[part] for part in ("plan", "translate", "verify"))
    return Trial(seed, result.goal_reached, reached, backend.actions, result.replans, seconds, ours, why)


def linear_way(retries: int, problem: int, folder: Path | None, seed: int) -> Trial:
    """Perform the solution by hand, each action with so many retries."""
    world, actions, began = load_world(problem, seed, folder), 0, time.perf_counter()

    def succeeds(action: str) -> bool:
        nonlocal actions
        kind, _, what = action.partition(" ")
        for _ in range(retries + 1):
            actions += 1
            wanted = {"robot": "robot", "type": kind, "object": what, "target_location": what}
            if perform(world, wanted).is_success():
                return True
        return False

    with without_waiting():
        claimed = all(map(succeeds, LINEAR[problem]))
    return Trial(seed, claimed, has_reached(world, problem), actions, 0, time.perf_counter() - began, 0.0)


def show(problem: int, name: str, trials: Sequence[Trial]) -> None:
    """Print a line about a way in a problem, and why its runs failed."""
    reached, false = sum(trial.reached for trial in trials), sum(trial.claimed and not trial.reached for trial in trials)
    figures = [f"{mean(getattr(trial, figure) for trial in trials):>8.2f}" for figure in ("actions", "replans", "seconds", "ours")]
    print(f"{problem:>7}  {name:<22}{100 * reached / len(trials):>8.2f} %{false:>7}{''.join(figures)}", flush=True)
    for why, times in Counter(trial.why.partition(":")[0] for trial in trials if trial.why).most_common():
        print(f"{'':9}{times} × {why}")
    for trial in trials:
        if trial.why:
            print(f"{'':9}seed {trial.seed}: {trial.why}")


def main() -> None:
    parser = argparse.ArgumentParser(description="the workshop's four problems, many times")
    parser.add_argument("--seeds", type=int, default=20, help="how many runs of each problem")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--problem", type=int, choices=LINEAR, help="only this one")
    parser.add_argument("--retries", type=int, default=3, help="of each action in the second baseline")
    there = SHARED / "pyrobosim" / "worlds"
    parser.add_argument(
        "--worlds", type=Path, help="folder of the workshop's worlds, world1.yaml to world4.yaml; else a house of this project"
    )
    parser.set_defaults(worlds=there if there.is_dir() else None)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--no-baselines", action="store_true", help="only planner and executor")
    options = parser.parse_args()
    ways = {"planned and executed": our_way}
    if not options.no_baselines:
        ways |= {"linear": partial(linear_way, 0), f"linear, {options.retries} retries": partial(linear_way, options.retries)}
    seeds = range(options.first, options.first + options.seeds)
    print(f"worlds of {options.worlds or 'this project'}, seeds {seeds.start} to {seeds.stop - 1}")
    print(f"problem  {'':<22}{'reached':>10}{'false':>7}{'actions':>8}{'replans':>8}{'seconds':>8}{'ours':>8}")
    with ProcessPoolExecutor(options.jobs) as processes:
        for problem in [options.problem] if options.problem else LINEAR:
            for name, way in ways.items():
                show(problem, name, list(processes.map(way, repeat(problem), repeat(options.worlds), seeds)))


if __name__ == "__main__":
    main()
