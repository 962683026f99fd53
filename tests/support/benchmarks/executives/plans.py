"""Plans by hand, commands, machines of plans, changes of facts, shared resources, new plans, first requests, and goals over ROS 2."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from functools import cache, partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import kairos

from planner_bridge.cli.convert import imported
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.planning.kairos import parse_for_kairos
from planner_bridge.planning.solve import reduced, solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.execution.machine_index import prepare
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Compare, evaluate
from pnm.core.logic.expressions import Constant, ValueOf
from pnm.core.machine.generate import generate
from pnm.core.machine.verification.verify import verify
from tests.support.benchmarks.failures import measured, tour
from tests.support.benchmarks.patrol import taken_up
from tests.support.benchmarks.peers.worker import Measure, NotHere, each
from tests.support.benchmarks.waiting import (
    CHARGE,
    LAMP,
    OTHER,
    fact,
    fleet,
    hall,
    report,
    rounds,
    searched,
    taking_turns,
    ways,
    ways_at_first,
)
from tests.support.files import ROOT
from tests.support.pddl.problems import tiles

_CLEAN = """
(define (domain cleaning) (:requirements :typing) (:types robot room)
  (:predicates (ready ?r - robot) (free ?a - room) (finished ?r - robot))
  (:action clean :parameters (?r - robot ?a - room) :precondition (and (ready ?r) (free ?a)) :effect (finished ?r)))
"""
GOALS = 300
"""Sent over ROS 2 in one round."""


def machine(size: int) -> float:
    """From a plan of calls that clean a room to a machine that is proved and compiled."""
    robots = [f"r{number}" for number in range(size)]
    text = f"(define (problem p) (:domain cleaning) (:objects {' '.join(robots)} - robot kitchen - room) (:init (free kitchen) "
    text += f"{' '.join(f'(ready {robot})' for robot in robots)}) (:goal (and {' '.join(f'(finished {robot})' for robot in robots)})))"
    problem = parse_problem(text, parse_domain(_CLEAN))
    plan = Plan(tuple(PlanStep("clean", (robot, "kitchen"), float(number)) for number, robot in enumerate(robots)))

    def make() -> None:
        made = generate(plan_graph(problem, plan))
        verify(made)
        prepare(made)

    return each(make, size)


def change_unindexed(size: int) -> float:
    """A change of a fact where all conditions are judged, as executives do that look at everything whenever they look."""
    world = KnowledgeBase({("charge", f"r{index}"): 9.0 for index in range(size)})
    conditions = [Compare(">=", ValueOf(("charge", f"r{index}")), Constant(1.0)) for index in range(size)]
    return each(lambda: [evaluate(condition, world) for condition in conditions], 1)


def lamps_looked_at(size: int) -> float:
    """The same for one condition over so many objects."""
    lit = dict.fromkeys((("lit", f"l{index}") for index in range(size)), True)
    return each(lambda: all(map(lit.__getitem__, lit)), 1)


def _asked(calls: int) -> tuple[Problem, Plan]:
    """A plan of so many calls of which none is needed more than another, and without one all others can be carried out."""
    domain = """(define (domain d) (:requirements :fluents) (:predicates (ready)) (:functions (asked))
      (:action ask :parameters () :precondition (ready) :effect (increase (asked) 1)))"""
    text = f"(define (problem p) (:domain d) (:init (ready) (= (asked) 0)) (:goal (>= (asked) {calls})))"
    return parse_problem(text, parse_domain(domain)), Plan(tuple(PlanStep("ask", (), float(number)) for number in range(calls)))


def needless(size: int) -> float:
    """Milliseconds of the search for needless calls in a plan where each has to be tried to its end."""
    problem, plan = _asked(size)
    return each(lambda: reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan)), 1000)


def valid(size: int) -> float:
    """Milliseconds of one simulation of the same plan."""
    problem, plan = _asked(size)
    return each(lambda: why_invalid(problem, plan), 1000)


def plan_of_tiles(size: int) -> float:
    """Milliseconds of the search for a plan that Kairos' first way of searching does not find soon."""
    problem = tiles(size, size)
    return each(lambda: solve(problem, improve=0.04, timeout=120.0), 1000)


def plan_of_tiles_by_kairos(size: int) -> float:
    """The same of Kairos as it is by default, with a thread for each core."""
    problem = parse_for_kairos(tiles(size, size))
    return each(lambda: kairos.Planner().solve(problem, anytime=False, timeout=120.0), 1000)


# --- as users run it ----------------------------------------------------------------------------------


def written(size: int, *, is_kept: bool = False) -> float:
    """A file with a plan of so many calls: read, proved, carried out by simulated robots as a task, perhaps with a journal."""
    with TemporaryDirectory() as folder:
        file, journal = Path(folder) / "plan.yaml", Path(folder) / "journal" if is_kept else None
        file.write_text("actions: {act: {}}\nplan:\n" + "  - act:\n" * size)
        return each(lambda: carry_out(file, journal=journal), size)


def imports(size: int) -> float:
    """A domain of so many actions in YAML, written as PDDL."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "domain.yaml"
        action = "{params: '?x', preconditions: '(ready ?x)', effects: '(done ?x)'}"
        known = "predicates: ['(ready ?x)', '(done ?x)']\n"
        file.write_text(f"{known}actions:\n" + "".join(f"  act{number}: {action}\n" for number in range(size)))
        return each(lambda: imported(file), size)


def command(*words: str) -> Measure:
    """Return the measure of a command: the milliseconds of the processor that its process takes."""

    def measure(_: int) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], capture_output=True, check=True, cwd=ROOT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return 1000 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)

    return measure


# --- whole ways, by the clock on the wall -------------------------------------------------------------


@cache
def _failures(calls: int) -> list[tuple[float, float]]:
    """Milliseconds from a failure to the next request, and of the planner in them, in a tour of so many calls."""
    problem = tour(calls)
    measured(problem, range(1))  # which shapes of blocks are good is known from then on
    found = measured(problem, range(1, 5))
    return [(1000 * whole, 1000 * planner) for whole, planner in found]


def _files(domain: str, number: int) -> tuple[Path, Path]:
    return ROOT / "domains" / domain / "domain.pddl", ROOT / "problems" / domain / f"p{number:02}.pddl"


def failure(size: int) -> float:
    """The median of a few failures, which are measured anew."""
    _failures.cache_clear()
    return median(whole for whole, _ in _failures(size))


def failure_planner(size: int) -> float:
    """What the planner took of the same failures."""
    return median(planner for _, planner in _failures(size))


def process(command: list[str], size: int) -> float:
    """The milliseconds of a whole process that gets a domain and a problem."""
    began = time.perf_counter()
    done = subprocess.run([*command, *map(str, _files("mall", size))], capture_output=True, text=True, timeout=120, cwd=ROOT)
    took = (time.perf_counter() - began) * 1000
    if done.returncode:
        raise NotHere((done.stderr.splitlines() or ["it failed"])[-1])
    return took


def goals(who: str, size: int) -> float:
    """Milliseconds for each goal over ROS 2 with so many in flight."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_ros", "measured", who, str(size), str(GOALS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT)
    if done.returncode:
        raise NotHere((done.stderr.splitlines() or ["it failed"])[-1])
    rate, _ = json.loads(done.stdout)
    return float(1000 / rate)


_FIRST = [sys.executable, "-m", "tests.support.benchmarks.executives.first_request"]

MEASURES: dict[str, Measure] = {
    "written": written,
    "written-kept": partial(written, is_kept=True),
    "import": imports,
    "help": command("-m", "planner_bridge", "--help"),
    "simulated": command("-m", "planner_bridge", "run", *map(str, _files("delivery", 1)), "-q"),
    "python": command("-c", "pass"),
    "machine": machine,
    "change": lambda size: fact(fleet(size), CHARGE),
    "change-unread": lambda size: fact(fleet(size), OTHER),
    "change-unindexed": change_unindexed,
    "lamp": lambda size: fact(hall(size), LAMP),
    "lamp-unread": lambda size: fact(hall(size), OTHER),
    "lamps-looked-at": lamps_looked_at,
    "report": report,
    "rounds": lambda _: rounds(),
    "taken-up": taken_up,
    "ways": ways,
    "ways-first": ways_at_first,
    "ways-searched": searched,
    "resource": taking_turns,
    "needless": needless,
    "valid": valid,
    "plan-tiles": plan_of_tiles,
    "plan-tiles-kairos": plan_of_tiles_by_kairos,
    "failure": failure,
    "failure-planner": failure_planner,
    "first-request": partial(process, [*_FIRST, "ours"]),
    "first-plan-up": partial(process, [*_FIRST, "unified-planning"]),
    "first-plan-kairos": partial(process, [str(Path(sys.executable).parent / "kairos"), "--no-anytime"]),
    "ros-ours": partial(goals, "ours"),
    "ros-bare": partial(goals, "bare"),
}
