"""Knowledge ↔ initial state: what a problem says at first, and the problem as the world now is."""

from __future__ import annotations

from dataclasses import replace

from planner_bridge.model import Problem
from pnm.effects import TimedChange, names_written
from pnm.expressions import Fluent, Unknown, Value
from pnm.knowledge import KnowledgeBase
from pnm.rules import Rules


def initial_knowledge(problem: Problem) -> KnowledgeBase:
    """Return a knowledge base with the problem's objects and initial state, and the domain's rules."""
    return KnowledgeBase(problem.init, objects=problem.objects_by_type, rules=Rules(problem.domain.rules))


def dynamic_names(problem: Problem) -> frozenset[str]:
    """Return the predicates and functions that actions or timed changes may alter."""
    actions = (names_written((*schema.start_effects, *schema.end_effects)) for schema in problem.domain.actions.values())
    timed = (frozenset(fluent[0] for fluent in change.changes) for change in problem.timed)
    return frozenset().union(*actions, *timed)


def problem_now(problem: Problem, knowledge: KnowledgeBase, elapsed: float = 0.0) -> Problem:
    """Return the problem that starts from what is known, so many seconds after the original one.

    What sensors report about things that the problem does not declare is left out.
    """
    known = knowledge.facts().items()
    init = {fluent: value for fluent, value in known if not isinstance(value, Unknown) and _is_declared(problem, fluent, value)}
    timed = tuple(TimedChange(change.time - elapsed, change.changes) for change in problem.timed if change.time > elapsed)
    return replace(problem, init=init, timed=timed)


def _is_declared(problem: Problem, fluent: Fluent, value: Value) -> bool:
    if not all(argument in problem.objects for argument in fluent[1:]):
        return False
    if isinstance(value, bool):
        return fluent[0] in problem.domain.predicates
    function = problem.domain.functions.get(fluent[0])
    if function is None or not isinstance(value, str):
        return function is not None and not function.values
    return any(value in problem.objects_by_type.get(kind, ()) for kind in function.values)
