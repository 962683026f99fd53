"""What `pnm run --plan` and `pnm net --plan` do."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from planner_bridge.cli_files import Files
from planner_bridge.cli_options import tell
from planner_bridge.cli_run import print_ending
from planner_bridge.console import ConsoleObserver, Terminal
from planner_bridge.pipeline import Where
from planner_bridge.planning import check_planner
from planner_bridge.tasks import Settings, TaskObserver
from planner_bridge.written import carry_out, chosen_plan
from pnm.actions.faults import NO_FAULTS, read_faults
from pnm.bindings import read_bindings
from pnm.errors import InputError
from pnm.generation import generate
from pnm.language.plan import read_plans
from pnm.machine import OnFailure, PetriNetMachine
from pnm.sensing_file import read_sensing
from pnm.yaml_files import parse_value


def machine_of(file: Path, name: str | None, bindings: Path | None) -> PetriNetMachine:
    """Return the machine of a hand-written plan.

    Raises:
        InputError: a file is wrong, or it is not clear which plan is meant.
    """
    plans = read_plans(file)
    plan = plans[chosen_plan(plans, name)]
    chosen = read_bindings(bindings).before(plan.bindings) if bindings else plan.bindings
    return generate(plan.graph, chosen, on_failure=plan.on_failure)


def run_written(
    file: Path,
    name: str | None,
    given: tuple[str, ...],
    files: Files,
    *,
    actions: Where,
    settings: Settings,
    on_failure: OnFailure | None,
    as_json: bool,
) -> int:
    """Carry out a hand-written plan, tell how it went, and return the exit status.

    Raises:
        InputError: a file or a parameter is wrong; nothing was started.
    """
    check_planner(settings.planner)  # now, not when a plan is given up that took an hour
    console = Terminal()
    if files.bindings:
        settings = replace(settings, bindings=read_bindings(files.bindings))
    if files.sensing:
        settings = replace(settings, sensing=read_sensing(files.sensing))
    result = carry_out(
        file,
        name,
        _parameters(given),
        actions=actions,
        faults=read_faults(files.faults, None) if files.faults else NO_FAULTS,
        settings=settings,
        on_failure=on_failure,
        observer=TaskObserver() if as_json else ConsoleObserver(console),
        knowledge=files.knowledge,
        warn=tell,
    )
    return print_ending(result.task, console, result.as_json() if as_json else None)


def _parameters(given: tuple[str, ...]) -> dict[str, object]:
    """Read ``name=value``, with values as YAML has them."""
    found: dict[str, object] = {}
    for one in given:
        name, equals, text = one.partition("=")
        if not name or not equals:
            raise InputError(f"expected NAME=VALUE after --set, found {one!r}")
        value = parse_value(text, f"--set {name}")
        try:
            json.dumps(value, allow_nan=False)
        except ValueError as error:
            raise InputError(f"expected finite numbers after --set {name}, found {text!r}") from error
        found[name] = value
    return found
