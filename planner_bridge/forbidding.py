"""Ground actions that no plan may use any more."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner_bridge.model import ActionSchema, Declaration, Domain, Problem
from pnm.conditions import All, Holds, Not
from pnm.expressions import Fluent, Value
from pnm.plan_graph import GroundAction


@dataclass(frozen=True, slots=True)
class ForbiddenCall:
    """A ground action that no plan may use any more."""

    action: str
    arguments: tuple[str, ...]

    @staticmethod
    def of(action: GroundAction) -> ForbiddenCall:
        """Return what forbids this ground action."""
        return ForbiddenCall(action.name, action.arguments)

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


def forbid(problem: Problem, forbidden: frozenset[ForbiddenCall]) -> Problem:
    """Return the problem in which every action concerned has a precondition that is false for the forbidden arguments."""
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
