"""Calibration of odds: forecasts of runs on simulated robots with random faults, against one run of each. Not a test.

usage: python -m tests.benchmarks.bench_odds [--runs N] [--seconds S] [--seed N] [--json FILE]

Each forecast is that of `pnm odds`: exact where no new plan is allowed, else by roll-outs of S seconds. The run that it is compared with
has other random numbers. A perfect forecast of the same chances would have the Brier score in the last column on average.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from math import sqrt
from pathlib import Path
from random import Random
from typing import NamedTuple

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import read_domain, read_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.odds import declared, exact, odds_of_calls
from planner_bridge.pipeline.roll_outs import roll_outs_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from tests.support.files import ROOT

WORLDS = ("delivery/p01", "delivery/p02", "patrol/p01", "patrol/p02", "mall_guide/p01")
_LATER = 1_000_000
"""The least seed of a run that is forecast: roll-outs have smaller ones."""


class Forecast(NamedTuple):
    """A forecast, and what came of it."""

    world: str
    chance: float
    reached: bool
    seconds: float | None
    """The share of the forecast times below that of the run; None if it did not reach the goal."""


def forecast(world: str, random: Random, seconds: float) -> Forecast | None:
    """Return the forecast of a run with random faults, retries and limits; None if there was no time for one."""
    folder, name = world.split("/")
    problem = read_problem(ROOT / "problems" / folder / f"{name}.pddl", read_domain(ROOT / "domains" / folder / "domain.pddl"))
    found = solve(problem, improve=0.0).plan
    assert found is not None
    kinds, worst = (FaultKind.ABORT, FaultKind.REJECT, FaultKind.NO_EFFECT, FaultKind.HANG), random.uniform(0.0, 0.6)
    faults = Faults(tuple(Fault(action, random.choice(kinds), chance=random.uniform(0.0, worst)) for action in problem.domain.actions))
    bindings = Bindings({action: Binding(retries=random.randint(0, 2)) for action in problem.domain.actions})
    settings = Settings(improve=0.0, bindings=bindings, limits=Limits(replans=random.choice((0, 0, 2, 10))))
    graph = plan_graph(problem, found)
    calls = odds_of_calls(graph, bindings, declared(faults, bindings, 0.0 if problem.is_timed else 1.0))
    odds = exact(graph, calls, initial_knowledge(problem)) if calls and not settings.limits.replans else None
    odds = odds or roll_outs_of_goal(problem, found, settings, faults, seconds)
    if odds is None:
        return None
    result = achieve(None, problem, faults=replace(faults, seed=random.randint(_LATER, 2 * _LATER)), settings=settings)
    took = max((call.ended - result.began for call in result.calls if call.ended is not None), default=0.0)
    below = sum(time < took for time in odds.times) / len(odds.times) if odds.times and result.goal_reached else None
    return Forecast(world, odds.chance, result.goal_reached, below)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.bench_odds", description="the calibration of odds")
    parser.add_argument("--runs", type=int, default=200, metavar="N", help="forecasts, each with a run")
    parser.add_argument("--seconds", type=float, default=0.5, metavar="S", help="processor seconds for the roll-outs of each")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the random faults")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep every forecast")
    arguments = parser.parse_args()
    random = Random(arguments.seed)
    made = (forecast(WORLDS[number % len(WORLDS)], random, arguments.seconds) for number in range(arguments.runs))
    forecasts = [one for one in made if one is not None]
    if arguments.json:
        arguments.json.write_text(json.dumps([one._asdict() for one in forecasts]) + "\n", encoding="utf-8")
    print(summary(forecasts))


def summary(forecasts: list[Forecast]) -> str:
    """Return the Brier score, the tenths and the times of forecasts."""
    tenths: dict[int, list[Forecast]] = defaultdict(list)
    for one in forecasts:
        tenths[min(9, int(10 * one.chance))].append(one)
    brier = sum((one.chance - one.reached) ** 2 for one in forecasts) / len(forecasts)
    perfect = sum(one.chance * (1.0 - one.chance) for one in forecasts) / len(forecasts)
    lines = [f"{len(forecasts)} runs: Brier score {brier:.4f}, {perfect:.4f} if all chances are right"]
    for tenth, ones in sorted(tenths.items()):
        meant, seen = (sum(values) / len(ones) for values in ([one.chance for one in ones], [one.reached for one in ones]))
        by_luck = sqrt(sum(one.chance * (1.0 - one.chance) for one in ones)) / len(ones)
        lines.append(
            f"{tenth * 10:3} to {tenth * 10 + 10:3} %: {len(ones):4} runs, {meant:.3f} forecast, {seen:.3f} reached, ±{by_luck:.3f} by luck"
        )
    below = sorted(one.seconds for one in forecasts if one.seconds is not None)
    shares = [sum(share <= bound for share in below) / max(1, len(below)) for bound in (0.5, 0.9)]
    lines.append(f"times: {shares[0]:.2f} within the median, {shares[1]:.2f} within the time of 90 %, of {len(below)}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
