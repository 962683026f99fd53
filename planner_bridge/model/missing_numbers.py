"""Numbers that actions read and that have no value in the initial state: such an action cannot be applied, which no planner says.

Only functions with at most one parameter are looked at: of others, such as distances, those that are left out mostly say something.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from pnm.core.logic.conditions import Compare, every_part
from pnm.core.logic.domain import ActionSchema, ProblemModel
from pnm.core.logic.effects import Set, every_effect
from pnm.core.logic.expressions import Expression, Fluent, expression_fluents


def missing_numbers(problem: ProblemModel) -> tuple[Fluent, ...]:
    """Return the numbers without a value that actions of the domain read, if nothing assigns one later."""
    actions = problem.domain.actions.values()
    effects = [effect for action in actions for effect in every_effect((*action.start_effects, *action.end_effects))]
    assigned = {effect.fluent[0] for effect in effects if isinstance(effect, Set) and effect.operation == "assign"}
    assigned |= {fluent[0] for change in problem.timed for fluent in change.changes}
    numbers = {name for name, declared in problem.domain.functions.items() if not declared.values} - assigned
    read = dict.fromkeys(fluent for action in actions for fluent in numbers_read(problem, action) if fluent[0] in numbers)
    return tuple(fluent for fluent in read if fluent not in problem.init)


def numbers_read(problem: ProblemModel, action: ActionSchema) -> Iterator[Fluent]:
    """Yield what the action reads with no parameter, or one, for all objects of its type; untyped ones may stand for any object."""
    types = {variable.name: variable.types for variable in action.parameters if variable.types != ("object",)}
    for fluent in chain.from_iterable(map(expression_fluents, expressions_in(action))):
        match fluent:
            case (_,):
                yield fluent
            case (name, variable) if variable in types:
                yield from ((name, each) for kind in types[variable] for each in problem.objects_by_type.get(kind, ()))
            case _:
                pass


def expressions_in(action: ActionSchema) -> Iterator[Expression]:
    """Yield the expressions that the action computes: in its conditions, its duration and its effects."""
    for part in chain.from_iterable(map(every_part, (action.precondition, action.invariant, action.end_condition))):
        if isinstance(part, Compare):
            yield from (part.left, part.right)
    yield from (constraint.bound for constraint in action.duration or ())
    yield from (effect.value for effect in every_effect((*action.start_effects, *action.end_effects)) if isinstance(effect, Set))
