"""Grounding: an action schema and objects → a ground action; and the initial state of a problem ↔ a knowledge base."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

from planner_bridge.model.problem import Domain, Problem, once_per_domain
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition, names
from pnm.core.logic.domain import ActionSchema, ProblemModel, Types
from pnm.core.logic.effects import TimedChange, When, every_effect, names_written
from pnm.core.logic.expressions import UNKNOWN, Fluent, OnlyObjects, State, Unknown, Value, fluent_text, value_of
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.core.machine.plan_graph import GroundAction, ground_schema
from pnm.errors import InputError

if TYPE_CHECKING:
    from pnm.language.plan import HandWrittenPlan


def ground_action(
    schema: ActionSchema, arguments: tuple[str, ...], duration: float | None = None, state: State | None = None, outcome: str = ""
) -> GroundAction:
    """Return the action with these arguments, and a planned duration in seconds unless it is instantaneous.

    Args:
        state: has the objects for which outcomes may differ.
        outcome: the name of the expected one; the first by default.

    Raises an `InputError` if there are more or fewer arguments than parameters, or no such outcome.
    """
    if len(arguments) != len(schema.parameters):
        expected = " ".join(variable.name for variable in schema.parameters) or "none"
        raise InputError(f"{schema.name} takes {len(schema.parameters)} arguments ({expected}), found {len(arguments)}")
    action = ground_schema(schema, arguments, schema.environment(arguments), state or OnlyObjects({}), duration, outcome)
    return action if schema.duration is not None or duration is None else replace(action, duration=None)


@once_per_domain
def ground_step(
    domain: Domain,
    action: str,
    arguments: tuple[str, ...],
    duration: float | None,
    outcome: str = "",
    members: tuple[tuple[str, tuple[str, ...]], ...] = (),
) -> GroundAction:
    """Return a ground action for a step of a plan, the same one for the same step of another plan; `Problem.members` in the last place."""
    return ground_action(domain.actions[action], arguments, duration, OnlyObjects(dict(members)), outcome)


def modelled_duration(schema: ActionSchema, arguments: tuple[str, ...], state: State) -> float | None:
    """Return the shortest duration the schema allows in the state; None for an instantaneous action."""
    if schema.duration is None:
        return None
    env = schema.environment(arguments)
    bounds = [value_of(constraint.bound, state, env) for constraint in schema.duration if constraint.operation in ("=", ">=")]
    numbers = [float(bound) for bound in bounds if bound is not UNKNOWN and not isinstance(bound, str)]
    return max(numbers, default=0.0)


def initial_knowledge(*described: Problem | HandWrittenPlan) -> KnowledgeBase:
    """Return the initial knowledge of a problem or plan, or of several in one world; raise an `InputError` if two differ about a fluent."""
    beginnings = [
        (source.name, source.init, source.objects_by_type, source.domain.rules)
        if isinstance(source, Problem)
        else (source.name, source.facts, source.objects, source.rules)
        for source in described
    ]
    if len(beginnings) == 1:
        _, facts, objects, rules = beginnings[0]
        return KnowledgeBase(facts, objects=objects, rules=rules)
    values: dict[Fluent, tuple[Value, str]] = {}
    members: dict[str, tuple[str, ...]] = {}
    shared: dict[str, DerivationRule] = {}
    for name, facts, objects, rules in beginnings:
        for fluent, value in facts.items():
            before, other = values.setdefault(fluent, (value, name))
            if before != value:
                raise InputError(f"{other} and {name} begin with different values of {fluent_text(fluent)}: {before}, {value}")
        for kind, those in objects.items():
            members[kind] = tuple(dict.fromkeys((*members.get(kind, ()), *those)))
        shared |= {str(rule): rule for rule in rules}
    facts = {fluent: value for fluent, (value, _) in values.items()}
    return KnowledgeBase(facts, objects=members, rules=Rules(tuple(shared.values())))


def dynamic_names(problem: ProblemModel) -> frozenset[str]:
    """Return the predicates and functions that may change: by actions, by processes and events, or at a time."""
    actions = (names_written((*schema.start_effects, *schema.end_effects)) for schema in problem.domain.schemas)
    timed = (frozenset(fluent[0] for fluent in change.changes) for change in problem.timed)
    return frozenset().union(*actions, *timed)


def conditions_of(problem: Problem) -> Iterator[Condition]:
    """Yield every condition that decides about the validity of a plan."""
    yield problem.goal
    yield from (rule.condition for rule in problem.domain.rules)
    for schema in problem.domain.schemas:
        yield from (schema.precondition, schema.invariant, schema.end_condition)
        effects = every_effect((*schema.start_effects, *schema.end_effects))
        yield from (effect.condition for effect in effects if isinstance(effect, When))
    for constraint in (*problem.domain.constraints, *problem.constraints):
        yield from constraint.conditions


def decisive_names(problem: Problem) -> frozenset[str]:
    """Return the predicates and functions that may change, and that some condition depends on: what tells states apart."""
    read = (name for condition in conditions_of(problem) for name in names(condition))
    return dynamic_names(problem) & problem.domain.rules.base(read)


def problem_now(problem: Problem, knowledge: KnowledgeBase, elapsed: float = 0.0) -> Problem:
    """Return the problem whose initial state is the knowledge, `elapsed` seconds after the original one.

    Fluents of undeclared things, which sensors may report, are left out, and so are numbers that are not finite.
    """

    problem = with_found(problem, knowledge)

    @cache
    def members(types: Types) -> frozenset[str]:
        return frozenset(name for kind in types for name in problem.objects_by_type.get(kind, ()))

    known = problem.init  # which has no other fluents
    recorded = {
        fluent: value
        for fluent, value in knowledge.facts().items()
        if known.get(fluent) is value or _is_declared(fluent, value, problem.domain, members)
    }
    init = {fluent: value for fluent, value in recorded.items() if not isinstance(value, Unknown)}
    return replace(later(problem, elapsed), init=init, unknown=frozenset(recorded.keys() - init.keys()))


def with_found(problem: Problem, knowledge: KnowledgeBase) -> Problem:
    """Return the problem with the objects that were found besides its own."""
    if len(knowledge.objects(("object",))) <= len(problem.objects):
        return problem
    found = {name: problem.domain.joined(types) for name, types in sorted(knowledge.found().items()) if name not in problem.objects}
    return replace(problem, own_objects={**problem.own_objects, **found}) if found else problem


def later(problem: Problem, elapsed: float) -> Problem:
    """Return the problem with the times of what changes by itself as they are `elapsed` seconds later."""
    timed = tuple(TimedChange(change.time - elapsed, change.changes) for change in problem.timed if change.time > elapsed)
    return replace(problem, timed=timed)


def _is_declared(fluent: Fluent, value: Value | Unknown, domain: Domain, members: Callable[[Types], frozenset[str]]) -> bool:
    is_fact = isinstance(value, bool) or (value is UNKNOWN and fluent[0] in domain.predicates)
    declared = domain.predicates.get(fluent[0]) if is_fact else domain.functions.get(fluent[0])
    if declared is None or len(declared.parameters) != len(fluent) - 1:
        return False
    if not all(name in members(variable.types) for name, variable in zip(fluent[1:], declared.parameters, strict=True)):
        return False
    match value:
        case bool() | Unknown():
            return True
        case str():
            return value in members(declared.values)
        case _:
            return not declared.values and isfinite(value)
