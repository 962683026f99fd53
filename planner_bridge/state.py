"""Knowledge ↔ initial state: what a problem says at first, and the problem as the world now is."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner_bridge.model import ActionSchema, Declaration, Domain, Problem, TimedChange
from pnm.conditions import All, Holds, Not
from pnm.effects import names_written
from pnm.expressions import UNKNOWN, Fluent, Value
from pnm.knowledge import KnowledgeBase


def initial_knowledge(problem: Problem) -> KnowledgeBase:
    """Return a knowledge base with the problem's objects and initial state."""
    return KnowledgeBase(problem.init, objects=problem.objects_by_type)


def dynamic_names(problem: Problem) -> frozenset[str]:
    """Return the predicates and functions that actions or timed changes may alter."""
    actions = (names_written((*schema.start_effects, *schema.end_effects)) for schema in problem.domain.actions.values())
    timed = (frozenset(fluent[0] for fluent in change.changes) for change in problem.timed)
    return frozenset().union(*actions, *timed)


@dataclass(frozen=True, slots=True)
class ForbiddenCall:
    """A ground action that no plan may use any more."""

    action: str
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


def problem_now(
    problem: Problem, knowledge: KnowledgeBase, elapsed: float = 0.0, forbidden: frozenset[ForbiddenCall] = frozenset()
) -> Problem:
    """Return the problem that starts from what is known, so many seconds after the original one, without the forbidden calls."""
    init = {fluent: value for fluent, value in knowledge.facts().items() if value is not UNKNOWN}
    timed = tuple(TimedChange(change.time - elapsed, change.changes) for change in problem.timed if change.time > elapsed)
    now = replace(problem, init=init, timed=timed)
    return _forbid(now, forbidden) if forbidden else now


def _forbid(problem: Problem, forbidden: frozenset[ForbiddenCall]) -> Problem:
    """Add to every action concerned a precondition that is false for the forbidden arguments."""
    domain, init = problem.domain, dict[Fluent, Value](problem.init)
    predicates, actions = dict(domain.predicates), dict(domain.actions)
    for name in {call.action for call in forbidden}:
        schema = actions[name]
        fact = f"forbidden-{name}"
        predicates[fact] = Declaration(fact, schema.parameters)
        actions[name] = _guarded(schema, Not(Holds((fact, *(variable.name for variable in schema.parameters)))))
    for call in forbidden:
        init[(f"forbidden-{call.action}", *call.arguments)] = True
    return replace(problem, domain=_with(domain, predicates, actions), init=init)


def _guarded(schema: ActionSchema, guard: Not) -> ActionSchema:
    return replace(schema, precondition=All((guard, schema.precondition)))


def _with(domain: Domain, predicates: dict[str, Declaration], actions: dict[str, ActionSchema]) -> Domain:
    requirements = tuple(dict.fromkeys((*domain.requirements, ":negative-preconditions")))
    return replace(domain, requirements=requirements, predicates=predicates, actions=actions)
