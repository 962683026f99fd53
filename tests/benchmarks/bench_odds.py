"""Calibration of odds: forecasts of runs on simulated robots with random faults, against one run of each. Not a test.

usage: python -m tests.benchmarks.bench_odds [--runs N] [--trials N] [--seconds S] [--taught K] [--anew N] [--seed N] [--json FILE]

The chances of attempts are those that the faults declare; with --taught they are learned from the journals of K runs in each world,
whose faults stay the same for so many forecasts. A forecast is that of `pnm odds`: exact where no new plan is allowed, else by roll-outs
of S seconds. The runs that it is compared with have other random numbers. The second score is that of a perfect forecast of the same
chances.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import NamedTuple

from planner_bridge.explanations.learning import learn
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Rates
from planner_bridge.pddl import read_domain, read_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.roll_outs import odds_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from tests.support.benchmarks.forecasts import Forecast, summary
from tests.support.files import ROOT

WORLDS = ("delivery/p01", "patrol/p01", "mall_guide/p01", "mall/p01", "household/problem2")
_LATER = 1_000_000
"""The least seed of a run that is forecast: roll-outs have smaller ones."""


class Scene(NamedTuple):
    """A world in which robots fail, and what is known of that beforehand."""

    world: str
    problem: Problem
    faults: Faults
    rates: Rates | None
    """Learned ones; None if the faults are known."""


def scene(world: str, random: Random, taught: int) -> Scene:
    """Return a world with random faults; `taught` runs in it teach their rates, if there are any."""
    folder, name = world.split("/")
    file = next(file for place in ("problems", "domains") if (file := ROOT / place / folder / f"{name}.pddl").exists())
    problem = read_problem(file, read_domain(ROOT / "domains" / folder / "domain.pddl"))
    kinds, worst = (FaultKind.ABORT, FaultKind.REJECT, FaultKind.NO_EFFECT, FaultKind.HANG), random.uniform(0.0, 0.6)
    faults = Faults(tuple(Fault(action, random.choice(kinds), chance=random.uniform(0.0, worst)) for action in problem.domain.actions))
    rates = NO_RATES
    with TemporaryDirectory() as kept:
        for number in range(taught):
            place = Path(kept) / f"{number}.journal"
            achieve(None, problem, faults=replace(faults, seed=3 * _LATER + number), settings=settings(problem, random), journal=place)
            rates = learn(place, rates)
    return Scene(world, problem, faults, rates if taught else None)


def settings(problem: Problem, random: Random) -> Settings:
    """Return settings with random retries and limits."""
    bindings = Bindings({action: Binding(retries=random.randint(0, 2)) for action in problem.domain.actions})
    return Settings(improve=0.0, bindings=bindings, limits=Limits(replans=random.choice((0, 0, 2, 10))))


def forecasts(given: Scene, random: Random, seconds: float, trials: int) -> Iterator[Forecast]:
    """Yield the forecast of runs, for each of them; nothing if there was no time for one."""
    found, chosen = solve(given.problem, improve=0.0).plan, settings(given.problem, random)
    assert found is not None
    chosen, known = replace(chosen, learned=given.rates or NO_RATES), given.faults if given.rates is None else NO_FAULTS
    odds = odds_of_goal(given.problem, found, chosen, known, seconds=seconds).best
    for _ in range(trials if odds else 0):
        assert odds is not None
        result = achieve(None, given.problem, faults=replace(given.faults, seed=random.randint(_LATER, 2 * _LATER)), settings=chosen)
        yield Forecast.of(given.world, odds, result, random)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.bench_odds", description="the calibration of odds")
    parser.add_argument("--runs", type=int, default=200, metavar="N", help="forecasts")
    parser.add_argument("--trials", type=int, default=1, metavar="N", help="runs that each forecast is compared with")
    parser.add_argument("--seconds", type=float, default=0.5, metavar="S", help="processor seconds for the roll-outs of each")
    parser.add_argument(
        "--taught", type=int, default=0, metavar="K", help="runs that teach the rates of each world; 0: faults are declared"
    )
    parser.add_argument(
        "--anew", type=int, default=4, metavar="N", help="forecasts of a world before its faults change, if rates are learned"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the random faults")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep every forecast")
    arguments = parser.parse_args()
    random = Random(arguments.seed)
    found: list[Forecast] = []
    scenes: list[Scene] = []
    for number in range(arguments.runs):
        if number % (arguments.anew * len(WORLDS) if arguments.taught else 1) == 0:
            scenes = [scene(world, random, arguments.taught) for world in WORLDS]
        found += forecasts(scenes[number % len(WORLDS)], random, arguments.seconds, arguments.trials)
    if arguments.json:
        arguments.json.write_text(json.dumps([one._asdict() for one in found]) + "\n", encoding="utf-8")
    print(summary(found))


if __name__ == "__main__":
    main()
