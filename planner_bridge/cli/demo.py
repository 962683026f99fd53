"""`pnm demo`: two robots deliver parcels, a way is blocked, and the goal is reached all the same."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from rich.console import Console

from planner_bridge.cli.console import ConsoleObserver, print_result
from planner_bridge.loading import load
from planner_bridge.pipeline import achieve_at
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.settings import Settings
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import read_faults
from pnm.clock import run_async
from pnm.core.logic.conditions import conjuncts

_PACKAGE: Final = Path(__file__).parents[1]


def examples() -> Path:
    """Return the folder with `domains` and `problems`: of the checkout, or as installed."""
    return _PACKAGE / "examples" if (_PACKAGE / "examples").is_dir() else _PACKAGE.parent


def show(console: Console) -> int:
    """Run the delivery example with its faults and explain what is shown."""
    domain, problems = examples() / "domains" / "delivery", examples() / "problems" / "delivery"
    problem = load(domain / "domain.pddl", problems / "p01.pddl")
    settings = Settings(bindings=read_bindings(domain / "bindings.yaml", problem.vocabulary))
    faults = read_faults(problems / "faults.yaml", problem.vocabulary)
    backend = simulated_backend(problem, settings.bindings, faults)
    world = backend.robots.world

    console.print("Two robots and a goal, written in PDDL. A planner finds the plan; the plan becomes a Petri Net Machine.", soft_wrap=True)
    for fault in faults.faults:
        text = f"The robots are simulated, and something will go wrong: {fault.what} fails, {fault.message}."
        console.print(text, highlight=False, soft_wrap=True)
    console.print(f"[bold]goal[/]     {' '.join(map(str, conjuncts(problem.goal)))}", highlight=False, soft_wrap=True)
    result = run_async(achieve_at(backend, problem, settings, ConsoleObserver(console)), virtual=True)
    print_result(console, result)
    console.print("In the simulated world, which nobody but the simulation sees:", soft_wrap=True)
    for part in conjuncts(problem.goal):
        console.print(f"         {part} is {'[green]true[/]' if world.holds(part) else '[red]false[/]'}", highlight=False)
    advice = "pnm run DOMAIN PROBLEM with your own files, or pnm net DOMAIN PROBLEM --format dot to see a machine"
    console.print(f"Next: {advice}.", soft_wrap=True)
    return 0 if result.goal_reached and world.holds(problem.goal) else 1
