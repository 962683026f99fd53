"""Problems of several outcomes, played trial by trial: planner, machine and executor in a world that draws."""

from __future__ import annotations

import os
import time
from math import sqrt
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import mean
from typing import Any, Final, NamedTuple

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.clock import run_async
from tests.support.pddl.outcomes.optimum import optimum
from tests.support.pddl.outcomes.problem import Chance
from tests.support.pddl.outcomes.reading import determinized
from tests.support.pddl.outcomes.world import ChanceWorld

HANGS: Final = "no end"
"""Why a trial has failed whose process said nothing for too long."""
SPAWN: Final = get_context("spawn")


class Way(NamedTuple):
    """How a problem is played."""

    way: str
    limit: int
    seconds: float


class Asked(TaskObserver):
    """Counts how often a planner is asked."""

    def __init__(self) -> None:
        self.times = 0

    def planning(self, planner: str) -> None:
        """Count."""
        self.times += 1


def problem_of(folder: Path, chance: Chance, way: Way) -> Problem:
    """Read the problem for the planner."""
    if way.way != "replanner":
        return load(folder / "domain.pddl", folder / "problem.pddl")
    return parse_problem((folder / "problem.pddl").read_text(encoding="utf-8"), parse_domain(determinized(chance.domain)))


def trial(chance: Chance, problem: Problem, way: Way, seed: int) -> dict[str, Any]:
    """Pursue the goal once."""
    world, asked, began = ChanceWorld(chance, problem, seed, way.limit), Asked(), time.perf_counter()
    result = run_async(achieve_at(world, problem, Settings(), asked), virtual=True)
    seconds = time.perf_counter() - began
    return {
        "seed": seed,
        "claimed": result.goal_reached,
        "reached": world.has_reached,
        "actions": world.actions,
        "asked": asked.times,
        "first": None if world.first is None else world.first - began,
        "seconds": seconds,
        "why": "" if result.goal_reached else f"{result.code.word}: {result.reason}"[:300],
    }


def play(results: Connection, folder: Path, way: Way, seeds: list[int], has_optimum: bool) -> None:
    """Play a problem, in a process of its own: send the optimum, then the trials as they come."""
    chance, began = Chance.read(folder), time.perf_counter()
    if not has_optimum:
        best = optimum(chance)
        results.send({"optimum": None if best is None else {"chance": best.chance, "steps": best.steps, "states": len(best.best)}})
    began = time.perf_counter()
    problem = problem_of(folder, chance, way)
    results.send({"read": time.perf_counter() - began})
    for seed in seeds:
        results.send(trial(chance, problem, way, seed))
    results.close()
    os._exit(0)  # the planner's library complains of what is left at a proper end


def fill(folder: Path, way: Way, trials: int, known: dict[str, Any]) -> None:
    """Play the trials that are not known yet, in processes; one that says nothing for too long is ended, and its trial hangs."""
    in_a_row = 0
    known.setdefault("trials", [])
    while left := [seed for seed in range(trials) if seed not in {one["seed"] for one in known["trials"]}]:
        ours, theirs = SPAWN.Pipe(duplex=False)
        process = SPAWN.Process(target=play, args=(theirs, folder, way, left, "optimum" in known), daemon=True)
        process.start()
        theirs.close()
        why = HANGS
        try:
            while ours.poll(way.seconds):
                told = ours.recv()
                if "seed" in told:
                    known["trials"].append(told)
                    in_a_row = 0
                else:
                    known |= told
        except EOFError:
            why = "crashed"
        process.kill()
        process.join()
        over = {one["seed"] for one in known["trials"]}
        if "optimum" not in known:
            known["optimum"] = None
        elif still := [seed for seed in left if seed not in over]:
            known["trials"].append({"seed": still[0], "claimed": False, "reached": False, "actions": 0, "asked": 0, "why": why})
            in_a_row += 1
            if in_a_row == 3:
                break


def row(pair: dict[str, Any], found: dict[str, Any]) -> str:
    """Return the line of a problem."""
    trials, best = found["trials"], found.get("optimum") or {}
    good = [one for one in trials if one["reached"]]
    firsts = [one["first"] for one in trials if one.get("first") is not None]
    spent, actions = sum(one.get("seconds", 0.0) for one in trials), sum(one["actions"] for one in trials)
    cells = (
        f"{len(good)}/{len(trials)}",
        f"{best['chance']:.3f}" if best else "",
        *(published(pair, who, "succeeded") for who in ("prp", "ffr")),
        f"{mean(one['actions'] for one in good):.1f}" if good else "",
        f"{best['steps']:.1f}" if best.get("steps") is not None else "",
        published(pair, "prp", "actions"),
        f"{mean(one['asked'] for one in trials):.1f}" if trials else "",
        f"{found['read'] + firsts[0]:.2f}" if firsts else "",
        f"{1000 * spent / actions:.1f}" if actions else "",
        sum(one["claimed"] and not one["reached"] for one in trials),
        sum(one["why"] == HANGS for one in trials),
    )
    return f"| {pair['name']} | {' | '.join(map(str, cells))} |"


def published(pair: dict[str, Any], who: str, what: str) -> str:
    """Return a figure that was published, empty if there is none."""
    figure = (pair.get(who) or {}).get(what, "-")
    return "" if figure in ("-", "-1") else str(figure)


def behind(pair: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Return what is behind by more than two standard errors of both samples: the published success rates, and the optimum."""
    trials, said = found["trials"], []
    share = sum(one["reached"] for one in trials) / max(1, len(trials))
    goals = {who: float(figure) / 100 for who in ("prp", "ffr") if (figure := published(pair, who, "succeeded"))}
    if best := found.get("optimum"):
        goals["the optimum"] = best["chance"]
    for who, goal in goals.items():
        spread = max(goal * (1 - goal), share * (1 - share))
        if share < goal - 2 * sqrt(spread / max(1, len(trials)) + (spread / 100 if who in ("prp", "ffr") else 0.0)) - 1e-9:
            said.append(who)
    return said
