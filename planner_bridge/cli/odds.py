"""`pnm odds`: the chance and the time of a goal, before a robot moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import command
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.loading import bindings_for
from planner_bridge.pipeline.odds import CallOdds, Leads, Odds, declared, exact, odds_of_calls, percent
from planner_bridge.pipeline.roll_outs import SECONDS, roll_outs_of_goal, roll_outs_of_plan
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Faults
from pnm.core.logic.expressions import fluent_text
from pnm.errors import InputError
from pnm.language.plan import chosen_plan, read_plans

_WEAKEST = 3
"""Calls that are printed, at most."""


@click.command(epilog="Example: pnm odds domain.pddl problem.pddl --faults faults.yaml")
@options.files_or_plan
@options.set_option
@options.bindings_option
@options.faults_option
@options.planning
@click.option("--replans", type=click.IntRange(0), default=10, show_default=True, help="new machines after the first, at most")
@click.option("--seconds", type=options.Seconds(0), default=SECONDS, show_default=True, help="seconds of processor time for roll-outs")
@options.as_json_option
@command
def odds(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    given: tuple[str, ...],
    bindings: Path | None,
    faults: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
    replans: int,
    seconds: float,
    as_json: bool,
) -> int:
    """Say how likely and how soon a goal is reached.

    The chance is exact as long as nothing is planned anew. What new plans add is found by roll-outs: runs of the machine on simulated
    robots. Chances of single attempts are those of --faults.
    """
    chosen, settings = options.chosen_files(domain, problem, plan_file), Settings(planner, planner_timeout, limits=Limits(replans=replans))
    roll: Callable[[Settings, Faults, float], Odds | None]
    if isinstance(chosen, Path):
        plans = read_plans(chosen)
        plan = plans[chosen_plan(plans, name)]
        options.print_warnings(plan.warnings)
        settings = replace(settings, bindings=read_bindings(bindings).before(plan.bindings) if bindings else plan.bindings)
        going_wrong, graph, knowledge, untimed = options.faults_in(faults, None), plan.graph, initial_knowledge(plan), 1.0
        roll = partial(roll_outs_of_plan, chosen, name, options.plan_parameters(given))
    else:
        if name or given:
            raise InputError("--name and --set belong to hand-written plans; expected --plan and a file")
        loaded = options.problem_in(*chosen)
        settings = replace(settings, bindings=bindings_for(chosen[0], bindings, loaded.vocabulary))
        with options.searching(planner, planner_timeout):
            result = solve(loaded, planner=planner, timeout=planner_timeout, improve=improve, bindings=settings.bindings)
        if result.plan is None:
            SafeConsole(stderr=as_json).print_reason("no plan:", result.reason)
            return 1
        going_wrong, graph, knowledge = (
            options.faults_in(faults, loaded.vocabulary),
            plan_graph(loaded, result.plan),
            initial_knowledge(loaded),
        )
        untimed = 0.0 if loaded.is_timed else 1.0
        roll = partial(roll_outs_of_goal, loaded, result.plan)
    calls = odds_of_calls(graph, settings.bindings, declared(going_wrong, settings.bindings, untimed))
    alone = None if calls is None else exact(graph, calls, knowledge)
    is_replaced = replans > 0 and not isinstance(chosen, Path)  # a flat plan by hand has no recovery that asks a planner
    rolled = roll(settings, going_wrong, seconds) if alone is None or (is_replaced and alone.chance < 1.0) else None
    weak = sorted((call for call in calls or () if call.chance() < 1.0), key=CallOdds.chance)
    if as_json:
        options.print_json(_json(alone, rolled, weak))
    else:
        print(*_lines(alone, rolled, weak), sep="\n")
    return 0


def _lines(alone: Odds | None, rolled: Odds | None, weak: list[CallOdds]) -> Iterator[str]:
    """Yield the odds for people."""
    head = "odds     "
    if alone:
        low, high = alone.interval
        between = f", {percent(low)} to {percent(high)} as far as chances of attempts are known" if low < high else ""
        yield f"{head}{percent(alone.chance)} if nothing is planned anew{between}"
        head = " " * len(head)
    if rolled:
        low, high = rolled.interval
        how = f"{percent(low)} to {percent(high)} by {rolled.runs} roll-outs"
        yield f"{head}{percent(rolled.chance)} {'with new plans, ' if alone else ''}{how}"
    if (best := rolled or alone) is None:
        yield "odds     not known: there was no time for a roll-out; expected more --seconds"
        return
    if best.times:
        yield f"time     {best.time(0.5):.1f} s in half of the runs that reach the goal, {best.time(0.9):.1f} s at most in 90 % of them"
    for fluent, (middle, low, high) in best.ends.items():
        yield f"number   {fluent_text(fluent)} is {middle:g} at the end{f', {low:g} to {high:g} in 90 % of the runs' if low < high else ''}"
    for call in weak[:_WEAKEST]:
        tries = f"{call.retries + 1} attempts" if call.retries else "1 attempt"
        each = f"{tries} of {percent(call.attempt.chance(Leads.DONE))}, {call.attempt.rests}"
        yield f"weakest  {percent(call.chance())} {call.call.action}: {each}"
    for action, (retries, chances) in _more_retries(alone, weak).items():
        gains = ", ".join(f"{percent(chance)} with {retries + more}" for more, chance in enumerate(chances, 1))
        yield f"retries  {action} has {retries}: {gains} if nothing is planned anew"


def _more_retries(alone: Odds | None, weak: list[CallOdds]) -> dict[str, tuple[int, list[float]]]:
    """Return the actions of the weakest calls with their retries, and the chance of the plan if they had one or two more."""
    gains: dict[str, tuple[int, list[float]]] = {}
    if alone is None or not alone.chance:
        return gains
    for action in dict.fromkeys(call.call.action.name for call in weak[:_WEAKEST]):
        own = [call for call in weak if call.call.action.name == action]
        chances = [alone.chance for _ in range(2)]
        for call in own:
            chances = [chance * call.chance(more) / call.chance() for more, chance in enumerate(chances, 1)]
        gains[action] = own[0].retries, chances
    return gains


def _json(alone: Odds | None, rolled: Odds | None, weak: list[CallOdds]) -> dict[str, Any]:
    """Return the odds for programs."""

    def of(odds: Odds | None) -> dict[str, Any] | None:
        if odds is None:
            return None
        times = {"median": odds.time(0.5), "ninety_percent": odds.time(0.9)} if odds.times else None
        numbers = {fluent_text(fluent): dict(zip(("median", "low", "high"), ends, strict=True)) for fluent, ends in odds.ends.items()}
        return {"chance": odds.chance, "interval": [*odds.interval], "runs": odds.runs, "seconds": times, "numbers": numbers}

    calls = [
        {
            "call": str(call.call.action),
            "chance": call.chance(),
            "attempts": call.retries + 1,
            "chance_of_attempt": call.attempt.chance(Leads.DONE),
            "rests_on": call.attempt.rests,
        }
        for call in weak
    ]
    retries = [{"action": action, "retries": has, "chances": chances} for action, (has, chances) in _more_retries(alone, weak).items()]
    best = rolled or alone
    return {"chance": best.chance if best else None, "alone": of(alone), "with_new_plans": of(rolled), "weakest": calls, "retries": retries}
