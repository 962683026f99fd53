"""The four problems of the ROSCon 2024 deliberation workshop, in PyRoboSim's simulator. Not a test: `python -m tests.benchmarks.roscon`.

Each seed is a run on a world in this process, without drawing or waiting. Three ways are taken: the real planner and executor, with the
household's bindings and sensors; the workshop's own behaviour tree; and a tree by hand with py_trees. Whether the goal is reached is judged
by the simulator's own state: a run that says so wrongly is a false success. Driving is in seconds at the speed of the robot.

With --mishaps, doors prove to be locked and grasps drop things. Then the ways are planner and executor with a domain that declares what
may come of actions, and with one that does not. With --odds, every run of ours is forecast by its first plan.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from random import Random
from statistics import mean, median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pyrobosim.core import World

from planner_bridge.explanations.learning import learn
from planner_bridge.model.rates import NO_RATES, Rates
from planner_bridge.pipeline.roll_outs import VettedPlan
from planner_bridge.planning.kairos import LONGEST
from planner_bridge.tasks.settings import Memory, Settings
from pnm.actions.faults import NO_FAULTS
from tests.support.benchmarks.forecasts import Forecast, summary
from tests.support.e2e.household.in_process import SimulatorBackend, in_world, pursue
from tests.support.e2e.household.mishaps import with_mishaps
from tests.support.e2e.household.simulator import Work, counted, drive_times, has_reached, load_world, without_waiting
from tests.support.e2e.household.workshop_tree import WorkshopTree
from tests.support.files import ROOT, SHARED

if TYPE_CHECKING:
    from tests.support.e2e.household.tree_by_hand import TreeByHand

Begin: TypeAlias = Callable[[int, int, Path | None], SimulatorBackend]
"""Returns the robots of a problem's world, given the problem, the seed and the folder of worlds."""

PROBLEMS: Final = (1, 2, 3, 4)
OURS: Final = "planned and executed"
TREES: Final = Path("technologies", "BehaviorTree.CPP", "pyrobosim_btcpp", "trees", "solution")
WORLDS: Final = Path("problems", "delib_ws_worlds", "worlds")
"""Where the workshop's repository has its trees and its worlds."""


@dataclass(frozen=True)
class Trial:
    """What became of one seed."""

    seed: int
    claimed: bool
    """Whether the run says that the goal is reached."""
    reached: bool
    """Whether it is, by the simulator."""
    work: Work
    seconds: float
    replans: int = 0
    ours: float = 0.0
    """Seconds of these that were spent on planning, on machines and on their proofs; most of the others go into the simulator's paths."""
    why: str = ""
    """Of a failure."""
    forecast: Forecast | None = None
    """The odds of its first plan, and what came of them."""


def taught(settings: Mapping[str, Any], begin: Begin, problem: int, folder: Path | None, seeds: Sequence[int]) -> Rates:
    """Return what runs with these seeds teach."""
    rates = NO_RATES
    for seed in seeds:
        with TemporaryDirectory() as kept:
            pursue(begin(problem, seed, folder), Path(kept) / "a.journal", **settings, learned=rates)
            rates = learn(Path(kept) / "a.journal", rates)
    return rates


def our_way(
    settings: Mapping[str, Any],
    begin: Begin,
    times: Mapping[tuple[str, str], float],
    with_odds: bool,
    problem: int,
    folder: Path | None,
    seed: int,
) -> Trial:
    """Pursue the goal with planner, executor and replanning; times are those of drives, if the planner knows them."""
    backend, began = begin(problem, seed, folder), time.perf_counter()
    backend.tell(times)
    vetted = VettedPlan(Settings(bindings=backend.bindings, **settings), NO_FAULTS, 0.0) if with_odds else Memory()
    result = pursue(backend, **settings, memory=vetted)
    odds = vetted.odds.best if isinstance(vetted, VettedPlan) and vetted.odds else None
    forecast = Forecast.of(f"problem {problem}", odds, result, Random(seed)) if odds else None
    seconds, reached = time.perf_counter() - began, has_reached(backend.world, problem)
    is_fine, is_spent = result.goal_reached and reached, backend.work.battery <= 0
    why = "" if is_fine else f"{'the battery is empty' if is_spent else result.code.word}: {result.reason}"
    ours = sum(result.seconds[part] for part in ("plan", "translate", "verify"))
    return Trial(seed, result.goal_reached, reached, backend.work, seconds, result.replans, ours, why, forecast)


def tree_way(grown: Callable[[World, int], WorkshopTree | TreeByHand], problem: int, folder: Path | None, seed: int) -> Trial:
    """Run a tree that is grown for the world and the problem."""
    world, began = load_world(problem, seed, folder), time.perf_counter()
    work, tree = counted(world), grown(world, problem)
    with without_waiting():
        claimed = tree.run()
    return Trial(seed, claimed, has_reached(world, problem), work, time.perf_counter() - began)


def workshop_tree(trees: Path, world: World, problem: int) -> WorkshopTree:
    return WorkshopTree(world, trees / f"problem{problem}.xml")


def tree_by_hand(world: World, problem: int) -> TreeByHand:
    from tests.support.e2e.household.tree_by_hand import TreeByHand  # here, because py_trees need not be installed

    return TreeByHand(world, problem)


def show(problem: int, name: str, trials: Sequence[Trial]) -> None:
    """Print a line about a way in a problem, and why its runs failed."""
    reached, false = sum(trial.reached for trial in trials), sum(trial.claimed and not trial.reached for trial in trials)
    work = [trial.work for trial in trials]
    figures = (
        *(mean(one.actions for one in work), mean(one.driving for one in work), median(one.driving for one in work)),
        *(min(one.battery for one in work), mean(trial.replans for trial in trials)),
        *(mean(trial.seconds for trial in trials), mean(trial.ours for trial in trials)),
    )
    row = "".join(f"{figure:>9.2f}" for figure in figures)
    print(f"{problem:>7}  {name:<22}{100 * reached / len(trials):>8.2f} %{false:>7}{row}", flush=True)
    for why, times in Counter(trial.why.partition(":")[0] for trial in trials if trial.why).most_common():
        print(f"{'':9}{times} × {why}")
    for trial in trials:
        if trial.why:
            print(f"{'':9}seed {trial.seed}: {trial.why}")
    if forecasts := [trial.forecast for trial in trials if trial.forecast]:
        print(summary(forecasts), flush=True)


def compare(ours: Sequence[Trial], name: str, others: Sequence[Trial]) -> None:
    """Print on how many of the seeds on which both reach the goal ours drives no longer, and takes no more actions."""
    pairs = [(our.work, other.work) for our, other in zip(ours, others, strict=True) if our.reached and other.reached]
    driving, actions = sum(our.driving <= other.driving for our, other in pairs), sum(our.actions <= other.actions for our, other in pairs)
    print(f"{'':9}beside {name}: of {len(pairs)} seeds, ours drives no longer on {driving}, takes no more actions on {actions}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="the workshop's four problems, many times")
    parser.add_argument("--seeds", type=int, default=20, help="how many runs of each problem")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--problem", type=int, choices=PROBLEMS, help="only this one")
    parser.add_argument("--improve", type=float, default=LONGEST, help="as of pnm run; by default as for robots that take their time")
    parser.add_argument("--taught", type=int, default=0, help="how many runs before, of the seeds before the first, teach ours their rates")
    parser.add_argument(
        "--times", type=int, nargs="?", const=5, default=0, help="ours knows how long drives take, by so many there and back before"
    )
    parser.add_argument("--workshop", type=Path, default=ROOT.parent / "roscon24-workshop", help="the workshop's repository")
    parser.add_argument(
        "--worlds", type=Path, help="folder of world1.yaml to world4.yaml; else the workshop's, else a house of this project"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--mishaps", action="store_true", help="doors prove to be locked, and grasps drop things")
    parser.add_argument("--odds", action="store_true", help="forecast each run of ours by its first plan, and say how right that was")
    parser.add_argument("--only-ours", action="store_true", help="only planner and executor")
    options = parser.parse_args()
    settings = {"improve": options.improve}
    begins: dict[str, Begin] = {OURS: in_world}
    if options.mishaps:
        begins = {name: partial(with_mishaps, is_declared=name == "outcomes declared") for name in ("outcomes declared", "not declared")}
    others: dict[str, Callable[[int, Path | None, int], Trial]] = {}
    if not (options.only_ours or options.mishaps):
        if (trees := options.workshop / TREES).is_dir():
            others["the workshop's tree"] = partial(tree_way, partial(workshop_tree, trees))
        else:
            print(f"without the workshop's trees: there is no folder {trees} (--workshop names the repository)")
        if find_spec("py_trees"):
            others["py_trees by hand"] = partial(tree_way, tree_by_hand)
        else:
            print("without the tree by hand: py_trees is not installed (pip install py_trees)")
    folders = (options.workshop / WORLDS, SHARED / "pyrobosim" / "worlds")
    worlds = options.worlds or next((folder for folder in folders if folder.is_dir()), None)
    seeds, before = range(options.first, options.first + options.seeds), range(options.first - options.taught, options.first)
    print(f"worlds of {worlds or 'this project'}, seeds {seeds.start} to {seeds.stop - 1}, load {os.getloadavg()[0]:.1f}")
    columns = ("actions", "driving", "median", "battery", "replans", "seconds", "ours")
    print(f"problem  {'':<22}{'reached':>10}{'false':>7}{''.join(f'{one:>9}' for one in columns)}")
    with ProcessPoolExecutor(options.jobs) as processes:
        for problem in [options.problem] if options.problem else PROBLEMS:
            trials: dict[str, list[Trial]] = {}
            times = drive_times(problem, worlds, rounds=options.times) if options.times else {}
            ours = {
                name: partial(
                    our_way, {**settings, "learned": taught(settings, begin, problem, worlds, before)}, begin, times, options.odds
                )
                for name, begin in begins.items()
            }
            for name, way in {**ours, **others}.items():
                trials[name] = list(processes.map(way, repeat(problem), repeat(worlds), seeds))
                show(problem, name, trials[name])
            for name in list(trials)[1:]:
                compare(trials[next(iter(ours))], name, trials[name])


if __name__ == "__main__":
    main()
