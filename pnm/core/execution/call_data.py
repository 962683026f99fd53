"""Data of a call: its parameters, the fields of its goal, what its result stores, and operations on knowledge.

Functions of an action and of knowledge; only `carry_out` changes anything, and that is knowledge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TypeAlias, assert_never
from uuid import UUID

from pnm.core.execution.events import Performed, Store
from pnm.core.execution.questions import EvaluationContext, unknown_values
from pnm.core.logic.computed_values import (
    MISSING,
    KnowledgeOperation,
    Layer,
    Operation,
    Query,
    Question,
    Update,
    compute,
    question_of,
)
from pnm.core.logic.conditions import ground
from pnm.core.logic.effects import ground_effects
from pnm.core.logic.expressions import bind
from pnm.core.logic.operators import CHANGING, Uncomputable
from pnm.core.machine.bindings import Binding, goal_data, open_parameters, placeholders
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind
from pnm.core.message_fields import Unreadable, parse_field, value_in

GoalFields: TypeAlias = Callable[[GroundAction], tuple[str, ...] | None]
"""Returns which fields the goal of an action must have; None when nothing is known about them."""


def ready(action: GroundAction, context: EvaluationContext) -> GroundAction:
    """Return the action with what knowledge now has for the parameters that the plan leaves open."""
    env = context.environment()
    if not env:
        return action
    return replace(
        action,
        arguments=bind(action.arguments, env),
        precondition=ground(action.precondition, env),
        invariant=ground(action.invariant, env),
        end_condition=ground(action.end_condition, env),
        expected=ground(action.expected, env),
        start_effects=ground_effects(action.start_effects, env),
        end_effects=ground_effects(action.end_effects, env),
    )


def goal(planned: GroundAction, goal_fields: GoalFields, context: EvaluationContext) -> tuple[Mapping[str, object], tuple[str, ...]]:
    """Return the fields of the goal of an action as the plan has it, and the names of those for which there is no value."""
    action, binding = ready(planned, context), context.binding
    if action.operation is not None:
        return {}, unknown_values(action.operation, context)
    fields, missing = goal_data(action, binding, goal_fields(action), context)
    if not (unbound := open_parameters(action)):
        return fields, missing
    patterns = (binding.server or "", *binding.resources, *action.resources)
    in_names = {name for pattern in patterns for name in placeholders(pattern)}
    return fields, tuple(dict.fromkeys((*missing, *(name for name in unbound if name in in_names))))


def variables_of(outcome: Outcome, call: ActionCall, binding: Binding) -> dict[str, object]:
    """Return the fields of a result, under their own names or those of the call or its binding."""
    if not outcome.result:  # simulated servers may have none
        return {}
    store = {**binding.store, **dict(call.store)}
    values = {name: value for name, value in outcome.result.items() if name not in store}
    for name, variable in store.items():
        with suppress(Unreadable):
            values[variable] = value_in(outcome.result, parse_field(name))
    return values


def carry_out(identity: UUID, operation: KnowledgeOperation, context: EvaluationContext) -> Performed:
    """Carry out an operation on knowledge; what is stored outside is a command, everything else is over at once."""
    try:
        match operation:
            case Query():
                compute(operation, context)
                return _ended(identity)
            case Operation(name, operands):
                value = compute(operation, context)
                if name in CHANGING and isinstance(operands[0], Query):
                    return _store(identity, question_of(operands[0], context), value, context)
                return _ended(identity)
            case Update(name, data, layer, meta):
                value = compute(data, context)
                question = question_of(Query(name, layer, meta), context)
                return _store(identity, question, None if value is MISSING else value, context)
            case _:
                assert_never(operation)
    except Uncomputable as error:
        return Performed(reports=(Ended(identity, Outcome(OutcomeKind.ABORTED, message=str(error))),))


def _store(identity: UUID, question: Question, value: object, context: EvaluationContext) -> Performed:
    knowledge = context.knowledge
    if question.layer in (Layer.LOCAL, Layer.ALL):  # before anything outside is stored, so that the run itself can rely on it at once
        knowledge.local.store({question.name: value})
    if question.layer is Layer.LOCAL:
        return _ended(identity, changes_knowledge=True)
    if context.asks:
        outside = replace(question, layer=Layer.GLOBAL if question.layer is Layer.ALL else question.layer)
        return Performed((Store(identity, outside, value),), changes_knowledge=True)
    if question.layer is Layer.PERSON:
        raise Uncomputable(f"there is nobody to be told {value!r}")
    knowledge.world.store({question.name: value})
    return _ended(identity, changes_knowledge=True)


def _ended(identity: UUID, *, changes_knowledge: bool = False) -> Performed:
    return Performed((), (Ended(identity, Outcome(OutcomeKind.SUCCEEDED)),), changes_knowledge)
