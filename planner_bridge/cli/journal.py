"""`pnm replay`, `pnm history` and `pnm learn`: what journals say, without any robot; and `pnm resume` of a run that has died."""

from __future__ import annotations

import hmac
import json
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import datetime
from io import BytesIO
from pathlib import Path
from time import time
from typing import Any, Final
from urllib.parse import urlsplit

import click
from rich.text import Text

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import command
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.node.node_journal import latest_journal
from planner_bridge.tasks.result import TASKS
from planner_bridge.view.story import Followed, timelines_as
from pnm.core.knowledge_base import statement_text
from pnm.errors import InputError, counted, printable
from pnm.files.database.place import Place, place_of
from pnm.journal.codec import Undecodable
from pnm.journal.kept import DAY, KEPT, LISTED, JournalChoice, JournalError
from pnm.journal.lease import take
from pnm.journal.records import Happened, RunMade, TaskSummary
from pnm.journal.replay import Replay, ReplayStep, words
from pnm.journal.resume import command_of, replay_steps, summaries
from pnm.journal.store import KeptJournal, copy_journal, move_journal
from pnm.tasks import Code

journal_argument = click.argument("journal", required=False)


@click.command(cls=options.ViewingCommand, epilog="Examples: pnm replay tasks.journal --to 120; pnm replay tasks.journal --view")
@journal_argument
@click.option("--to", "last", type=click.IntRange(1), help="stop after this record, and print the state")
@click.option("--json", "as_json", is_flag=True, help="print only one JSON object per record")
@options.timeline_option
@options.force_option
@options.view_option
@command
def replay(journal: str | None, last: int | None, as_json: bool, timeline: Path | None, force: bool, view: int | None) -> int:
    """Execute the runs of a journal again.

    Runs step by step, without any robot. With --to, also print the state after that record. With --view, show a page until Ctrl-C; with
    --timeline, only draw the tasks. The default JOURNAL is the node's journal written last on this computer.
    """
    if (last or as_json) and (timeline or view is not None):
        raise InputError("--view and --timeline show all of the journal; expected no --to, and no --json")
    if timeline is not None:
        if view is not None:
            raise InputError("expected --view or --timeline, not both")
        options.check_output(timeline, force=force)
        with errors_of_journals():
            picture = timelines_as("svg", chosen_journal(journal))
        options.write(timeline, picture, force=force)
        return 0
    if view is not None:
        from planner_bridge.view.serving import listening, url_of

        place = chosen_journal(journal)
        with errors_of_journals():
            KeptJournal(place).close()  # which says what is wrong with it now
        opened = listening(view)
        print(f"view     {url_of(opened)}", file=sys.stderr, flush=True)
        from planner_bridge.view.app import serve_page  # here, because what it needs is an extra, which is there by now

        serve_page(place, opened)
        return 0
    console = SafeConsole()
    state = Replay()
    with errors_of_journals():
        for step in replay_steps(chosen_journal(journal), TASKS, state):
            if as_json:
                print(json.dumps(_as_json(step, state), default=str), flush=True)
            else:
                first, *more = words(step, state)
                task = state.runs[step.record.run].made.task.hex[:8] if isinstance(step.record, Happened | RunMade) else ""
                console.print(Text(f"{step.number:6} {step.time - state.began:9.2f} s  {task:8}  {first}"))
                for line in more:
                    console.print(Text(f"{'':30}{line}", style="dim"))
            if step.number == last:
                break
    if last and not as_json:
        _print_state(state, console)
    return 0


@click.command(epilog="Examples: pnm history tasks.journal; pnm history -v")
@journal_argument
@click.option("--json", "as_json", is_flag=True, help="print only one JSON object per task")
@click.option(
    "-v",
    "--verbose",
    is_flag=True,
    help="also count plans, replans, requests and failures, say what set off each replan, and where a policy is",
)
@click.option(
    "--format",
    "written_as",
    type=click.Choice(["text", "xes"]),
    default="text",
    show_default=True,
    help="xes is for process mining: a trace for each task, with starts and ends of requests",
)
@options.output_options
@command
def history(journal: str | None, as_json: bool, verbose: bool, written_as: str, output: Path | None, force: bool) -> int:
    """List the tasks of a journal.

    Each line has the time of acceptance, the goal and the end.
    The default JOURNAL is the node's journal written last on this computer.
    """
    if as_json and written_as != "text":
        raise InputError(f"--json lists the tasks; expected no --format {written_as} with it")
    if output and written_as == "text":
        raise InputError("the list goes to the terminal; expected --format xes with --output")
    if written_as == "xes":
        with errors_of_journals():
            log = timelines_as("xes", chosen_journal(journal))
        options.write(output, log, force=force)
        return 0
    with errors_of_journals():
        tasks = summaries(place := chosen_journal(journal), TASKS)
        told = JournalHistory.read(place) if verbose else None
    console = SafeConsole()
    for task in tasks:
        more = told.tasks.get(task.accepted.wanted.id) if told else None
        followed = Followed.by(told, more.own_runs[-1]) if told and more and more.own_runs else None
        replans = [(run.time - more.time, run.replan.why) for run in more.own_runs if run.replan] if more else []
        if as_json:
            counts = (
                {"counts": more.counts.as_json(), "replanned": [{"time": round(at, 4), "why": why} for at, why in replans]} if more else {}
            )
            policy = {"policy": str(followed)} if followed else {}
            print(json.dumps(task.as_json() | counts | policy), flush=True)
        else:
            _print_task(task, console)
            lines = [str(more.counts), *(f"{at:6.2f} s  replan  {why}" for at, why in replans)] if more else []
            for line in [*lines, *([f"policy  {followed}"] if followed else [])]:
                console.print(Text(f"{'':21}{line}"))
    if not (tasks or as_json):
        console.print("no tasks")
    return 0


@click.command(epilog="Examples: pnm learn run.journal -o rates.yaml; pnm learn robot1.yaml robot2.yaml -o rates.yaml")
@click.argument("sources", metavar="[JOURNAL]...", nargs=-1)
@click.option("-o", "--output", type=options.FILE, help="the file of the rates, which is added to if it is there; by default the terminal")
@command
def learn(sources: tuple[str, ...], output: Path | None) -> int:
    """Learn chances and durations from journals.

    Counts how calls have ended, with which outcomes, and after how many seconds. Each JOURNAL is a file or a postgresql://...; a file of
    rates (.yaml) is merged. A journal that was counted before adds only what is new in it. The default is the node's journal written last
    on this computer.
    """
    from planner_bridge.explanations.learning import learn as learned  # here, because looking at a journal needs neither
    from planner_bridge.model.rates import NO_RATES, Rates, read_rates, update_rates

    def more(rates: Rates) -> Rates:
        for source in sources or (None,):
            with errors_of_journals():
                is_file = source is not None and source.endswith((".yaml", ".yml"))
                rates = rates.merge(read_rates(str(source))) if is_file else learned(chosen_journal(source), rates)
        return rates

    if output is None:
        print(more(NO_RATES).text(), end="")
    else:
        update_rates(output, more)
        print(f"wrote {output}", file=sys.stderr)
    return 0


@click.command(epilog="Examples: pnm telemetry --otlp http://localhost:4318 --follow; pnm telemetry tasks.journal --mcap tasks.mcap")
@journal_argument
@click.option("--otlp", metavar="URL", help="send traces to this collector: task, plan, call and attempt")
@click.option("--follow", "follows", is_flag=True, help="send what has ended, and the rest when it ends, until interrupted")
@click.option("--mcap", type=options.FILE, help="a new MCAP file for Foxglove, and beside it its layout, FILE.layout.json")
@options.force_option
@command
def telemetry(journal: str | None, otlp: str | None, follows: bool, mcap: Path | None, force: bool) -> int:
    """Give a journal to OpenTelemetry or Foxglove.

    Reads the journal alone: no node waits for it. Numbers for Prometheus are at /metrics of the page of --view.
    The default JOURNAL is the node's journal written last on this computer.
    """
    if (otlp is None) == (mcap is None) or (follows and otlp is None):
        raise InputError("expected --otlp URL, with --follow or without, or --mcap FILE")
    if mcap is not None:
        layout = mcap.with_name(f"{mcap.name}.layout.json")
        for path in (mcap, layout):
            options.check_output(path, force=force)
        from planner_bridge.view.recording import record  # here, because what it needs is an extra

        written = BytesIO()
        with errors_of_journals():
            shown = record(chosen_journal(journal), written)
        options.write_files({mcap: written.getvalue(), layout: shown}, force=force)
        return 0
    from planner_bridge.view.spans import collector, export  # here, because what it needs is an extra

    send = collector(otlp or "")
    with errors_of_journals():
        count = export(chosen_journal(journal), send, follows=follows)
    print(f"{counted(count, 'span')} sent to {urlsplit(otlp or '').hostname}", file=sys.stderr)
    return 0


@click.group("journal", epilog="Example: pnm journal check tasks.journal")
def journal_files() -> None:
    """Check, move, copy or prune a journal.

    The log beside its file is included.
    """


_old = click.argument("journal", metavar="JOURNAL")
_new = click.argument("to", metavar="TO", type=options.FILE)


@journal_files.command(epilog="Example: pnm journal check tasks.journal")
@_old
@command
def check(journal: str) -> int:
    """Read everything in a journal.

    Prints whether it is complete and undamaged, whose it is, and whether it was closed.
    """
    with errors_of_journals(), closing(KeptJournal(place_of(journal))) as kept:
        records, tasks = kept.check(), summaries(place_of(journal), TASKS)
        home, holder = kept.home(), kept.holding().holder
        segments, writer = len(kept.segments()), kept.writer()
    unfinished = sum(task.ending is None for task in tasks)
    lines = (
        f"whole    {records} records in {segments} segments; {len(tasks)} tasks, {unfinished} of them not over",
        f"node     {(home.node or 'a run') if home else 'not known'}",
        f"written  by {writer or 'nobody'}, which {'has not closed it' if holder else 'has closed it'}",
    )
    for line in lines:
        SafeConsole().print(Text(line), soft_wrap=True)
    return 0


@journal_files.command(epilog="Example: pnm journal move tasks.journal old.journal")
@_old
@_new
@command
def move(journal: str, to: Path) -> int:
    """Move a journal that no process writes, as one file.

    The journal goes on at its new place; a new one begins at the old place. It may be of any version.
    """
    with errors_of_journals():
        move_journal(_file(journal), to)
    print(f"moved to {to}", file=sys.stderr)
    return 0


@journal_files.command(epilog="Example: pnm journal copy tasks.journal /backup/tasks.journal")
@_old
@_new
@command
def copy(journal: str, to: Path) -> int:
    """Copy a journal to one new file, also while a node writes it.

    The copy can be read; to continue it, use --adopt.
    """
    with errors_of_journals():
        copy_journal(_file(journal), to)
    print(f"wrote {to}", file=sys.stderr)
    return 0


@journal_files.command(epilog="Example: pnm journal prune tasks.journal --keep-days 1")
@_old
@click.option("--keep-days", type=click.FloatRange(0), default=KEPT / DAY, show_default=True, help="days for which records are kept")
@command
def prune(journal: str, keep_days: float) -> int:
    """Drop old records of a journal that no process writes.

    A running node does so by itself. The last segment is kept whole.
    """
    with errors_of_journals():
        place = place_of(journal)
        KeptJournal(place).close()  # which says what is wrong with it, and makes none
        file, hold = take(JournalChoice(place, node=None))
        try:
            file.drop(time() - keep_days * DAY, time() - LISTED * keep_days * DAY)
        finally:
            hold.release()
            file.close()
    return 0


def _file(journal: str) -> Path:
    place = place_of(journal)
    if not isinstance(place, Path):
        raise InputError("a journal in PostgreSQL is moved and copied with tools of the database, such as pg_dump; expected a file")
    return place


_ACTS: Final = {
    "--actions": "ros2 drives robots",
    "--force": "replaces files",
    "--timeline": "writes a file",
    "--journal": "writes a journal",
    "--learn": "adds to a file of rates",
    "--knowledge": "reads and writes a database",
    "--view": "serves a page",
    "--view-controls": "lets people control it on that page",
}
"""Options by which a command does something to others than simulated robots."""


def resume_run(journal: Place, *, adopts: bool, is_trusted: bool) -> int:
    """Go on with the run that a journal has kept, with what its command was given, and end with its exit status.

    A journal that this user has not begun on this computer may say anything: it is carried out only if somebody says so.
    """
    from planner_bridge.cli.run import run  # here, because a look at a journal needs nothing of it

    with errors_of_journals():
        tasks, begun = summaries(journal, TASKS), command_of(journal, TASKS)
    command, seal = begun or ((), "")
    if not tasks and (command or begun is None):
        raise InputError(f"{journal} has no task: the process died before it began one; give its command again")
    folder, *given = command or ("",)
    if not folder:
        again = "start `pnm serve` again, with its files and options, and it goes on"
        raise InputError(f"{journal} is the journal of a node: {again}; `pnm history {journal}` lists its tasks")
    if ending := tasks[-1].ending:
        _print_task(tasks[-1], SafeConsole())
        return 0 if ending.code is Code.GOAL_REACHED else 1
    if not (is_trusted or (seal and hmac.compare_digest(seal, options.seal_of(command)))):
        named = {option.partition("=")[0] for option in given}
        acts = "".join(f"; {option} {what}" for option, what in _ACTS.items() if option in named)
        would = f"{journal} was not begun by you on this computer. In {printable(folder)} it would do: {_words(given)}{acts}"
        if not sys.stdin.isatty():
            raise InputError(f"{would}; --yes does it")
        print(would, file=sys.stderr)
        if not click.confirm("Do you want that?", err=True):
            raise InputError("nothing was done")
    place = str(journal.resolve()) if isinstance(journal, Path) else journal.text
    try:
        os.chdir(folder)
    except OSError as error:
        raise InputError(f"{journal}: its command was given in {folder}: {error.strerror}") from error
    print(f"in {printable(folder)}: {_words(given)}", file=sys.stderr)
    return int(run.main([*given, "--journal", place, *([options.ADOPT] if adopts else [])], "pnm run", standalone_mode=False) or 0)


def _words(given: Sequence[str]) -> str:
    """Return a command that a journal names on one line: a line of its own in an argument would look like one of ours."""
    return f"pnm run {shlex.join(map(printable, given))}"


def chosen_journal(journal: str | None) -> Place:
    """Return the chosen journal; name it on stderr if it is the default."""
    if journal is not None:
        return place_of(journal)
    latest = latest_journal()
    print(f"journal: {latest}", file=sys.stderr)
    return latest


@contextmanager
def errors_of_journals() -> Iterator[None]:
    """Raise an `InputError` for a file that is no journal of this version."""
    try:
        yield
    except (JournalError, Undecodable) as error:
        raise InputError(str(error)) from error


def _print_state(state: Replay, console: SafeConsole) -> None:
    """Print the state after the last record: tasks, marked places, facts."""
    for id, task in state.tasks.items():
        doing = "over" if task.ending else "not over"
        console.print(Text(f"task {id.hex[:8]}  {task.accepted.wanted.words}: {doing}"))
    for replayed in state.runs.values():
        if not replayed.is_over:
            console.print(Text(f"run {replayed.run.id.hex[:8]}  of {replayed.made.name}"))
            for place in replayed.run.marking:
                console.print(Text(f"  marked {place}"))
    for fluent, value in sorted(state.world.facts().items(), key=lambda fact: fact[0]):
        console.print(Text(f"fact {statement_text(fluent, value)}"))


def _as_json(step: ReplayStep, state: Replay) -> dict[str, Any]:
    """Return a record, and what has come of it: of the places and calls of its run those that its transitions are about."""
    record = json.loads(TASKS.text(step.record))
    entry: dict[str, Any] = {"number": step.number, "time": step.time, "record": record, "words": list(words(step, state))}
    if isinstance(step.record, Happened):
        run = state.runs[step.record.run].run
        net, marking = run.machine.net, run.marking
        places = dict.fromkeys(place for name in step.fired for place in (*net.inputs[name], *net.outputs[name]))
        steps = dict.fromkeys(call for name in step.fired if (call := run.machine.rules[name].call) is not None)
        calls = [step for step in steps if step < len(run.machine.plan.calls)]  # the others are loops, choices and the like
        entry["fired"], entry["marking"] = list(step.fired), {place: marking[place] for place in places}
        entry["results"] = {str(result.call): result.outcome for result in map(run.result_of, calls)}
    return entry


def _print_task(task: TaskSummary, console: SafeConsole) -> None:
    at = datetime.fromtimestamp(task.accepted.wall).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    ending = task.ending
    if ending is None:
        text = "not over"
    else:
        after = "" if task.seconds is None else f" after {task.seconds:.1f} s"
        text = f"{ending.code.word}{after}: {ending.message}"
    console.print(Text(f"{at}  {task.accepted.wanted.id.hex[:8]}  {task.accepted.wanted.words}"))
    console.print(Text(f"{'':21}{text}", style="" if ending else "yellow"))
