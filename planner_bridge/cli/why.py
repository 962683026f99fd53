"""`pnm why`: why there is this plan, or none, why it has a call and not another one; and why a run goes as it goes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import wrap
from typing import Final

import click

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.journal import chosen_journal, errors_of_journals
from planner_bridge.cli.options import (
    FILE,
    Seconds,
    as_json_option,
    bindings_option,
    command,
    print_json,
    problem_in,
    rates_option,
    robots_of,
    searching,
)
from planner_bridge.explanations.answer import Answer, Known
from planner_bridge.explanations.goal_now import why_goal
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.needed_call import why_call_of_plan, why_not
from planner_bridge.explanations.no_plan import SECONDS, AnswerLimit
from planner_bridge.explanations.run_questions import explained_task, task_meant
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Plan, PlanStep, read_call
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotProjectable, projected_state
from planner_bridge.planning.kairos import DEFAULT_PLANNER, GLANCE
from pnm.errors import InputError, suggestion

_NARROW: Final = 40
"""Columns that a statement gets at least, however deep it stands."""


@click.command(epilog="Examples: pnm why domain.pddl problem.pddl --not 'move(r1, hall, kitchen)'; pnm why --journal run.journal --call 2")
@click.argument("domain", type=FILE, required=False)
@click.argument("problem", type=FILE, required=False)
@click.option("--call", "called", metavar="CALL", help="why this call: its number, or the call itself, such as 'move(r1, a, b)'")
@click.option("--not", "other", metavar="CALL", help="why not this call, which the plan lacks; with DOMAIN and PROBLEM")
@click.option("--replan", is_flag=True, help="why there were new plans, from a journal")
@click.option("--journal", metavar="FILE", help="file or postgresql://… of a journal; DOMAIN and PROBLEM are used with its facts")
@click.option("--task", metavar="TASK", help="task of the journal: number or beginning of the id; by default the last running one")
@click.option("--to", "last", type=click.IntRange(1), help="the last record of the journal to read")
@bindings_option
@rates_option
@click.option("--seconds", type=Seconds(0.1), default=SECONDS, show_default=True, help="seconds for all searches together")
@as_json_option
@command
def why(
    *,
    domain: Path | None,
    problem: Path | None,
    called: str | None,
    other: str | None,
    replan: bool,
    journal: str | None,
    task: str | None,
    last: int | None,
    bindings: Path | None,
    rates: Path | None,
    seconds: float,
    as_json: bool,
) -> int:
    """Explain a plan, or why there is none, or a run.

    With DOMAIN and PROBLEM, explain the calls of a plan, or why there is none and what would help. Without them, explain a task from a
    journal (by default the node's journal written last on this computer). Unproved statements say `not proved`.
    """
    if sum((called is not None, other is not None, replan)) > 1:
        raise InputError("expected one of --call, --not and --replan: each is a question of its own")
    if domain is not None and problem is None:
        raise InputError("expected DOMAIN and PROBLEM, or neither of them for a journal")
    if domain is None or problem is None:
        if bindings or rates:
            raise InputError("--bindings and --rates are for other plans; expected DOMAIN and PROBLEM")
        if other is not None:
            raise InputError("--not needs other plans; expected DOMAIN and PROBLEM, which are used with the facts of a --journal")
        with errors_of_journals():
            answers = explained_task(chosen_journal(journal), task, called, last, replan=replan)
        show(answers, as_json=as_json)
        return 0
    if replan:
        raise InputError("--replan is about a run: expected no DOMAIN and PROBLEM")
    if journal is None and (task or last):
        raise InputError("--task and --to are about a journal: expected --journal")
    loaded = problem_in(domain, problem)
    robots = robots_of(domain, loaded, bindings, rates)
    if journal is not None:
        loaded = _in_the_middle(loaded, journal, task, last)
    unwanted = None if other is None else read_call(loaded, other, "--not")
    wanted = None if called is None or called.strip("# ").isdecimal() else read_call(loaded, called, "--call")
    limit = AnswerLimit.of(seconds, *robots)
    with searching(DEFAULT_PLANNER, seconds):
        found = limit.first_plan(loaded, improve=GLANCE)
        if unwanted is not None:
            answers = (why_not(loaded, unwanted, found, limit),)
        elif found.plan is None or called is None:
            answers = why_goal(loaded, found, limit)
        else:
            answers = (why_call_of_plan(loaded, found.plan, _number(found.plan, called, wanted)),)
    show(answers, as_json=as_json)
    return 0


def _in_the_middle(problem: Problem, journal: str, task: str | None, last: int | None) -> Problem:
    """Return the problem with what is so in a journal as its initial state, and the goal of a task."""
    with errors_of_journals():
        history = JournalHistory.read(chosen_journal(journal), last)
        meant = task_meant(history, task)
        if not meant.runs:
            raise InputError(f"{meant.name} has no plan yet, so its goal is not known")
        going_on = [run.executed().run for run in history.runs.values() if not run.is_over]
    try:
        world = projected_state(history.world, going_on)
    except NotProjectable as error:
        raise InputError(f"the facts after the end of the running calls are not known: {error}") from error
    now = problem_now(problem, world, history.time - history.world_began)
    return replace(now, goal=meant.runs[-1].source.plan.goal)


def _number(plan: Plan, called: str, wanted: PlanStep | None) -> int:
    if wanted is None:
        number = int(called.strip("# "))
        if number >= len(plan.steps):
            raise InputError(f"--call: there is no call {number}: the plan has {len(plan.steps)}; expected a number from 0")
        return number
    steps = [str(step) for step in plan.steps]
    if str(wanted) not in steps:
        hint = suggestion(str(wanted), steps) or "without --call, all are listed"
        raise InputError(f"--call: {wanted} is not in the plan; {hint} (--not asks why)")
    return steps.index(str(wanted))


def show(answers: Sequence[Answer], *, as_json: bool) -> None:
    """Print answers: as trees that fit the terminal, in lines of any length elsewhere, or as JSON."""
    if as_json:
        print_json({"answers": [answer.as_json() for answer in answers]})
        return
    console = SafeConsole()
    for answer in answers:
        for depth, text in _lines(answer, None, 0):
            indent = "  " * depth
            wide = max(console.width, len(indent) + _NARROW)
            lines = wrap(text, wide, initial_indent=indent, subsequent_indent=indent + " " * 4, break_on_hyphens=False)
            console.print("\n".join(lines) if console.is_terminal else indent + text)


def _lines(answer: Answer, above: Known | None, depth: int) -> Iterator[tuple[int, str]]:
    """Yield every statement with its depth, and how it is known where that does not go without saying."""
    goes_without_saying = answer.known is above or answer.known is Known.GIVEN
    yield depth, answer.statement if goes_without_saying else f"{answer.statement} [{answer.known.value}]"
    for reason in answer.reasons:
        yield from _lines(reason, above if answer.known is Known.GIVEN else answer.known, depth + 1)
