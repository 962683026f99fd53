"""Problems of several outcomes, played trial by trial: planner, machine and executor in a world that draws."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from math import sqrt
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import mean
from typing import Any, Final, NamedTuple

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import PlanningResult, PlanningStatus, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.settings import Memory, Settings, TaskObserver
from pnm.clock import run_async
from pnm.core.logic.conditions import evaluate
from tests.support.pddl.outcomes.optimum import optimum
from tests.support.pddl.outcomes.problem import Chance
from tests.support.pddl.outcomes.reading import determinized
from tests.support.pddl.outcomes.world import IMPOSSIBLE, ChanceWorld

HANGS: Final = "no end"
"""Why a trial has failed whose process said nothing for too long."""
SPAWN: Final = get_context("spawn")
_PLANS: Final = 10
"""Times --seconds after which a trial hangs: there may be many searches in it, each of which ends at its own limit."""


class Way(NamedTuple):
    """How a problem is played."""

    way: str
    limit: int
    seconds: float


class Kept(Memory):
    """Keeps what was found, for all trials of a problem. The mutable state is that, and the number of searches.

    Attributes:
        told: of the policy for the initial state, if there is one: the seconds that it took, its entries, whether it is proved.
    """

    def __init__(self) -> None:
        self.searches = 0
        self.policy: Policy | None = None
        self.told: dict[str, Any] = {}
        self._found: dict[frozenset[object], list[tuple[Problem, PlanningResult]]] = {}

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        """Return what was found for the same problem, or what the search finds."""
        alike = self._found.setdefault(frozenset(problem.init.items()), [])
        for other, known in alike:
            if other == problem and other.unknown == problem.unknown:
                return known
        self.searches += 1
        began = time.perf_counter()
        result = search(timeout)
        if (policy := result.policy) and self.searches == 1:
            self.policy = policy
            self.told = {"closed": time.perf_counter() - began, "size": len(policy.entries), "proved": policy.is_proved}
        if result.status in (PlanningStatus.SOLVED, PlanningStatus.UNSOLVABLE):
            alike.append((problem, result))
        return result


def problem_of(folder: Path, chance: Chance, way: Way) -> Problem:
    """Read the problem for the planner."""
    if way.way != "replanner":
        return load(folder / "domain.pddl", folder / "problem.pddl")
    return parse_problem((folder / "problem.pddl").read_text(encoding="utf-8"), parse_domain(determinized(chance.domain)))


def trial(chance: Chance, problem: Problem, way: Way, seed: int, kept: Kept) -> dict[str, Any]:
    """Pursue the goal once."""
    world, searches, began = ChanceWorld(chance, problem, seed, way.limit), kept.searches, time.perf_counter()
    if way.way == "policy":
        why = alone(world, problem, way, kept)
    else:
        result = run_async(achieve_at(world, problem, Settings(planner_timeout=way.seconds / 2, memory=kept), TaskObserver()), virtual=True)
        why = "" if result.goal_reached else f"{result.code.word}: {result.reason}"[:300]
    return {
        "seed": seed,
        "claimed": not why,
        "reached": world.has_reached,
        "actions": world.actions,
        "asked": kept.searches - searches,
        "first": None if world.first is None else world.first - began,
        "seconds": time.perf_counter() - began,
        "why": why,
    }


def alone(world: ChanceWorld, problem: Problem, way: Way, kept: Kept) -> str:
    """Do what the policy says, without machine and executor; return why that does not lead to the goal."""
    knowledge = initial_knowledge(problem)
    world.report_to(knowledge)
    result = kept.plan(problem, way.seconds / 2, lambda timeout: solve(problem, timeout=timeout))
    while evaluate(problem.goal, knowledge) is not True:
        stretch = kept.policy.stretch(knowledge) if kept.policy else None
        if stretch is None or world.is_over:
            return "too many actions" if world.is_over else "the policy says nothing of the state" if kept.policy else result.reason
        for step in stretch.steps:
            world.first, world.actions = world.first or time.perf_counter(), world.actions + 1
            if not world.perform(step.action, step.arguments):
                return IMPOSSIBLE
            if evaluate(problem.goal, knowledge) is True:
                break
    return ""


def play(results: Connection, folder: Path, way: Way, seeds: list[int], has_optimum: bool) -> None:
    """Play a problem, in a process of its own: send the optimum, then the trials as they come."""
    chance, began = Chance.read(folder), time.perf_counter()
    if not has_optimum:
        best = optimum(chance)
        results.send({"optimum": None if best is None else {"chance": best.chance, "steps": best.steps, "states": len(best.best)}})
    began = time.perf_counter()
    problem, kept = problem_of(folder, chance, way), Kept()
    results.send({"read": time.perf_counter() - began})
    for seed in seeds:
        results.send(trial(chance, problem, way, seed, kept))
        results.send(kept.told)
    results.close()
    os._exit(0)  # the planner's library complains of what is left at a proper end


def fill(folder: Path, way: Way, trials: int, known: dict[str, Any]) -> Iterator[None]:
    """Play the trials that are not known yet, in processes; one that says nothing for too long is ended, and its trial hangs.

    Yields whenever more is known.
    """
    in_a_row = 0
    known.setdefault("trials", [])
    while left := [seed for seed in range(trials) if seed not in {one["seed"] for one in known["trials"]}]:
        ours, theirs = SPAWN.Pipe(duplex=False)
        process = SPAWN.Process(target=play, args=(theirs, folder, way, left, "optimum" in known), daemon=True)
        process.start()
        theirs.close()
        why = HANGS
        try:
            while ours.poll(_PLANS * way.seconds):
                told = ours.recv()
                if "seed" in told:
                    known["trials"].append(told)
                    in_a_row = 0
                else:
                    known |= told
                yield
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
        f"{found['closed']:.2f}" if "closed" in found else "",
        published(pair, "prp", "runtime").removesuffix("0000"),
        f"{found['size']}{'' if found['proved'] else '?'}" if "closed" in found else "",
        published(pair, "prp", "size"),
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
