"""Conditions, effects, expressions and typed lists of the model as nested lists of words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import Final, assert_never

from planner_bridge.pddl.comments.table import NO_NOTE, Note, Notes
from planner_bridge.pddl.syntax.pretty_print import Form, flat
from planner_bridge.pddl.syntax.words import number_text
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.effects import Effect, Effects, ForEach, Set, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, ValueOf, Variable
from pnm.errors import InputError

_LONG: Final = 72
"""Characters of names in a line, at most."""


def types_form(types: tuple[str, ...]) -> Form:
    """Return a type, or ``either`` of several."""
    return types[0] if len(types) == 1 else ["either", *types]


def typed_lines(pairs: Iterable[tuple[str, tuple[str, ...]]], notes: Notes) -> list[tuple[str, Note]]:
    """Return names with their types, as text: a line for neighbours of the same types, and the comments on it."""
    return [
        (f"{' '.join(line)} - {flat(types_form(types))}", note)
        for types, group in groupby(pairs, key=itemgetter(1))
        for line, note in _lines_with_notes([name for name, _ in group], notes)
    ]


def _lines_with_notes(names: Sequence[str], notes: Notes) -> Iterator[tuple[list[str], Note]]:
    """Split names into lines that are not too long, so that every comment has one beside or above which it can stand."""
    line: list[str] = []
    line_note = NO_NOTE
    for name in names:
        note = notes.at(name.lower()).take()
        if line and (note.before or len(" ".join(line)) + len(name) >= _LONG):
            yield line, line_note
            line, line_note = [], NO_NOTE
        line.append(name)
        line_note = line_note.joined(note)
        if note.beside or note.below:
            yield line, line_note
            line, line_note = [], NO_NOTE
    if line:
        yield line, line_note


def variables_form(variables: tuple[Variable, ...]) -> list[Form]:
    """Return typed variables, neighbours of the same types together: ``?a ?b - t``; the type of the last ones is left out if ``object``."""
    forms: list[Form] = []
    for types, group in groupby(variables, key=attrgetter("types")):
        forms += (*(variable.name for variable in group), "-", types_form(types))
    return forms[:-2] if forms[-2:] == ["-", "object"] else forms


def joined(forms: list[Form]) -> Form:
    """Return the one form, or an ``and`` of several."""
    return forms[0] if len(forms) == 1 else ["and", *forms]


def condition_form(condition: Condition) -> Form:
    """Return a condition as nested lists of words."""
    match condition:
        case Holds(fluent):
            return list(fluent)
        case Compare(operation, left, right):
            return [operation, expression_form(left), expression_form(right)]
        case Not(operand):
            return ["not", condition_form(operand)]
        case All(operands):
            return ["and", *map(condition_form, operands)]
        case Any(operands):
            return ["or", *map(condition_form, operands)]
        case Implies(left, right):
            return ["imply", condition_form(left), condition_form(right)]
        case ForAll(variables, body):
            return ["forall", variables_form(variables), condition_form(body)]
        case Exists(variables, body):
            return ["exists", variables_form(variables), condition_form(body)]
        case Computed():
            raise InputError(f"PDDL cannot say {condition}: it knows facts and functions, not variables")
        case _:
            assert_never(condition)


def expression_form(expression: Expression) -> Form:
    """Return an expression as nested lists of words."""
    match expression:
        case Constant(float() | int() as value):
            return number_text(value)
        case Constant(value):
            return str(value)
        case ValueOf(fluent) if fluent == DURATION:
            return "?duration"
        case ValueOf(fluent):
            return list(fluent)
        case Arithmetic(operation, operands):
            return [operation, *map(expression_form, operands)]
        case _:
            assert_never(expression)


def effects_form(effects: Effects) -> Form:
    """Return effects as nested lists of words: one effect, or an ``and`` of several."""
    return joined([_effect_form(effect) for effect in effects])


def _effect_form(effect: Effect) -> Form:
    match effect:
        case Set(fluent, Constant(True)):
            return list(fluent)
        case Set(fluent, Constant(False)):
            return ["not", list(fluent)]
        case Set(fluent, value, operation):
            return [operation, list(fluent), expression_form(value)]
        case When(condition, effects):
            return ["when", condition_form(condition), effects_form(effects)]
        case ForEach(variables, effects):
            return ["forall", variables_form(variables), effects_form(effects)]
        case _:
            assert_never(effect)
