"""From a step that calls an action to the ground action: values that the step gives are substituted for the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from pnm.core.logic.computed_values import Data, KnowledgeOperation, Layer, Literal, Operation, Query, Update, filled, parameters_in, parts
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import Environment, Fluent, Value, ValueOf, is_number, text_of, value_of
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import EMPTY, GroundAction, Recovery, Then, ground_schema
from pnm.errors import InputError
from pnm.language.actions import OPERATION, LanguageAction
from pnm.language.grammar import ActionKind
from pnm.language.plan_tree import CallStep


def filled_data(data: Data, values: Mapping[str, Data]) -> Data:
    """Substitute computed values for parameters; in fluents only texts fit."""
    texts = {name: given.value for name, given in values.items() if isinstance(given, Literal) and isinstance(given.value, str)}
    return filled(data, values, texts)


def filled_operation(operation: KnowledgeOperation, values: Mapping[str, Data]) -> KnowledgeOperation:
    """Put computed values in the place of parameters."""
    if isinstance(operation, Update):
        name, value, meta = (filled_data(data, values) for data in (operation.name, operation.value, operation.meta))
        return Update(name, value, operation.layer, meta)
    filled = filled_data(operation, values)
    assert isinstance(filled, Query | Operation)
    return filled


_LONGEST: Final = 1e12
"""Seconds of a duration at most: a clock that shows so much still tells tenths of a millisecond apart."""
EFFECT_RETRIES: Final = 3
"""The default number of repetitions of a call with missing effects."""


@dataclass(frozen=True)
class Facts:
    """The facts for computing durations: those at the beginning."""

    facts: Mapping[Fluent, Value]

    def value(self, fluent: Fluent, /) -> Value | None:
        """Return the value of a fluent."""
        return self.facts.get(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return nothing: durations do not speak of all objects."""
        return ()


@dataclass(frozen=True)
class Substitution:
    """The values that one call gives the parameters of its action, with ``?``."""

    values: Mapping[str, Data]
    """Whatever the step gives."""
    env: Environment
    """The names of objects and the numbers among them: what arguments, conditions and effects can have."""

    @staticmethod
    def of(given: Mapping[str, Data]) -> Substitution:
        """Sort what is given, by parameter without ``?``."""
        plain = {f"?{name}": data.value for name, data in given.items() if isinstance(data, Literal)}
        return Substitution(
            {f"?{name}": data for name, data in given.items()},
            {name: value for name, value in plain.items() if is_number(value) or (isinstance(value, str) and value[:1] != "?")},
        )

    def argument(self, name: str) -> str:
        """Return the argument for a parameter without ``?``: the name or number it is given, or ``?name``."""
        return text_of(self.env.get(f"?{name}", f"?{name}"))


def ground_action(step: CallStep, outer: Mapping[str, Data], facts: Facts) -> tuple[GroundAction, Substitution]:
    """Return the action of the step, and its values for the parameters.

    In a chain of recovery, `outer` is what the call that recovers gives its parameters, with ``?``; `facts` are those at the beginning.
    Raises `InputError` if a fact is computed from a parameter that is not known in the plan.
    """
    given = {name: filled_data(value.data, outer) for name, value in step.given.items()}
    for name, data in given.items():
        if left := {parameter for part in parts(data) if isinstance(part, ValueOf) for parameter in parameters_in(part)}:
            message = f"{min(left)} is not known in the plan; a fact in a value needs the name of an object"
            raise InputError(message, step.given[name].position)
    own = Substitution.of(given)
    unbound = {name: data for name, data in outer.items() if name not in {variable.name for variable in step.action.schema.parameters}}
    operation = None if step.operation is None else filled_operation(step.operation, unbound)
    names = _parameters(step, operation)
    duration = step.duration
    fixed = next((constraint.bound for constraint in step.action.schema.duration or () if constraint.operation == "="), None)
    if duration is None and fixed is not None:  # by numbers that do not change or hold at the beginning
        seconds = value_of(fixed, facts, own.env)
        duration = float(seconds) if is_number(seconds) else None
    if duration is not None and not 0.0 <= duration <= _LONGEST:
        raise InputError(f"expected a duration from 0 to {_LONGEST:g} s, found {duration:g}", step.place.position)
    action = ground_schema(step.action.schema, tuple(map(own.argument, names)), own.env, duration)
    resources = tuple(dict.fromkeys((*step.action.resources, *step.resources)))
    called = replace(
        action, parameters=names, given=tuple(given.items()), operation=operation, resources=resources, returns=step.action.returns
    )
    return called, own


def outer_values(action: LanguageAction, own: Substitution) -> dict[str, Data]:
    """Return the values of parameters in the chains of a call: its own, or those that it will find."""
    names = (variable.name for variable in action.schema.parameters)
    queries: dict[str, Data] = {name: Query(Literal.of(name[1:]), Layer.ALL) for name in names}
    return {**queries, **own.values}


def _parameters(step: CallStep, operation: KnowledgeOperation | None) -> tuple[str, ...]:
    """Return the names of the parameters: of an action on knowledge, those that are used or given."""
    if step.action.is_open:
        return tuple(step.given)
    names = tuple(variable.name[1:] for variable in step.action.schema.parameters)
    if operation is None:
        return names
    datas = (operation.name, operation.value, operation.meta) if isinstance(operation, Update) else (operation,)
    used = step.action.mentioned.union(*map(parameters_in, datas))
    return tuple(name for name in names if name != OPERATION and (name in step.given or f"?{name}" in used))


def usual_recoveries(action: LanguageAction) -> tuple[Recovery, ...]:
    """Return the default recoveries of a call, for causes that neither the step nor the action handles.

    A call that was preempted counts as done, unless it would be believed to have effects that it may not have had; one whose
    effects are missing is repeated.
    """
    recoveries: list[Recovery] = []
    schema = action.schema
    has_effects = bool(schema.start_effects or schema.end_effects)
    if action.kind is not ActionKind.KB and not has_effects:
        recoveries.append(Recovery(frozenset({Cause.CANCELED}), Then.CONTINUE, EMPTY))
    if schema.expected != TRUE or schema.end_condition != TRUE or has_effects:
        recoveries.append(Recovery(frozenset({Cause.EFFECTS_MISSING}), Then.RETRY, EMPTY, EFFECT_RETRIES))
    return tuple(recoveries)
