"""A second planner, which shares nothing with the first: Fast Downward as a program, on the text of a problem.

It knows neither time nor numbers. So it gets a problem that has every plan of the original one, and more: an action that lasts becomes
a start and an end, numbers and constraints are left out. If that has no plan, the original one has none.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from pnm.core.logic.conditions import All, Any as AnyOf, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction, every_part
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Effects, ForEach, Set, When, every_effect
from pnm.core.logic.expressions import Constant
from pnm.core.logic.rules import Rules

LIMIT: Final = 20.0
"""Seconds of one search."""
_UNSOLVABLE: Final = (10, 11)
"""Exit statuses of Fast Downward: the translator, or the whole search space, says that there is no plan."""


def second_opinion(problem: Problem) -> bool | None:
    """Return whether the second planner says that a problem has a plan; None if it does not know."""
    if (allowing := allowing_more(problem)) is None:
        return None
    status, _ = _run(write_domain(allowing.domain), write_problem(allowing), "lazy_greedy([ff()])")
    return False if status in _UNSOLVABLE else True if status == 0 and is_classical(problem) else None


def fewest_calls(problem: Problem) -> int | None:
    """Return the number of calls of a shortest plan of a problem without time and numbers; None if it is not found out."""
    status, text = _run(write_domain(problem.domain), write_problem(replace(problem, metric=None)), "astar(blind())")
    length = re.search(r"Plan length: (\d+) step", text)
    return int(length[1]) if status == 0 and length else None


def is_classical(problem: Problem) -> bool:
    """Return whether the second planner knows all that there is in the problem."""
    numbers = any(not declared.values for declared in problem.domain.functions.values())
    constraints = problem.constraints or problem.domain.constraints
    return not (problem.is_timed or numbers or constraints or problem.has_preferences or problem.has_tasks)


@cache
def _run(domain: str, problem: str, search: str) -> tuple[int, str]:
    spec = find_spec("up_fast_downward")
    assert spec, "pip install up-fast-downward"
    assert spec.origin
    program = Path(spec.origin).parent / "downward" / "fast-downward.py"
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (("domain.pddl", domain), ("problem.pddl", problem)):
            (Path(folder) / name).write_text(text)
        command = [sys.executable, str(program), "domain.pddl", "problem.pddl", "--search", search]
        try:
            done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=LIMIT)
        except subprocess.TimeoutExpired:
            return -1, ""
        return done.returncode, done.stdout


# --- what allows more ----------------------------------------------------------------------------


class _Beyond(Exception):
    """It has something that is neither kept nor left out here."""


def allowing_more(problem: Problem) -> Problem | None:
    """Return a problem without time and numbers that has every plan of this one; None if none can be made."""
    domain = problem.domain
    if any(declared.values for declared in domain.functions.values()) or problem.has_tasks:
        return None
    try:
        predicates, actions = dict(domain.predicates), dict[str, ActionSchema]()
        for schema in domain.actions.values():
            for action in _moments(schema, predicates):
                actions[action.name] = action
        for number, change in enumerate(problem.timed):
            effects = tuple(Set(fluent, Constant(value)) for fluent, value in change.changes.items() if isinstance(value, bool))
            actions[f"by-itself-{number}"] = ActionSchema(f"by-itself-{number}", end_effects=effects)
        rules = Rules(tuple(replace(rule, condition=_more(rule.condition)) for rule in domain.rules))
        goal = _more(problem.goal)
    except _Beyond:
        return None
    constants = {**domain.constants, **(problem.own_objects if problem.timed else {})}
    loose = Domain(
        domain.name,
        domain.types,
        constants,
        predicates,
        {},
        actions,
        rules,
        requirements=(":adl", ":derived-predicates") if rules else (":adl",),
    )
    own = {} if problem.timed else problem.own_objects
    init = {fluent: value for fluent, value in problem.init.items() if isinstance(value, bool)}
    return Problem(problem.name, loose, own, init, (), goal)


def _moments(schema: ActionSchema, predicates: dict[str, Declaration]) -> Iterator[ActionSchema]:
    """Yield an action without time, or the start and the end of one with time; between them it is under way."""
    if schema.duration is None:
        yield ActionSchema(schema.name, schema.parameters, _more(schema.precondition), end_effects=_facts(schema.end_effects))
        return
    name = f"{schema.name}-goes-on"
    predicates[name] = Declaration(name, schema.parameters)
    under_way = (name, *(variable.name for variable in schema.parameters))
    begins = (*_facts(schema.start_effects), Set(under_way, Constant(True)))
    yield ActionSchema(f"{schema.name}-begins", schema.parameters, _more(schema.precondition), end_effects=begins)
    ready = conjunction((Holds(under_way), _more(schema.end_condition)))
    yield ActionSchema(f"{schema.name}-ends", schema.parameters, ready, end_effects=_facts(schema.end_effects))


def _facts(effects: Effects) -> Effects:
    """Return the effects on facts."""
    kept: list[Set | When | ForEach] = []
    for effect in effects:
        match effect:
            case Set(_, Constant(bool()), "assign"):
                kept.append(effect)
            case Set():
                pass
            case When(condition, inner, early):
                if early or any(map(_is_numeric, every_part(condition))):
                    if _facts(inner):
                        raise _Beyond
                elif facts := _facts(inner):
                    kept.append(When(condition, facts))
            case ForEach(variables, inner):
                if facts := _facts(inner):
                    kept.append(ForEach(variables, facts))
    assert all(isinstance(effect, Set | When | ForEach) for effect in every_effect(tuple(kept)))
    return tuple(kept)


def _is_numeric(condition: Condition) -> bool:
    sides = (condition.left, condition.right) if isinstance(condition, Compare) else ()
    return any(not isinstance(side, Constant) or not isinstance(side.value, str) for side in sides)


def _more(condition: Condition, *, positive: bool = True) -> Condition:
    """Return a condition without comparisons of numbers that holds where this one does; the other way round under a negation."""
    match condition:
        case Compare():
            return (All() if positive else AnyOf()) if _is_numeric(condition) else condition
        case Not(operand):
            return Not(_more(operand, positive=not positive))
        case All(operands):
            return All(tuple(_more(operand, positive=positive) for operand in operands))
        case AnyOf(operands):
            return AnyOf(tuple(_more(operand, positive=positive) for operand in operands))
        case Implies(left, right):
            return Implies(_more(left, positive=not positive), _more(right, positive=positive))
        case ForAll(variables, body):
            return ForAll(variables, _more(body, positive=positive))
        case Exists(variables, body):
            return Exists(variables, _more(body, positive=positive))
        case _:
            return condition
