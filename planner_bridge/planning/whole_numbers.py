"""Does a problem calculate with whole numbers alone? Then all planners and we come to the same results.

Planners calculate with floats or fractions, compare them exactly, and separate events by a time of their own; we tolerate a
millionth. Where numbers are not whole, a plan that a planner has ruled out may be valid here.
"""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from pnm.core.logic.conditions import Compare, every_part
from pnm.core.logic.effects import Set, When, every_effect
from pnm.core.logic.expressions import Arithmetic, Constant, Expression, Value


def calculates_with_whole_numbers(problem: Problem) -> bool:
    """Return whether every number that conditions, effects and times can come to is whole, or none is ever compared."""
    schemas, conditions, expressions = problem.domain.actions.values(), [problem.goal], list[Expression]()
    for schema in schemas:
        conditions += (schema.precondition, schema.invariant, schema.end_condition)
        expressions += (bound.bound for bound in schema.duration or ())
        for effect in every_effect((*schema.start_effects, *schema.end_effects)):
            match effect:
                case Set(_, value, operation):
                    expressions += (Arithmetic("/", ()),) if operation == "scale-down" else (value,)
                case When(condition):
                    conditions.append(condition)
                case _:
                    pass
    conditions += (rule.condition for rule in problem.domain.rules)
    conditions += (part for constraint in (*problem.domain.constraints, *problem.constraints) for part in constraint.conditions)
    compared = [part for condition in conditions for part in every_part(condition) if isinstance(part, Compare)]
    expressions += (side for part in compared for side in (part.left, part.right))
    numbers = [*problem.init.values(), *(value for change in problem.timed for value in (change.time, *change.changes.values()))]
    return not (compared or problem.is_timed) or (all(map(_is_whole, numbers)) and all(map(_stays_whole, expressions)))


def _stays_whole(expression: Expression) -> bool:
    match expression:
        case Constant(value):
            return _is_whole(value)
        case Arithmetic(operation, operands):
            return operation != "/" and all(map(_stays_whole, operands))
        case _:
            return True


def _is_whole(value: Value) -> bool:
    return not isinstance(value, float) or value.is_integer()
