"""Forms: nested lists of words, as PDDL is written, which are printed, named, and made from the model.

A list that fits is one line, any other has a line for each of its parts. Comments stand above their part, or behind the line it
begins in.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, takewhile
from operator import attrgetter, itemgetter
from typing import Final, TypeAlias, assert_never

from planner_bridge.pddl.comments import NO_NOTE, Line, Note, Notes, render_lines
from planner_bridge.pddl.expressions import NUMBER, TIME_SPECIFIERS, Atom, Node, number_text
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.effects import Effect, Effects, ForEach, Set, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, ValueOf, Variable
from pnm.errors import InputError


@dataclass(frozen=True, slots=True)
class Noted:
    """A form with comments."""

    form: Form
    note: Note


@dataclass(frozen=True, slots=True)
class Keyed:
    """A keyword and its form."""

    key: str
    form: Form


@dataclass(frozen=True, slots=True)
class Verbatim:
    """A text of several lines that is written as it stands."""

    text: str


Form: TypeAlias = "str | list[Form] | Noted | Keyed | Verbatim"
WIDTH: Final = 100
_ONE_A_LINE: Final = (":types", ":constants", ":objects", ":predicates", ":functions", ":init")


def noted(form: Form, note: Note) -> Form:
    """Return the form with the comments, if there are any."""
    return Noted(form, note) if note else form


def definition_text(head: Form, sections: Iterable[Form], note: Note = NO_NOTE) -> str:
    """Write ``(define HEAD SECTION ...)`` with each section on lines of its own."""
    first = Line(0, f"(define {flat(head)}", note.beside)
    lines = [first, *(line for section in sections for line in _lines(section, 2))]
    _close(lines, 0)
    return render_lines([*_comments(note.before, 0), *lines, *_comments(note.below, 0)])


def flat(form: Form) -> str:
    """Write a form on one line, without comments."""
    match form:
        case list():
            return f"({' '.join([part if isinstance(part, str) else flat(part) for part in form])})"
        case Noted(inner, _):
            return flat(inner)
        case Keyed(key, inner):
            return f"{key} {flat(inner)}"
        case Verbatim(text):
            return text
        case _:
            return form


def _comments(texts: Iterable[str], indent: int) -> Iterator[Line]:
    return (Line(indent, text) for text in texts)


def _lines(form: Form, indent: int, lead: str = "") -> list[Line]:
    """Write a form that begins in this column, behind a keyword if there is one."""
    match form:
        case Noted(inner, note):
            lines = _lines(inner, indent, lead)
            first = next(line for line in lines if line.text[:1] not in ("", ";"))
            first.beside = (*note.beside, *first.beside)
            return [*_comments(note.before, indent), *lines, *_comments(note.below, indent)]
        case Keyed(key, inner):
            return _lines(inner, indent, f"{key} ")
        case list():
            is_tall = len(form) > 1 if form and form[0] in _ONE_A_LINE else any(map(_is_tall, form))
            text = "" if is_tall else lead + flat(form)
            if not is_tall and indent + len(text) <= WIDTH:
                return [Line(indent, text)]
            words = 1 if form[0] in _ONE_A_LINE else sum(1 for _ in takewhile(lambda part: isinstance(part, str), form))
            opening = f"{lead}({' '.join(map(flat, form[:words]))}"
            lines = [Line(indent, opening), *(line for part in form[words:] for line in _lines(part, indent + 2))]
            _close(lines, indent)
            return lines
        case _:
            return [Line(indent, lead + flat(form))]


def _is_tall(form: Form) -> bool:
    """Whether the form needs lines of its own: it is an action's part, or has comments."""
    return not isinstance(form, str) and (not isinstance(form, list) or any(map(_is_tall, form)))


def _close(lines: list[Line], indent: int) -> None:
    if lines[-1].text[:1] in ("", ";"):
        lines.append(Line(indent, ")"))
    else:
        lines[-1].text += ")"


# --- anchors --------------------------------------------------------------------------------------
# Anchors: the names by which comments refer to conditions, effects, facts and rules of a PDDL definition.
#
# A form is named by its own words, in lower case and as the reader understands it: ``and`` and the time specifiers
# of a durative action are looked through, so that a condition has the same name wherever a writer puts it.


ACTION: Final = "action"
PARTS: Final = {
    ":precondition": "condition",
    ":condition": "condition",
    ":effect": "effect",
    ":parameters": "parameters",
    ":vars": "parameters",
    ":duration": "duration",
}
"""The keys of the parts of an action, the same for instantaneous and durative ones."""
COMPOUND: Final = frozenset(("or", "imply", "when", "forall", "exists", "not", "preference"))
"""Heads of forms that have forms with names inside them."""
_HIERARCHY: Final = re.compile(r"\(\s*([^\s()]*)\s*([^\s()]*)")


def form_anchor(form: Form) -> str:
    """Return the name of a condition, an effect or a fact.

    >>> form_anchor(["and", ["at", "start", ["p", "?X"]]]) == form_anchor(["p", "?x"]) == "(p ?x)"
    True
    """
    if not isinstance(form, list):
        word = flat(form)
        return number_text(float(word)) if NUMBER.fullmatch(word) else word.lower()
    head = _head(form)
    if head == "and":
        parts = [form_anchor(part) for part in _conjuncts(form)]
        return parts[0] if len(parts) == 1 else f"({' '.join(('and', *parts))})"
    if is_timed(form):
        return form_anchor(form[2])
    if head.startswith("?"):  # variables, of which only some have types, though they need not
        return f"({' '.join(part.lower() for part in form if isinstance(part, str) and part.startswith('?'))})"
    return f"({' '.join(map(form_anchor, form))})"


def fact_anchor(form: Form) -> str:
    """Return the name of a fact or an assignment in an initial state, which is the same whatever the value."""
    return form_anchor(form[:2]) if isinstance(form, list) and _head(form) in ("=", "assign") else form_anchor(form)


def rule_anchor(form: Form) -> str:
    """Return the name of a rule: that of its head, and its body."""
    match form:
        case [_, [head, *_], body]:
            return f"{form_anchor(head)} {form_anchor(body)}"
        case _:
            return form_anchor(form)


def hierarchy_anchor(text: str) -> tuple[str, str]:
    """Return the keyword and the name of a task, a method or a network, given its text.

    >>> hierarchy_anchor("(:task Clean :parameters ())")
    (':task', 'clean')
    """
    match = _HIERARCHY.match(text)
    return (match[1].lower(), match[2].lower()) if match else ("", "")


def form_of(node: Node) -> Form:
    """Return a part of a text as nested lists of words."""
    return node.text if isinstance(node, Atom) else [form_of(item) for item in node.items]


def is_timed(form: Form) -> bool:
    """Whether the form is ``(at start X)``, ``(over all X)`` or ``(at end X)``."""
    match form:
        case [str() as first, str() as second, list()]:
            return f"{first} {second}".lower() in TIME_SPECIFIERS
        case _:
            return False


def _conjuncts(form: list[Form]) -> Iterator[Form]:
    for part in form[1:]:
        inner = part[2] if isinstance(part, list) and is_timed(part) else part
        if isinstance(inner, list) and _head(inner) == "and":
            yield from _conjuncts(inner)
        else:
            yield inner


def _head(form: list[Form]) -> str:
    return form[0].lower() if form and isinstance(form[0], str) else ""


# --- forms of the model ---------------------------------------------------------------------------
# Conditions, effects, expressions and typed lists of the model as nested lists of words.


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
