"""`pnm run` of a goal or of a hand-written plan, and `pnm net --plan`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from planner_bridge.cli.console import ConsoleObserver, SafeConsole, print_result
from planner_bridge.cli.options import GIVEN, Files, Output, faults_for, print_warnings, problem_in
from planner_bridge.loading import bindings_for
from planner_bridge.pipeline import Actions, achieve, carry_out
from planner_bridge.planning.solve import check_planner
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.view.process import PageProcess
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import NO_FAULTS, read_faults
from pnm.clock import run_async
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.errors import InputError
from pnm.files.database.place import Place
from pnm.files.yaml_nodes import parse_value
from pnm.journal.kept import Durability, JournalChoice
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import NO_SENSING
from pnm.language.plan import chosen_plan, read_plans
from pnm.tasks import Code


def run_problem(domain: Path, problem: Path, files: Files, *, actions: Actions, settings: Settings, output: Output) -> int:
    """Plan, execute and replan, print the result, and return the exit status."""
    console, stopwatch = SafeConsole(), Stopwatch()
    with stopwatch.of("parse"):
        loaded = problem_in(domain, problem, for_its_goal=True)
        sensors = read_sensing(files.sensing, loaded.vocabulary) if files.sensing else NO_SENSING
        settings = replace(settings, bindings=bindings_for(domain, files.bindings, loaded.vocabulary), sensing=sensors)
        faults = faults_for(loaded, files.faults)
    observer = observer_for(output, console, settings)
    result = achieve(
        None, loaded, actions=actions, faults=faults, settings=settings, observer=observer, stopwatch=stopwatch, journal=files.journal
    )
    return print_ending(result, console, output, files.page)


def journal_choice(place: Place, durability: str) -> JournalChoice:
    """Return the journal of a run; another process would go on with what the command was given here."""
    given = click.get_current_context().meta[GIVEN]
    return JournalChoice(place, Durability.of(durability), command=(os.getcwd(), *given))


def observer_for(output: Output, console: SafeConsole, settings: Settings) -> TaskObserver:
    """Return what prints the events of a task, or listens to them without printing."""
    return ConsoleObserver(console, settings.planner_timeout) if output is Output.EVENTS else TaskObserver()


@contextmanager
def shown(port: int | None, journal: JournalChoice | None) -> Iterator[tuple[JournalChoice | None, PageProcess | None]]:
    """Show a run on a page while this is entered; yield its journal, which is kept no longer than that if it has none, and the page."""
    if port is None:
        yield journal, None
        return
    with TemporaryDirectory(prefix="pnm-view-") as folder, PageProcess(port) as page:
        print(f"view     {page.url}", file=sys.stderr, flush=True)
        journal = journal or JournalChoice(Path(folder) / "run.journal")
        page.follow(str(journal.place) if isinstance(journal.place, Path) else journal.place.text)
        yield journal, page


def _stay(page: PageProcess) -> None:
    """Keep the page until a signal, such as Ctrl-C."""

    async def stay() -> None:
        print(f"view     {page.url} stays until Ctrl-C", file=sys.stderr, flush=True)
        await page.ended()

    with suppress(KeyboardInterrupt):
        run_async(stay())


def print_ending(result: TaskResult, console: SafeConsole, output: Output, page: PageProcess | None = None) -> int:
    """Print the result of a task, for people or as one JSON object; keep its page, unless it was cancelled; return the exit status."""
    if output is Output.JSON:
        print(json.dumps(result.as_json(), default=str), flush=True)
    else:
        print_result(console, result)
    if page and result.code is not Code.CANCELLED:
        _stay(page)
    return 0 if result.goal_reached else 1


def machine_of(file: Path, name: str | None, bindings: Path | None) -> PetriNetMachine:
    """Return the machine of a hand-written plan."""
    plans = read_plans(file)
    plan = plans[chosen_plan(plans, name)]
    print_warnings(plan.warnings)
    chosen = read_bindings(bindings).before(plan.bindings) if bindings else plan.bindings
    return generate(plan.graph, chosen, on_failure=plan.on_failure)


def run_written(
    file: Path,
    name: str | None,
    given: tuple[str, ...],
    answers: tuple[str, ...],
    files: Files,
    *,
    actions: Actions,
    settings: Settings,
    on_failure: OnFailure | None,
    output: Output,
) -> int:
    """Carry out a hand-written plan, print the result, and return the exit status."""
    check_planner(settings.planner)  # now, not when a plan is given up that took an hour
    console = SafeConsole()
    if files.bindings:
        settings = replace(settings, bindings=read_bindings(files.bindings))
    if files.sensing:
        settings = replace(settings, sensing=read_sensing(files.sensing))
    result = carry_out(
        file,
        name,
        dict(named_values(given, "--set")),
        actions=actions,
        faults=read_faults(files.faults, None) if files.faults else NO_FAULTS,
        settings=settings,
        on_failure=on_failure,
        observer=observer_for(output, console, settings),
        knowledge=files.knowledge,
        answers=named_values(answers, "--answer"),
        warn=print_warnings,
        journal=files.journal,
    )
    return print_ending(result, console, output, files.page)


def named_values(given: tuple[str, ...], option: str) -> list[tuple[str, object]]:
    """Read every ``name=value`` of an option, with values as YAML has them."""
    values: list[tuple[str, object]] = []
    for setting in given:
        name, equals, text = setting.partition("=")
        if not name or not equals:
            raise InputError(f"expected NAME=VALUE after {option}, found {setting!r}")
        values.append((name, parse_value(text, f"{option} {name}")))
    return values
