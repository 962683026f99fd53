"""Compilation of effects and numbers into a normal form for other planners: the same plans, fewer constructs.

Kairos calculates with floats: for it decimals become whole numbers. Others differ in how they treat nested quantifiers, a fact that is
deleted and added at once, scaling effects, and counters that no condition reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from itertools import chain, count
from typing import Any, Final, assert_never

from planner_bridge.model.grounding import conditions_of
from planner_bridge.model.problem import Domain, Metric, Problem, once_per_domain
from pnm.core.logic.conditions import TRUE, All, Compare, Condition, Exists, Holds, Not, conjuncts, every_part, ground, names
from pnm.core.logic.domain import ActionSchema, DurationConstraint
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, TimedChange, When, ground_effects
from pnm.core.logic.expressions import (
    DURATION,
    Arithmetic,
    Constant,
    Expression,
    Fluent,
    Value,
    ValueOf,
    Variable,
    bind,
    expression_fluents,
    is_number,
)


@dataclass(frozen=True, slots=True)
class Assignment:
    """An effect in normal form: a fluent gets a value, for every choice of objects for the variables, where the condition holds."""

    fluent: Fluent
    value: Expression
    operation: str = "assign"
    """``assign``, ``increase`` or ``decrease``."""
    condition: Condition = TRUE
    variables: tuple[Variable, ...] = ()
    early: bool = False
    """Of an effect at the end of an action: its condition is decided at the start."""
    uncertain: bool = False
    """Of one of several outcomes."""

    @property
    def is_plain(self) -> bool:
        """Whether it always happens, once."""
        return self.condition == TRUE and not self.variables and not self.uncertain


def assignments(effects: Effects, parameters: Iterable[Variable] = ()) -> tuple[Assignment, ...]:
    """Return the effects of one moment of an action without nesting, scaling, and deletes that an add undoes.

    Two facts that differ in nothing but parameters are taken for different ones: whether they
    are is known only when the action is ground. Of several outcomes those of all are there.
    """
    taken = {variable.name for variable in parameters}
    flat = list(_flat(effects, (), TRUE, False, taken))
    adds = [change for change in flat if change.value == Constant(True) and not change.uncertain]
    needed = (_unless_added(change, adds) if change.value == Constant(False) else change for change in flat)
    return tuple(change for change in needed if change is not None)


def _flat(effects: Effects, variables: tuple[Variable, ...], condition: Condition, early: bool, taken: set[str]) -> Iterator[Assignment]:
    """Yield the assignments of effects inside these quantifiers and conditions; bound variables get names that are not taken."""
    for effect in effects:
        match effect:
            case Set(fluent, value, "scale-up" | "scale-down" as scaling):
                product = Arithmetic("*" if scaling == "scale-up" else "/", (ValueOf(fluent), value))
                yield Assignment(fluent, product, "assign", condition, variables, early)
            case Set(fluent, value, operation):
                yield Assignment(fluent, value, operation, condition, variables, early)
            case When(inner, then):
                yield from _flat(then, variables, _both(condition, inner), early or effect.early, taken)
            case ForEach(bound, body):
                fresh: dict[str, str] = {}
                for variable in bound:
                    names = chain((variable.name,), (f"{variable.name}-{number}" for number in count(1)))
                    fresh[variable.name] = next(name for name in names if name not in taken)
                taken |= {*fresh.values()}
                renamed = tuple(replace(variable, name=fresh[variable.name]) for variable in bound)
                yield from _flat(ground_effects(body, fresh), (*variables, *renamed), condition, early, taken)
            case OneOf():
                yield from (replace(change, uncertain=True) for change in _flat(effect.effects, variables, condition, early, taken))
            case _:
                assert_never(effect)


def _both(left: Condition, right: Condition) -> Condition:
    parts = tuple(part for part in (*conjuncts(left), *conjuncts(right)) if part != TRUE)
    return parts[0] if len(parts) == 1 else All(parts)


def _unless_added(delete: Assignment, adds: Iterable[Assignment]) -> Assignment | None:
    """Return the delete where no add of the same moment undoes it; None if one always does (PDDL 2.1, section 8)."""
    for add in adds:
        if add.fluent == delete.fluent and add.condition in (TRUE, delete.condition) and {*add.variables} <= {*delete.variables}:
            return None  # an add for every object of a type happens only if there is one
        if add.fluent[0] != delete.fluent[0]:
            continue
        renamed = {variable.name: f"{variable.name}-added" for variable in add.variables}
        different = [pair for pair in zip(delete.fluent, bind(add.fluent, renamed), strict=True) if pair[0] != pair[1]]
        if different and not delete.variables and not add.variables:
            continue
        if any(not deleted.startswith("?") and not added.startswith("?") for deleted, added in different):
            continue
        equal = (Compare("=", Constant(deleted), Constant(added)) for deleted, added in different)
        undone = _both(ground(add.condition, renamed), All(tuple(equal)))
        if add.variables:
            undone = Exists(tuple(replace(variable, name=renamed[variable.name]) for variable in add.variables), undone)
        delete = replace(delete, condition=_both(delete.condition, Not(undone)))
    return delete


def schema_assignments(schema: ActionSchema) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
    """Return the assignments at the start and at the end of the action."""
    return assignments(schema.start_effects, schema.parameters), assignments(schema.end_effects, schema.parameters)


@once_per_domain
def action_assignments(domain: Domain) -> tuple[Assignment, ...]:
    """Return the assignments of all actions, at their starts and ends, and of processes and events."""
    return tuple(change for schema in domain.schemas for moment in schema_assignments(schema) for change in moment)


def functions_in_use(problem: Problem) -> frozenset[str]:
    """Return the functions on which the validity or the metric of a plan depends; others only count."""
    changes = action_assignments(problem.domain)
    used = {name for condition in conditions_of(problem) for name in names(condition)}
    used |= {fluent[0] for bound in _duration_bounds(problem) for fluent in expression_fluents(bound)}
    if problem.metric:
        used |= {fluent[0] for fluent in expression_fluents(problem.metric.expression)}
    before = -1
    while len(used) > before:
        before = len(used)
        used |= {fluent[0] for change in changes if change.fluent[0] in used for fluent in expression_fluents(change.value)}
    return frozenset(used) & frozenset(problem.domain.functions)


def is_whole(problem: Problem, functions: frozenset[str]) -> bool:
    """Whether all numbers that have to do with these functions are whole and stay so."""
    stated = [*problem.init.items(), *(pair for change in problem.timed for pair in change.changes.items())]
    parts = (part for condition in conditions_of(problem) for part in every_part(condition))
    expressions = [
        *(Constant(value) for fluent, value in stated if fluent[0] in functions),
        *(Constant(change.time) for change in problem.timed),
        *(change.value for change in action_assignments(problem.domain) if change.fluent[0] in functions),
        *(side for part in parts if isinstance(part, Compare) for side in (part.left, part.right)),
        *_duration_bounds(problem),
        *((problem.metric.expression,) if problem.metric else ()),
    ]
    return all(map(_is_whole, expressions))


def calculates_with_whole_numbers(problem: Problem) -> bool:
    """Return whether every number that decides about a plan is whole and stays so, or none is ever compared.

    Then all planners and we come to the same results. They calculate with floats or fractions, compare them exactly, and separate
    events by a time of their own; we tolerate a millionth: where numbers are not whole, a plan that they have ruled out may be valid here.
    """
    without_metric = replace(problem, metric=None)
    return not problem.domain.nature and is_whole(without_metric, functions_in_use(without_metric))


def _is_whole(expression: Expression) -> bool:
    match expression:
        case Constant(float() | int() as number):
            return number == int(number)
        case Arithmetic(operation, operands):
            return operation != "/" and all(map(_is_whole, operands))
        case _:
            return True


def _duration_bounds(problem: Problem) -> Iterator[Expression]:
    return (constraint.bound for schema in problem.domain.actions.values() for constraint in schema.duration or ())


def cost_function(problem: Problem) -> str | None:
    """Return the function that the metric minimises, if nothing reads it and actions only add to it; else None."""
    match problem.metric:
        case Metric("minimize", ValueOf((name,))) if name in problem.domain.functions:
            changes = [change for change in action_assignments(problem.domain) if change.fluent[0] == name]
            only_added = all(
                change.is_plain and change.operation == "increase" and change.fluent not in expression_fluents(change.value)
                for change in changes
            )
            if only_added and name not in functions_in_use(replace(problem, metric=None)):
                return name
    return None


# --- decimals -------------------------------------------------------------------------------------

_FACTORS: Final = (10, 100, 1000, 10_000, 100_000)
"""Decimals that are closer to each other than that count as equal, by our tolerance."""
_EXACT: Final = 2**53
"""Whole numbers up to here are floats as well."""


def in_whole_numbers(problem: Problem) -> Problem:
    """Return the problem with the same plans in which all that is compared is whole; the problem itself if that cannot be done.

    Sums of decimals are made whole, all by the same factor, which changes nothing about what is larger than what.
    """
    if problem.domain.nature or calculates_with_whole_numbers(problem):
        return problem
    concerned = functions_in_use(replace(problem, metric=None))
    elsewhere = [bound.bound for schema in problem.domain.actions.values() for bound in schema.duration or ()]
    elsewhere += (change.value for change in action_assignments(problem.domain) if change.fluent[0] not in concerned)
    elsewhere += () if problem.metric is None else (problem.metric.expression,)
    watched = problem.has_preferences or problem.constraints or problem.domain.constraints
    if watched or any(fluent[0] in concerned for expression in elsewhere for fluent in expression_fluents(expression)):
        return problem
    for factor in _FACTORS:
        with suppress(_NotWhole):
            if calculates_with_whole_numbers(scaled := _Scale(factor, concerned).problem(problem)):
                return scaled
    return problem


class _NotWhole(Exception):
    """A number is not whole after all."""


@dataclass(frozen=True, slots=True)
class _Scale:
    """A factor for these functions, and for what they are compared with."""

    factor: int
    concerned: frozenset[str]

    def problem(self, problem: Problem) -> Problem:
        domain = problem.domain
        actions = {name: self.inside(schema) for name, schema in domain.actions.items()}
        timed = tuple(TimedChange(change.time, self.values(change.changes.items())) for change in problem.timed)
        domain = replace(domain, actions=actions, rules=self.inside(domain.rules))
        return replace(problem, domain=domain, init=self.values(problem.init.items()), timed=timed, goal=self.inside(problem.goal))

    def values(self, values: Iterable[tuple[Fluent, Value]]) -> dict[Fluent, Value]:
        return {fluent: self.value(value) if fluent[0] in self.concerned else value for fluent, value in values}

    def value(self, value: Value) -> Value:
        if not is_number(value):
            return value
        scaled = Decimal(repr(value)) * self.factor
        if scaled % 1 or abs(scaled) > _EXACT:
            raise _NotWhole
        return float(scaled)

    def inside(self, part: Any) -> Any:
        """Return a part of the problem with what is compared and assigned in it scaled."""
        match part:
            case Compare(operation, left, right):
                return Compare(operation, self.expression(left), self.expression(right))
            case Set(fluent, value, "scale-up" | "scale-down") if fluent[0] in self.concerned:
                return part
            case Set(fluent, value, operation) if fluent[0] in self.concerned:
                return Set(fluent, self.expression(value), operation)
            case tuple():
                return tuple(map(self.inside, part))
            case Holds() | Set() | str() | bool() | int() | float() | None:
                return part
            case _:
                return replace(part, **{inner.name: self.inside(getattr(part, inner.name)) for inner in fields(part)})

    def expression(self, expression: Expression) -> Expression:
        match expression:
            case Constant(value):
                return Constant(self.value(value))
            case Arithmetic("+" | "-" as operation, operands):
                return Arithmetic(operation, tuple(map(self.expression, operands)))
            case Arithmetic("*", (Constant() as times, operand)) | Arithmetic("*", (operand, Constant() as times)):
                return Arithmetic("*", (times, self.expression(operand)))
            case ValueOf(fluent) if fluent != DURATION:
                return expression
            case _:
                raise _NotWhole


# --- durations ------------------------------------------------------------------------------------


def with_durations(problem: Problem, seconds: Mapping[str, float]) -> Problem:
    """Return a problem without times in which actions last so many seconds, and what they take away is gone from their starts on.

    Numbers that only count are left out.
    """
    problem = replace(problem, metric=None)
    domain = domain_with_durations(problem.domain, tuple(seconds.items()), functions_in_use(problem))
    return replace(problem, domain=domain)


@once_per_domain
def domain_with_durations(domain: Domain, seconds: tuple[tuple[str, float], ...], functions: frozenset[str]) -> Domain:
    """Return the domain whose actions last so many seconds, with the numbers of these functions alone."""
    actions, counting = dict(domain.actions), domain.functions.keys() - functions
    for name, lasts in seconds:
        effects = [effect for effect in actions[name].end_effects if not (isinstance(effect, Set) and effect.fluent[0] in counting)]
        taken = tuple(effect for effect in effects if isinstance(effect, Set) and effect.value == Constant(False))
        left = tuple(effect for effect in effects if effect not in taken)
        duration = (DurationConstraint("=", Constant(lasts)),)
        actions[name] = replace(actions[name], duration=duration, start_effects=taken, end_effects=left)
    return replace(domain, actions=actions, requirements=tuple(dict.fromkeys((*domain.requirements, ":durative-actions"))))
