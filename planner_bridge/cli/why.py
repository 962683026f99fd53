"""`pnm why`: the answers to why there is this plan, or none, why it has a call, and why it has not another one."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.text import Text
from rich.tree import Tree

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import FILE, Seconds, as_json_option, command, problem_in, searching
from planner_bridge.explanations.answer import Answer, Known
from planner_bridge.explanations.needed_call import why_call_of_plan
from planner_bridge.explanations.no_plan import TimeLimit, why_no_plan
from planner_bridge.explanations.plan_overview import why_plan
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.plan_text import read_plan
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER
from planner_bridge.planning.solve import solve
from pnm.errors import InputError, suggestion
from pnm.knowledge.sources.person_text import printable


@click.command(epilog="Example: pnm why domain.pddl problem.pddl --call 3")
@click.argument("domain", type=FILE)
@click.argument("problem", type=FILE)
@click.option("--call", "called", metavar="CALL", help="why this call: its number in the plan, or the call, such as 'move(r1, a, b)'")
@click.option("--seconds", type=Seconds(0.1), default=10.0, show_default=True, help="for all searches together, at most")
@as_json_option
@command
def why(*, domain: Path, problem: Path, called: str | None, seconds: float, as_json: bool) -> int:
    """Explain a plan, or why there is none."""
    loaded = problem_in(domain, problem, for_its_goal=True)
    limit = TimeLimit.of(seconds)
    with searching(DEFAULT_PLANNER, seconds):
        found = solve(loaded, timeout=limit.left / 2, improve=0.0)
        if called is not None and found.plan:
            answer = why_call_of_plan(loaded, found.plan, _number(loaded, found.plan, called))
        elif found.plan:
            answer = why_plan(loaded, found.plan)
        else:
            answer = why_no_plan(loaded, found, limit)
    show(answer, as_json=as_json)
    return 0


def show(answer: Answer, *, as_json: bool) -> None:
    """Print an answer: as a tree that fits the terminal, in plain lines elsewhere, or as JSON."""
    if as_json:
        print(json.dumps(answer.as_json()))
        return
    console = SafeConsole()
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
