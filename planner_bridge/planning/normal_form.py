"""Effects and numbers in the plain form in which other planners take them: the same plans, fewer constructs.

Kairos needs none of this. Other planners differ in what they do with nested quantifiers, with a
fact that is deleted and added at once, with scaling, and with counters that nobody reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from typing import Final

from planner_bridge.model.problem import Metric, Problem
from pnm.core.logic.conditions import TRUE, All, Compare, Condition, Exists, Not, conjuncts, every_part, ground, names
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Effects, ForEach, Set, When, ground_effects
from pnm.core.logic.expressions import Arithmetic, Constant, Expression, Fluent, ValueOf, Variable, bind, expression_fluents

_TRUE: Final = Constant(True)
_FALSE: Final = Constant(False)


@dataclass(frozen=True, slots=True)
class Assignment:
    """One fluent gets a value, for every choice of objects for the variables, where the condition holds."""

    fluent: Fluent
    value: Expression
    operation: str = "assign"
    """``assign``, ``increase`` or ``decrease``."""
    condition: Condition = TRUE
    variables: tuple[Variable, ...] = ()
    early: bool = False
    """Of an effect at the end of an action: its condition is decided at the start."""

    @property
    def is_plain(self) -> bool:
        """Whether it always happens, once."""
        return self.condition == TRUE and not self.variables


def assignments(effects: Effects, parameters: Iterable[Variable] = ()) -> tuple[Assignment, ...]:
    """Return what the effects of one moment of an action do, without nesting, deletes that an add undoes and scaling.

    Two facts that differ in nothing but parameters are taken for different ones: whether they
    are is known only when the action is ground.
    """
    taken = {variable.name for variable in parameters}
    flat = list(_flat(effects, (), TRUE, False, taken))
    added = [one for one in flat if one.value == _TRUE]
    return tuple(left for one in flat if (left := _unless_added(one, added) if one.value == _FALSE else one) is not None)


def _flat(effects: Effects, variables: tuple[Variable, ...], condition: Condition, early: bool, taken: set[str]) -> Iterator[Assignment]:
    for effect in effects:
        match effect:
            case Set(fluent, value, "scale-up" | "scale-down" as scaling):
                product = Arithmetic("*" if scaling == "scale-up" else "/", (ValueOf(fluent), value))
                yield Assignment(fluent, product, "assign", condition, variables, early)
            case Set(fluent, value, operation):
                yield Assignment(fluent, value, operation, condition, variables, early)
            case When(inner, then):
                yield from _flat(then, variables, _both(condition, inner), early or effect.early, taken)
            case ForEach(chosen, every):
                own = {variable.name: _unused(variable.name, taken) for variable in chosen}
                taken |= {*own.values()}
                renamed = tuple(replace(variable, name=own[variable.name]) for variable in chosen)
                yield from _flat(ground_effects(every, own), (*variables, *renamed), condition, early, taken)


def _unused(name: str, taken: set[str]) -> str:
    return name if name not in taken else next(other for number in count(1) if (other := f"{name}-{number}") not in taken)


def _both(one: Condition, other: Condition) -> Condition:
    parts = tuple(part for part in (*conjuncts(one), *conjuncts(other)) if part != TRUE)
    return parts[0] if len(parts) == 1 else All(parts)


def _unless_added(deleted: Assignment, added: Iterable[Assignment]) -> Assignment | None:
    """Return the delete where no add of the same moment undoes it; None if one always does (PDDL 2.1, section 8)."""
    for add in added:
        if add.fluent == deleted.fluent and add.condition in (TRUE, deleted.condition):
            return None
        if add.fluent[0] != deleted.fluent[0]:
            continue
        apart = {variable.name: f"{variable.name}-added" for variable in add.variables}
        pairs = [pair for pair in zip(deleted.fluent, bind(add.fluent, apart), strict=True) if pair[0] != pair[1]]
        if pairs and not deleted.variables and not add.variables:
            continue
        if any(not one.startswith("?") and not other.startswith("?") for one, other in pairs):
            continue
        equal = (Compare("=", Constant(one), Constant(other)) for one, other in pairs)
        undone = _both(ground(add.condition, apart), All(tuple(equal)))
        if add.variables:
            undone = Exists(tuple(replace(variable, name=apart[variable.name]) for variable in add.variables), undone)
        deleted = replace(deleted, condition=_both(deleted.condition, Not(undone)))
    return deleted


def moments(schema: ActionSchema) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
    """Return what the action does at its start and at its end."""
    return assignments(schema.start_effects, schema.parameters), assignments(schema.end_effects, schema.parameters)


def doings(problem: Problem) -> Iterator[Assignment]:
    """Yield what the actions do at any of their moments."""
    return (one for schema in problem.domain.actions.values() for moment in moments(schema) for one in moment)


# --- functions and numbers -----------------------------------------------------------------


def functions_in_use(problem: Problem) -> frozenset[str]:
    """Return the functions on which the validity or the metric of a plan depends; others only count."""
    done = [*doings(problem)]
    found = {name for condition in conditions_of(problem) for name in names(condition)}
    found |= {fluent[0] for bound in _bounds(problem) for fluent in expression_fluents(bound)}
    if problem.metric:
        found |= {fluent[0] for fluent in expression_fluents(problem.metric.expression)}
    before = -1
    while len(found) > before:
        before = len(found)
        found |= {fluent[0] for one in done if one.fluent[0] in found for fluent in expression_fluents(one.value)}
    return frozenset(found) & frozenset(problem.domain.functions)


def is_whole(problem: Problem, functions: frozenset[str]) -> bool:
    """Tell whether all numbers are and stay whole that have to do with these functions."""
    stated = [*problem.init.items(), *(pair for change in problem.timed for pair in change.changes.items())]
    expressions = [
        *(Constant(value) for fluent, value in stated if fluent[0] in functions),
        *(Constant(change.time) for change in problem.timed),
        *(one.value for one in doings(problem) if one.fluent[0] in functions),
        *(side for condition in conditions_of(problem) for side in _sides(condition)),
        *_bounds(problem),
        *((problem.metric.expression,) if problem.metric else ()),
    ]
    return all(map(_is_whole, expressions))


def conditions_of(problem: Problem) -> Iterator[Condition]:
    """Yield every condition that decides about a plan."""
    yield problem.goal
    for schema in problem.domain.actions.values():
        yield from (schema.precondition, schema.invariant, schema.end_condition)
    yield from (one.condition for one in doings(problem))
    for constraint in (*problem.domain.constraints, *problem.constraints):
        yield from constraint.conditions


def _bounds(problem: Problem) -> Iterator[Expression]:
    return (constraint.bound for schema in problem.domain.actions.values() for constraint in schema.duration or ())


def _sides(condition: Condition) -> Iterator[Expression]:
    """Yield what the condition compares."""
    return (side for part in every_part(condition) if isinstance(part, Compare) for side in (part.left, part.right))


def _is_whole(expression: Expression) -> bool:
    match expression:
        case Constant(float() | int() as number):
            return number == int(number)
        case Arithmetic(operation, operands):
            return operation != "/" and all(map(_is_whole, operands))
        case _:
            return True


def cost_function(problem: Problem) -> str | None:
    """Return the function that the metric minimises if all that happens to it is that actions add to it."""
    match problem.metric:
        case Metric("minimize", ValueOf((name,))) if name in problem.domain.functions:
            if name not in functions_in_use(replace(problem, metric=None)) and all(
                _is_cost(one) for one in doings(problem) if one.fluent[0] == name
            ):
                return name
    return None


def _is_cost(one: Assignment) -> bool:
    return one.is_plain and one.operation == "increase" and one.fluent not in expression_fluents(one.value)
