"""`pnm odds`: the chance and the time of a goal, before a robot moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import command
from planner_bridge.pipeline.loading import bindings_for, rates_for
from planner_bridge.pipeline.roll_outs import SECONDS, odds_of_goal, odds_of_plan
from planner_bridge.tasks.settings import DEFAULTS, Settings
from pnm.errors import InputError


@click.command(epilog="Example: pnm odds domain.pddl problem.pddl --faults faults.yaml")
@options.files_or_plan
@options.set_option
@options.bindings_option
@options.faults_option
@options.rates_option
@options.planning
@click.option(
    "--replans", type=click.IntRange(0), default=DEFAULTS.limits.replans, show_default=True, help="new machines after the first, at most"
)
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
    rates: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
    replans: int,
    seconds: float,
    as_json: bool,
) -> int:
    """Say how likely and how soon a goal is reached.

    The chance is exact as long as nothing is planned anew. What new plans add is found by roll-outs: runs of the machine on simulated
    robots. Chances of single attempts are those that --faults declares for simulated robots, or else the learned ones of --rates; what
    is not known is assumed. What follows the outcomes of actions that have several is as their policy says.
    """
    chosen = options.chosen_files(domain, problem, plan_file)
    settings = Settings(planner, planner_timeout, limits=replace(DEFAULTS.limits, replans=replans))
    if isinstance(chosen, Path):
        settings = replace(settings, bindings=bindings_for(None, bindings, None), learned=rates_for(None, rates))
        known, parameters = options.faults_in(faults, None), options.plan_parameters(given)
        found = odds_of_plan(chosen, name, parameters, settings, known, seconds=seconds)
    else:
        if name or given:
            raise InputError("--name and --set belong to hand-written plans; expected --plan and a file")
        loaded, result, bound, learned = options.planned(chosen, bindings, rates, planner, planner_timeout, improve)
        if result.plan is None:
            SafeConsole(stderr=as_json).print_reason("no plan:", result.reason)
            if as_json:
                options.print_json({"chance": None, "alone": None, "with_new_plans": None, "reason": result.reason})
            return 1
        settings = replace(settings, bindings=bound or DEFAULTS.bindings, learned=learned or DEFAULTS.learned)
        known = options.faults_in(faults, loaded.vocabulary)
        found = odds_of_goal(loaded, result.plan, settings, known, policy=result.policy, seconds=seconds)
    if as_json:
        options.print_json(found.as_json())
    else:
        print(*found.lines(), sep="\n")
    return 0
