"""The world of problems and hand-written plans: as a problem, and as the one in which simulated robots work.

Plans become a problem without actions: facts of it can be queried and updated as PDDL, and reports checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld
from pnm.core.logic.computed_values import fluents_in
from pnm.core.logic.conditions import Compare, Computed, Condition, Holds, every_part
from pnm.core.logic.domain import Declaration, Vocabulary
from pnm.core.logic.effects import Set, When, every_effect, names_written
from pnm.core.logic.expressions import DURATION, EXISTS, UNDEFINED, Constant, Fluent, Value, Variable, expression_fluents
from pnm.core.logic.rules import Rules
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import Conditional
from pnm.core.nature import Nature
from pnm.errors import InputError
from pnm.language.plan import HandWrittenPlan

_WORD: Final = re.compile(r"[^\s()]+")

Use: TypeAlias = tuple[Fluent, Value | None]
"""A fluent that a plan uses, and a value of its kind: True for a fact, None if the kind is unknown."""


def world_of_plans(plans: Iterable[HandWrittenPlan]) -> Problem:
    """Return a problem with the declarations of the plans, and inferred ones for names that they use without a declaration."""
    plans = tuple(plans)
    declarations = _Declarations()
    types: dict[str, tuple[str, ...]] = {}
    objects: dict[str, tuple[str, ...]] = {}
    for plan in plans:
        declarations.declare(plan)
        types |= plan.declared.domain.types
        objects |= plan.declared.objects
    for fluent, value in (use for plan in plans for use in _uses(plan)):
        declarations.use(fluent, value)
    rules = tuple({str(rule): rule for plan in plans for rule in plan.rules}.values())
    domain = Domain("plans", types=types, predicates=declarations.predicates, functions=declarations.functions, rules=Rules(rules))
    return Problem("plans", domain, objects or dict.fromkeys(declarations.objects, ("object",)))


def names_of_world(problem: Problem | None, plans: Iterable[HandWrittenPlan]) -> Vocabulary:
    """Return the names that reports about a world may have: those of its problem, and those that its plans declare or use.

    Plans get objects while they run, in parameters and results, so their facts may also be about objects that are not declared.
    """
    plans, own = tuple(plans), problem.vocabulary if problem else Vocabulary({}, is_complete=False)
    declared = {name: types for plan in plans for name, types in plan.declared.objects.items()}
    theirs = replace(world_of_plans(plans), own_objects=declared).vocabulary
    names = theirs.fluents.union(fluent[0] for plan in plans for fluent, _ in _uses(plan)) - own.fluents
    domains = [plan.declared.domain.fluents for plan in plans]
    disputed = {name for name in names if len({fluents[name] for fluents in domains if name in fluents}) > 1}
    return Vocabulary(
        own.actions,
        own.fluents | names,
        own.objects | theirs.objects,
        own.derived | (theirs.derived & names),
        {name: signature for name, signature in {**theirs.signatures, **own.signatures}.items() if name not in disputed},
        {**theirs.types, **own.types},
        {**theirs.types_of, **own.types_of},
        frozenset(names),
        is_complete=problem is not None or (bool(plans) and all(domains)),
        outcomes=own.outcomes,
    )


def with_names_of(problem: Problem, plans: Iterable[HandWrittenPlan], texts: Iterable[str]) -> Problem:
    """Return the problem with the words of texts as objects, unless plans declare some; raise an `InputError` for quantifiers without."""
    if any(plan.declared.objects for plan in plans):
        return problem
    words = dict.fromkeys(word for text in texts for word in _WORD.findall(text))
    if quantifier := next((word for word in words if word.lower() in ("forall", "exists")), None):
        raise InputError(f"the plans declare no objects; expected a condition without {quantifier}")
    known = {name.lower() for name in problem.objects}
    others = (word for word in words if word[0] != "?" and word.lower() not in known)
    return replace(problem, own_objects={**problem.own_objects, **dict.fromkeys(others, ("object",))})


@dataclass
class _Declarations:
    """Declarations collected from plans, and inferred from what they use. All fields are mutable state."""

    predicates: dict[str, Declaration] = field(default_factory=dict)
    functions: dict[str, Declaration] = field(default_factory=dict)
    objects: dict[str, None] = field(default_factory=dict)

    def declare(self, plan: HandWrittenPlan) -> None:
        self.predicates |= plan.declared.domain.predicates
        self.functions |= plan.declared.domain.functions

    def use(self, fluent: Fluent, value: Value | None) -> None:
        name, *arguments = fluent
        values = ("object",) if isinstance(value, str) else ()
        names = (*arguments, value) if isinstance(value, str) else arguments
        self.objects |= dict.fromkeys(name for name in names if _WORD.fullmatch(name) and name[0] != "?" and name != UNDEFINED)
        if value is None or name in self.predicates or name == DURATION[0]:
            return
        parameters = tuple(Variable(f"?x{number}") for number in range(len(arguments)))
        declared = self.functions.get(name)
        if isinstance(value, bool) and declared is None:
            self.predicates[name] = Declaration(name, parameters)
        elif declared is None or (values and not declared.values):
            self.functions[name] = Declaration(name, declared.parameters if declared else parameters, values)


def _uses(plan: HandWrittenPlan) -> Iterator[Use]:
    """Yield the fluents of facts, actions, control steps, goal and rules."""
    yield from plan.facts.items()
    for change in plan.timed:
        yield from change.changes.items()
    for call in plan.graph.calls:
        action = call.action
        for condition in (action.precondition, action.invariant, action.end_condition, action.expected):
            yield from _in_condition(condition)
        for effect in every_effect((*action.start_effects, *action.end_effects)):
            match effect:
                case Set(fluent, value):
                    yield fluent, value.value if isinstance(value, Constant) else 0.0
                    yield from ((read, 0.0) for read in expression_fluents(value))
                case When(condition):
                    yield from _in_condition(condition)
                case _:
                    pass
        yield (action.name, *action.arguments), None
    for step in plan.graph.every_step:
        if isinstance(step, Conditional):
            yield from _in_condition(step.condition)
    yield from _in_condition(plan.goal)
    for rule in plan.rules:
        yield (rule.name, *(variable.name for variable in rule.variables)), True
        yield from _in_condition(rule.condition)


def _in_condition(condition: Condition) -> Iterator[Use]:
    for part in every_part(condition):
        match part:
            case Holds(fluent):
                yield fluent, True
            case Compare(_, left, right):
                # A function is compared with an object, or else with numbers.
                objects = [side.value for side in (left, right) if isinstance(side, Constant) and isinstance(side.value, str)]
                kind = objects[0] if objects else 0.0
                yield from ((fluent, kind) for side in (left, right) for fluent in expression_fluents(side))
            case Computed(data):
                yield from ((fluent, None) for fluent in fluents_in(data))
            case _:
                pass


# --- simulated robots -----------------------------------------------------------------------------
# Simulated robots for a problem or a hand-written plan.


def simulated_backend(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults = NO_FAULTS) -> SimulatedBackend:
    """Return an execution backend of simulated robots, in the initial world of the problem or plan."""
    return SimulatedBackend(robots_of(described, bindings, faults), bindings.assumed)


def robots_of(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return simulated robots in the initial world of the problem or plan."""
    if isinstance(described, Problem):
        changing = dynamic_names(described)
    else:
        calls = described.graph.calls
        changing = names_written(tuple(effect for call in calls for effect in (*call.action.start_effects, *call.action.end_effects)))
        changing |= dynamic_names(described.declared)  # a planner that takes over may use any action of the domain
    hidden = {fluent[0] for change in faults.changes for fluent in change.changes}
    hidden |= {EXISTS for binding in bindings.actions.values() if binding.found}
    return SimulatedRobots(
        SimulatedWorld(initial_knowledge(described), changing | hidden),
        faults,
        bindings,
        described.timed,
        # In PDDL an action without a duration is instantaneous where there are times; otherwise nothing is known of how long it takes.
        untimed=0.0 if isinstance(described, Problem) and described.is_timed else 1.0,
        speed=speed,
        nature=Nature(model) if (model := described if isinstance(described, Problem) else described.declared).domain.nature else None,
        capacities={} if isinstance(described, Problem) else described.graph.capacities,
    )
