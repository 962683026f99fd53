"""Conditions, expressions, effects, constraints and preferences as the language writes them (`pnm.language` reads them)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Final, assert_never

from planner_bridge.pddl.comments import NO_NOTES, Notes
from planner_bridge.pddl.expressions import number_text
from planner_bridge.pddl.forms import condition_form, effects_form, flat, form_anchor, types_form, variables_form
from planner_bridge.pddl.writer import constraint_form, preference_form
from planner_bridge.yaml.emitter import Bare, Entry, Mapping, Sequence, Value, items, single
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import DurationConstraint, Preference
from pnm.core.logic.effects import Effect, Effects, ForEach, Set, When
from pnm.core.logic.expressions import Arithmetic, Constant, Expression, ValueOf, Variable, fluent_text
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError

_LONG: Final = 80


def conditions(condition: Condition, notes: Notes) -> Value:
    """Write what must hold: one condition, or a list of them."""
    entries = [_noted(part, notes) for part in conjuncts(condition)]
    return entries[0].value if len(entries) == 1 and not entries[0].note else Sequence(tuple(entries))


def _noted(condition: Condition, notes: Notes) -> Entry:
    if isinstance(condition, All):  # which is looked through when comments are read
        return Entry(_condition(condition, notes))
    own = notes.at(form_anchor(condition_form(condition))) if notes else NO_NOTES
    return Entry(_condition(condition, own), note=own.take())


def _condition(condition: Condition, notes: Notes) -> Value:
    match condition:
        case Holds(fluent):
            return fluent_text(fluent)
        case Compare(operation, left, right):
            sides = items([expression(left), expression(right)], short=True)
            return single("Comparison", items([operation, sides], short=True), short=True)
        case Not(operand):
            entry = _noted(operand, notes)
            return Mapping((Entry(entry.value, "not", entry.note),))
        case All(operands):
            return single("and", Sequence(tuple([_noted(operand, notes) for operand in operands])))
        case Any(operands):
            return single("or", Sequence(tuple([_noted(operand, notes) for operand in operands])))
        case Implies(left, right):
            return single("imply", Sequence((_noted(left, notes), _noted(right, notes))))
        case ForAll(variables, body):
            return single("forall", _quantified(variables, "condition", conditions(body, notes)))
        case Exists(variables, body):
            return single("exists", _quantified(variables, "condition", conditions(body, notes)))
        case Computed():
            raise InputError(f"PDDL cannot say {condition}: it knows facts and functions, not variables")
        case _:
            assert_never(condition)


def _quantified(variables: tuple[Variable, ...], key: str, body: Value) -> Mapping:
    return Mapping((Entry(typed(variables), "variables"), Entry(body, key)))


def typed(variables: tuple[Variable, ...]) -> Value:
    """Write variables with their types: as one text, or as a list of texts if that would be long."""
    text = " ".join(map(flat, variables_form(variables)))
    if len(text) <= _LONG:
        return text
    runs = groupby(variables, key=lambda variable: variable.types)
    return items(f"{' '.join(variable.name for variable in run)} - {flat(types_form(types))}" for types, run in runs)


def expression(value: Expression) -> Value:
    """Write an expression."""
    match value:
        case Constant(float() | int() as number):
            return Bare(number_text(number))
        case Constant(name):
            return str(name)
        case ValueOf():
            return str(value)
        case Arithmetic(operation, operands):
            return single("Operation", items([operation, items(map(expression, operands), short=True)], short=True), short=True)
        case _:
            assert_never(value)


def effects(listed: Effects, notes: Notes) -> Sequence:
    """Write effects, each an item of a list."""
    entries: list[Entry] = []
    for effect in listed:
        own = notes.at(form_anchor(effects_form((effect,)))) if notes else NO_NOTES
        entries.append(Entry(_effect(effect, own), note=own.take()))
    return Sequence(tuple(entries))


def _effect(effect: Effect, notes: Notes) -> Value:
    match effect:
        case Set(fluent, Constant(True)):
            return fluent_text(fluent)
        case Set(fluent, Constant(False)):
            return single("not", fluent_text(fluent))
        case Set(fluent, value, operation):
            return single(operation.replace("-", "_"), items([fluent_text(fluent), expression(value)], short=True), short=True)
        case When(condition, inner, early):
            tested = Entry(conditions(condition, notes), "at_start" if early else "condition")
            return single("when", Mapping((tested, Entry(effects(inner, notes), "effects"))))
        case ForEach(variables, inner):
            return single("forall", _quantified(variables, "effects", effects(inner, notes)))
        case _:
            assert_never(effect)


def duration(bounds: tuple[DurationConstraint, ...]) -> Value:
    """Write how long an action takes: the one value it has, or a list of bounds."""
    match bounds:
        case (DurationConstraint("=", bound),):
            return expression(bound)
        case _:
            return items(single(bound.operation, expression(bound.bound), short=True) for bound in bounds)


def constraints(listed: Iterable[Constraint], notes: Notes) -> Sequence:
    """Write constraints on the course of states, each an item of a list."""
    entries: list[Entry] = []
    for constraint in listed:
        own = notes.at(form_anchor(constraint_form(constraint)))
        times: list[Entry] = [Entry(Bare(number_text(time))) for time in constraint.times]
        operands = [*times, *(_noted(condition, NO_NOTES) for condition in constraint.conditions)]
        value: Value = single(constraint.operator.replace(" ", "_"), operands[0].value if len(operands) == 1 else Sequence(tuple(operands)))
        for variables in reversed(nested(constraint.variables)):
            value = single("forall", _quantified(variables, "constraint", value))
        entries.append(Entry(value, note=own.take()))
    return Sequence(tuple(entries))


def preferences(listed: Iterable[Preference], states: Notes, courses: Notes) -> Sequence:
    """Write preferences, each an item of a list; the notes are those of the sections where PDDL has them."""
    entries: list[Entry] = []
    for preference in listed:
        wanted, quantifiers = preference.wanted, nested(preference.variables)
        own = (courses if isinstance(wanted, tuple) else states).at(form_anchor(preference_form(preference)))
        keys: list[Entry] = [Entry(preference.name, "name")] if preference.name else []
        if quantifiers:
            keys.append(Entry(typed(quantifiers[0]) if len(quantifiers) == 1 else items(map(typed, quantifiers)), "variables"))
        if preference.moment:
            keys.append(Entry(preference.moment.replace(" ", "_"), "moment"))
        if isinstance(wanted, tuple):
            keys.append(Entry(constraints(wanted, NO_NOTES), "constraints"))
        else:
            keys.append(Entry(conditions(wanted, NO_NOTES), "condition"))
        entries.append(Entry(Mapping(tuple(keys)), note=own.take()))
    return Sequence(tuple(entries))


def nested(variables: tuple[Variable, ...]) -> list[tuple[Variable, ...]]:
    """Split the variables of quantifiers where one hides another of the same name."""
    groups: list[list[Variable]] = []
    for variable in variables:
        if not groups or variable.name.lower() in {other.name.lower() for other in groups[-1]}:
            groups.append([])
        groups[-1].append(variable)
    return [tuple(group) for group in groups]
