"""`pnm run` of a goal or of a hand-written plan."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import ADOPT, GIVEN, Seconds, command
from planner_bridge.cli.run_console import ConsoleObserver, print_result
from planner_bridge.pipeline.achieve import Actions, achieve, carry_out
from planner_bridge.pipeline.loading import RATES, beside, bindings_for, rates_for
from planner_bridge.planning.solve import check_planner
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import DEFAULTS, Settings, TaskObserver
from planner_bridge.view.serving import Controlled, Operator, PageProcess
from pnm.actions.faults import NO_FAULTS
from pnm.clock import run_async
from pnm.core.execution.events import broadcast
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError, PnmError
from pnm.files.database.place import Place, without_password
from pnm.journal.kept import DURABILITIES, JournalChoice
from pnm.tasks import Code, Tasks

if TYPE_CHECKING:
    from planner_bridge.pipeline.roll_outs import VettedPlan


@click.command(
    cls=options.ViewingCommand, epilog="Examples: pnm run domain.pddl problem.pddl --actions ros2; pnm run --plan tea.yaml --set guest=Ada"
)
@options.files_or_plan
@options.set_option
@click.option("--actions", type=click.Choice(["simulated", "ros2"]), default="simulated", show_default=True, help="which robots to use")
@options.bindings_option
@options.faults_option
@options.knowledge_option
@options.sensing_option
@options.planning
@click.option("--odds", "least", type=click.FloatRange(0.0, 1.0), help="begin only with this chance of the goal at least, such as 0.95")
@click.option("--sim-time", is_flag=True, help="follow /clock, like nodes with use_sim_time: a paused simulation pauses all limits")
@click.option(
    "--replans", type=click.IntRange(0), default=DEFAULTS.limits.replans, show_default=True, help="new machines after the first, at most"
)
@click.option(
    "--without-progress",
    type=click.IntRange(0),
    default=DEFAULTS.limits.without_progress,
    show_default=True,
    help="of those, how many in a row may bring no progress: nothing new is known, and no fewer calls are left",
)
@click.option(
    "--patience", type=Seconds(0), default=0.0, show_default=True, help="seconds to wait for facts to change while there is no plan"
)
@click.option("--ask-for-help", is_flag=True, help="ask a person when the goal cannot be reached: 'try again' or 'give up'")
@click.option("--seconds", type=Seconds(0), help="seconds for the goal; by default an hour, or three times the plan's duration if longer")
@click.option(
    "--on-failure",
    type=click.Choice(["drain", "cancel", "continue_others"]),
    help="treatment of running actions after a failure; by default that of a hand-written plan, or else drain",
)
@click.option("--answer", "answers", metavar="NAME=VALUE", multiple=True, help="an answer in place of a person's; several are used in turn")
@options.journal_options
@options.rates_option
@options.learn_option
@options.limits_option
@options.timeline_option
@options.force_option
@options.view_option
@options.controls_option
@click.option("-v", "--verbose", is_flag=True, help="print the size of machines, and the states that their proof explored")
@options.quiet_option
@options.as_json_option
@command
def run(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    given: tuple[str, ...],
    actions: Actions,
    bindings: Path | None,
    faults: Path | None,
    knowledge: Path | None,
    sensing: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
    least: float | None,
    sim_time: bool,
    replans: int,
    without_progress: int,
    patience: float,
    ask_for_help: bool,
    seconds: float | None,
    on_failure: str | None,
    answers: tuple[str, ...],
    journal: Place | None,
    durability: str | None,
    adopt: bool,
    rates: Path | None,
    learns: bool,
    is_limited: bool,
    timeline: Path | None,
    force: bool,
    view: int | None,
    controls: bool,
    verbose: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Plan, execute, and replan until the goal holds.

    With --plan, carry out a hand-written plan. With --view, show a page until Ctrl-C.
    """
    if sim_time and actions != "ros2":
        raise InputError("--sim-time follows /clock of ROS 2; expected --actions ros2")
    if faults and actions == "ros2":
        raise InputError("--faults belongs to simulated robots; give it to `pnm simulate`")
    if sensing and actions != "ros2":
        raise InputError("--sensing describes topics and services of ROS 2; expected --actions ros2")
    choice = journal_choice(journal, durability, adopts=adopt) if journal else None
    output = Output.JSON if as_json else Output.ENDING if quiet else Output.NUMBERS if verbose else Output.EVENTS
    policy = OnFailure(on_failure) if on_failure else None
    limits = replace(DEFAULTS.limits, replans=replans, without_progress=without_progress, seconds=seconds, patience=patience)
    failing = policy or OnFailure.DRAIN
    settings = Settings(planner, planner_timeout, improve, limits=limits, on_failure=failing, ask_for_help=ask_for_help, sim_time=sim_time)
    chosen = options.chosen_files(domain, problem, plan_file)
    if not isinstance(chosen, Path) and (name or given or answers or knowledge):
        raise InputError("--name, --set, --answer and --knowledge belong to hand-written plans; expected --plan and a file")
    if isinstance(chosen, Path) and is_limited:
        raise InputError("--learned-limits is about a goal: a hand-written plan has limits of its own; expected DOMAIN and PROBLEM")
    controlled = options.controlled_by(view, Controlled.RUN, controls=controls)
    console, stopwatch = SafeConsole(), Stopwatch()
    begin: Callable[..., TaskResult]
    vetted: VettedPlan | None = None
    learned = rates or (chosen if isinstance(chosen, Path) else chosen[0]).parent / RATES if learns else None
    known_files = (rates or (None if isinstance(chosen, Path) else beside(chosen[0], RATES)), faults)
    with looked_at(choice, view, timeline, learned, controlled, known_files, force=force) as (kept, page):
        if isinstance(chosen, Path):
            check_planner(planner)  # now, not when a plan is given up that took an hour
            settings = replace(settings, bindings=bindings_for(None, bindings, None))
            settings = replace(settings, sensing=options.sensing_in(sensing, None))
            parameters, going_wrong = options.plan_parameters(given), options.faults_in(faults, None)
            if least is not None:
                from planner_bridge.pipeline.roll_outs import odds_of_plan  # here and below, because most runs need none of these

                odds = odds_of_plan(chosen, name, parameters, replace(settings, learned=rates_for(None, rates)), going_wrong)
                if refusal := odds.refusal(least):
                    raise PnmError(f"the plan is not begun: {refusal}")
            begin = partial(
                carry_out,
                chosen,
                name,
                parameters,
                faults=going_wrong,
                on_failure=policy,
                knowledge=knowledge,
                answers=options.named_values(answers, "--answer"),
                warn=options.print_warnings,
            )
        else:
            with stopwatch.of("parse"):
                loaded = options.problem_in(*chosen)
                bound = bindings_for(chosen[0], bindings, loaded.vocabulary)
                known = rates_for(chosen[0], rates, grows=learns)
                bound = known.limiting(bound, loaded.domain.actions) if is_limited else bound
                settings = replace(settings, bindings=bound, sensing=options.sensing_in(sensing, loaded.vocabulary), learned=known)
                going_wrong = options.faults_in(faults, loaded.vocabulary)
                if least is not None or (output is not Output.ENDING and (known, going_wrong) != (DEFAULTS.learned, NO_FAULTS)):
                    from planner_bridge.pipeline.roll_outs import VettedPlan

                    vetted = VettedPlan(settings, going_wrong, least)
                    settings = replace(settings, memory=vetted)
                begin = partial(achieve, None, loaded, faults=going_wrong, stopwatch=stopwatch)
        with observed(output, console, settings, actions, page, vetted) as observer:
            result = begin(actions=actions, settings=settings, observer=observer, journal=kept)
        return print_ending(result, console, output, page, vetted)


class Output(Enum):
    """The output of `pnm run`."""

    NUMBERS = "every event, the size of machines, and the result"
    EVENTS = "every event, and the result"
    ENDING = "the result"
    JSON = "the result, as one JSON object"


def journal_choice(place: Place, durability: str | None, *, adopts: bool) -> JournalChoice:
    """Return the journal of a run; another process would go on with what the command was given here, but adopts nothing unasked."""
    given = [without_password(argument) for argument in click.get_current_context().meta[GIVEN] if argument != ADOPT]
    command, is_durable = (os.getcwd(), *given), DURABILITIES[durability] if durability else None
    return JournalChoice(place, is_durable, command=command, seal=options.seal_of(command), adopts=adopts)


@contextmanager
def looked_at(
    journal: JournalChoice | None,
    view: int | None,
    timeline: Path | None,
    rates: Path | None,
    controlled: Controlled,
    known: tuple[Path | None, Path | None] = (None, None),
    *,
    force: bool,
) -> Iterator[tuple[JournalChoice | None, PageProcess | None]]:
    """Show a run on a page while this is entered; at the end, draw its timeline and learn from it.

    Args:
        journal: that of the run, if it has one; where it is looked at it has one in any case, which is kept no longer than this.
        rates: the file of what is learned.
        known: the files of the rates and of the faults by which the page shows odds.

    Yields:
        The journal, and the page.
    """
    if view is None and timeline is None and rates is None:
        yield journal, None
        return
    if timeline is not None:
        options.check_output(timeline, force=force)
    with ExitStack() as stack:
        kept = journal or JournalChoice(Path(stack.enter_context(TemporaryDirectory(prefix="pnm-run-"))) / "run.journal")
        page = None
        if view is not None:
            page = stack.enter_context(PageProcess(view, controlled))
            options.announce(page)
            page.follow(str(kept.place) if isinstance(kept.place, Path) else kept.place.text, *known)
        yield kept, page
        if timeline is not None:
            from planner_bridge.view.story import timelines_as  # here, because most runs are not drawn

            options.write(timeline, timelines_as("svg", kept.place, only_last=True), force=force)
        if rates is not None:
            from planner_bridge.explanations.learning import learn_into  # here, because nothing is learned from most runs

            learn_into(rates, kept.place, is_kept=journal is not None)


class _RunOnPage(TaskObserver):
    """Has a page control the task of a run, if it may."""

    def __init__(self, page: PageProcess) -> None:
        self._page = page

    def managed(self, tasks: Tasks) -> None:
        """Have the page control it from now on."""
        self._page.operate(Operator(tasks, tasks))


@contextmanager
def observed(
    output: Output, console: SafeConsole, settings: Settings, actions: Actions, page: PageProcess | None, vetted: VettedPlan | None = None
) -> Iterator[TaskObserver]:
    """Yield the printer of a task's events, or a listener that prints nothing, while this is entered; a page may control the task."""
    observers: list[TaskObserver] = [_RunOnPage(page)] if page else []
    if output not in (Output.EVENTS, Output.NUMBERS):
        yield broadcast(TaskObserver, observers)
        return
    is_simulated = actions == "simulated"
    robots = "simulated here; --actions ros2 drives real ones" if is_simulated else "the action servers of ROS 2"
    awaited = "" if is_simulated else "missing action servers are waited for, 10 s at most"
    is_verbose = output is Output.NUMBERS
    printer = ConsoleObserver(console, settings.planner_timeout, robots=robots, awaited=awaited, is_verbose=is_verbose, vetted=vetted)
    with closing(printer):
        if not is_simulated:
            printer.wait("ROS 2 is joined, and robots are heard, 14 s at most")
        yield broadcast(TaskObserver, [*observers, printer])


def print_ending(
    result: TaskResult, console: SafeConsole, output: Output, page: PageProcess | None = None, vetted: VettedPlan | None = None
) -> int:
    """Print the result of a task, for people or as one JSON object; keep its page, unless it was cancelled; return the exit status."""
    if output is Output.JSON:
        options.print_json({**result.as_json(), **({"odds": vetted.odds.as_json()} if vetted and vetted.odds else {})})
    else:
        print_result(console, result)
    if page and result.code is not Code.CANCELLED:

        async def stay() -> None:
            options.announce(page, " stays until Ctrl-C")
            await page.ended()

        with suppress(KeyboardInterrupt):
            run_async(stay())
    return 0 if result.goal_reached else 1
