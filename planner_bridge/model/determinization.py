"""Determinization: a problem whose actions have several outcomes as one for planners that know only actions with one.

There is an action for every outcome, as if one could choose ("all-outcomes determinization", Yoon, Fern and Givan, *FF-Replan*, 2007).
And the outcomes that nothing will tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, count
from typing import TYPE_CHECKING, Final

from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import names_written, outcomes
from pnm.core.logic.expressions import OnlyObjects
from pnm.errors import InputError, Position, located

if TYPE_CHECKING:
    from planner_bridge.model.rates import Rates
    from pnm.core.machine.bindings import Bindings

_OF_OUTCOMES: Final = (":non-deterministic", ":probabilistic-effects", ":rewards")
"""The requirements of domains whose actions have several."""


@dataclass(frozen=True, slots=True)
class Determinization:
    """A problem whose actions have one outcome each."""

    problem: Problem
    outcomes: Mapping[str, tuple[str, str]]
    """For the name of every action there that stands for an outcome, the action here and the outcome."""

    def plan(self, plan: Plan) -> Plan:
        """Return a plan of that problem as one of the problem that it was made of; that no plan is better there proves nothing here."""
        steps = []
        for step in plan.steps:
            action, outcome = self.outcomes.get(step.action, (step.action, step.outcome))
            steps.append(replace(step, action=action, outcome=outcome))
        return replace(plan, steps=tuple(steps), is_best=False)

    def bindings(self, bindings: Bindings) -> Bindings:
        """Return the bindings with those of the actions there, which the servers of the actions here carry out."""
        bound = {name: (bindings.of(action), action) for name, (action, _) in self.outcomes.items()}
        own = {name: replace(binding, server=binding.server or action) for name, (binding, action) in bound.items()}
        return replace(bindings, actions={**bindings.actions, **own})

    def rates(self, learned: Rates) -> Rates:
        """Return what was learned with the same for the actions there."""
        own = {
            call._replace(action=name): counts
            for name, (action, _) in self.outcomes.items()
            for call, counts in learned.calls.items()
            if call.action == action
        }
        return replace(learned, calls={**learned.calls, **own})


def determinization(problem: Problem) -> Determinization:
    """Return the problem with an action for every outcome; the names of these begin with that of their action.

    An outcome that changes nothing has none: no plan would expect it. Raises an `InputError` for an action of too many outcomes.
    """
    domain, stand_for = determinized_domain(problem.domain, problem.members)
    return Determinization(replace(problem, domain=domain), stand_for)


def check_outcomes(problem: Problem, position: Position) -> None:
    """Refuse an action that has too many outcomes for the objects of the problem."""
    with located(position):
        determinized_domain(problem.domain, problem.members)


@once_per_domain
def determinized_domain(domain: Domain, members: tuple[tuple[str, tuple[str, ...]], ...]) -> tuple[Domain, dict[str, tuple[str, str]]]:
    """Return the domain with an action for every outcome, and what each of them stands for; see `Problem.members`."""
    objects, taken = OnlyObjects(dict(members)), {name.lower() for name in domain.actions}
    actions: dict[str, ActionSchema] = {}
    stand_for: dict[str, tuple[str, str]] = {}
    for schema in domain.actions.values():
        if schema.name not in domain.uncertain:
            actions[schema.name] = schema
            continue
        try:
            different = {way.effects: way for way in outcomes(schema.end_effects, objects)}
        except InputError as error:
            raise InputError(f"{schema.name}: {error.message}") from error
        for effects, way in different.items():
            if effects or schema.start_effects:
                name = next(name for number in count(1) if (name := f"{schema.name}__{number}").lower() not in taken)
                taken.add(name.lower())
                actions[name] = replace(schema, name=name, end_effects=effects)
                stand_for[name] = schema.name, way.name
    requirements = tuple([word for word in domain.requirements if word not in _OF_OUTCOMES])
    return replace(domain, requirements=requirements, actions=actions), stand_for


def untold(problem: Problem, bindings: Bindings, unseen: frozenset[str]) -> Iterator[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Yield outcomes that nothing tells apart: the action, their names, and the predicates and functions in which they differ.

    Args:
        unseen: the predicates and functions that no sensor reports.
    """
    for action in sorted(problem.domain.uncertain):
        names, facts = dict[str, None](), set[str]()
        untested = [way for way in problem.outcomes(action) if way.name not in bindings.of(action).outcomes]
        for one, other in combinations(untested, 2):
            different = names_written((*({*one.effects} - {*other.effects}), *({*other.effects} - {*one.effects})))
            if different and different <= unseen:
                names |= dict.fromkeys((one.name, other.name))
                facts |= different
        if names:
            yield action, tuple(names), tuple(sorted(facts))
