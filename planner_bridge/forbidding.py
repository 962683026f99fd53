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
    facts = {name: unused(f"forbidden-{name}", domain) for name in sorted({call.action for call in forbidden})}
    for name, fact in facts.items():
        schema = actions[name]
        predicates[fact] = Declaration(fact, schema.parameters)
        actions[name] = guarded(schema, Not(Holds((fact, *(variable.name for variable in schema.parameters)))))
    for call in forbidden:
        init[(facts[call.action], *call.arguments)] = True
    return replace(problem, domain=changed(domain, predicates, actions), init=init)


def unused(name: str, domain: Domain) -> str:
    """Return a name for a predicate that begins so and is not in the domain."""
    while name in domain.predicates or name in domain.functions:
        name += "-"
    return name


def guarded(schema: ActionSchema, guard: Not) -> ActionSchema:
    """Return the action with one more precondition."""
    return replace(schema, precondition=All((guard, schema.precondition)))


def changed(domain: Domain, predicates: dict[str, Declaration], actions: dict[str, ActionSchema]) -> Domain:
    """Return the domain with these predicates and actions, and the requirement that negated preconditions ask for."""
    requirements = tuple(dict.fromkeys((*domain.requirements, ":negative-preconditions")))
    return replace(domain, requirements=requirements, predicates=predicates, actions=actions)
