"""`pnm why`: the answers to why there is this plan, or none, why it has a call, and why it has not another one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click
from rich.text import Text
from rich.tree import Tree

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import FILE, Seconds, as_json_option, command, problem_in, searching
from planner_bridge.explanations.answer import Answer, Known
from planner_bridge.explanations.limited_search import TimeLimit
from planner_bridge.explanations.needed_call import why_call_of_plan
from planner_bridge.explanations.no_plan import why_no_plan
from planner_bridge.explanations.other_action import why_not
from planner_bridge.explanations.plan_overview import why_plan
from planner_bridge.explanations.smallest_change import what_would_help
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.plan_text import read_plan
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER
from pnm.errors import InputError, suggestion
from pnm.knowledge.sources.person_text import printable

_IMPROVE: Final = 0.3
"""Seconds for which a better plan is looked for."""


@click.command(epilog="Example: pnm why domain.pddl problem.pddl --call 3")
@click.argument("domain", type=FILE)
@click.argument("problem", type=FILE)
@click.option("--call", "called", metavar="CALL", help="why this call: its number in the plan, or the call, such as 'move(r1, a, b)'")
@click.option("--not", "other", metavar="CALL", help="why not this call, which the plan does not have, such as 'move(r1, a, b)'")
@click.option("--seconds", type=Seconds(0.1), default=10.0, show_default=True, help="for all searches together, at most")
@as_json_option
@command
def why(*, domain: Path, problem: Path, called: str | None, other: str | None, seconds: float, as_json: bool) -> int:
    """Explain a plan, or why there is none."""
    if called is not None and other is not None:
        raise InputError("expected --call or --not, not both: each is a question of its own")
    loaded = problem_in(domain, problem, for_its_goal=True)
    unwanted = None if other is None else _call(loaded, other, "--not")
    limit = TimeLimit.of(seconds)
    with searching(DEFAULT_PLANNER, seconds):
        found = limit.solve(loaded, share=0.5, improve=_IMPROVE)
        match found.plan:
            case _ if unwanted is not None:
                answers = [why_not(loaded, unwanted, found, limit)]
            case None:
                reason = why_no_plan(loaded, found, limit)
                answers = [reason, what_would_help(loaded, limit, reason)]
            case plan:
                answers = [why_plan(loaded, plan) if called is None else why_call_of_plan(loaded, plan, _number(loaded, plan, called))]
    show(answers, as_json=as_json)
    return 0


def show(answers: Sequence[Answer], *, as_json: bool) -> None:
    """Print answers: as trees that fit the terminal, in plain lines elsewhere, or as JSON."""
    if as_json:
        print(json.dumps({"answers": [answer.as_json() for answer in answers]}))
        return
    console = SafeConsole()
    for answer in answers:
        if console.is_terminal:
            console.print(_tree(answer, None), highlight=False)
        else:
            console.print(_lines(answer, None, 0), highlight=False, soft_wrap=True, markup=False)


def _tree(answer: Answer, above: Known | None) -> Tree:
    style = "" if answer.known.is_certain else "yellow"
    tree = Tree(Text(printable(answer.statement), style).append(_how(answer, above), "dim"), guide_style="dim")
    tree.children += (_tree(reason, answer.known) for reason in answer.reasons)
    return tree


def _lines(answer: Answer, above: Known | None, depth: int) -> str:
    own = f"{'  ' * depth}{answer.statement}{_how(answer, above)}"
    return "\n".join((own, *(_lines(reason, answer.known, depth + 1) for reason in answer.reasons)))


def _how(answer: Answer, above: Known | None) -> str:
    """Return how a statement is known, where that does not go without saying."""
    return "" if answer.known is above or answer.known is Known.GIVEN else f"  [{answer.known.value}]"


def _number(problem: Problem, plan: Plan, called: str) -> int:
    """Return the number from 0 of the call that is meant."""
    if called.strip("# ").isdecimal():
        number = int(called.strip("# "))
        if not 1 <= number <= len(plan.steps):
            raise InputError(f"--call {number}: the plan has {len(plan.steps)} calls; expected a number from 1")
        return number - 1
    wanted = str(_call(problem, called, "--call"))
    steps = [str(step) for step in plan.steps]
    if wanted not in steps:
        raise InputError(f"--call: {wanted} is not in the plan; {suggestion(wanted, steps) or 'pnm why without --call lists its calls'}")
    return steps.index(wanted)


def _call(problem: Problem, text: str, option: str) -> PlanStep:
    """Return the call that is written as ``move(r1, a, b)`` or as ``(move r1 a b)``; raise an `InputError` for other names."""
    name, bracket, arguments = text.strip().partition("(")
    if name and bracket:
        text = f"({name} {arguments.replace(',', ' ')}"
    elif name:
        text = f"({name})"
    try:
        (step,) = read_plan(" ".join(text.split()) or "()", problem).steps
    except InputError as error:
        raise InputError(f"{option}: {error.message}") from error
    return step
