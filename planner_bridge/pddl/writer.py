"""Writer of PDDL domains and problems: model to text, which reads back to an equal model.

A model becomes nested lists of words first, which are then pretty-printed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, takewhile
from operator import attrgetter, itemgetter
from typing import Final, TypeAlias, assert_never

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.comments import NO_COMMENTS, NO_NOTE, CommentTable, Line, Note, Notes, render_lines, write_with_notes
from planner_bridge.pddl.expressions import NUMBER, TIME_SPECIFIERS, Atom, Node, number_text
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration, Preference
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, When, is_early
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, Value, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.core.logic.trajectory import Constraint
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
ACTION: Final = "action"
NATURE: Final = {"processes": ":process", "events": ":event"}
"""The sections of what happens by itself, by the fields of a domain."""
PARTS: Final = {
    ":precondition": "condition",
    ":condition": "condition",
    ":effect": "effect",
    ":parameters": "parameters",
    ":vars": "parameters",
    ":duration": "duration",
}
"""The keys of the parts of an action, the same for instantaneous and durative ones."""
COMPOUND: Final = frozenset(("or", "imply", "when", "forall", "exists", "not", "preference", "oneof", "probabilistic"))
"""Heads of forms that have forms with names inside them."""
_HIERARCHY: Final = re.compile(r"\(\s*([^\s()]*)\s*([^\s()]*)")
_LONG: Final = 72
"""Characters of names in a line, at most."""


def write_domain(domain: Domain, table: CommentTable = NO_COMMENTS) -> str:
    """Write a domain as PDDL, with its own requirements and the comments of the table."""
    return write_with_notes(table, lambda notes: _domain(domain, notes.at("domain")))


def write_problem(problem: Problem, table: CommentTable = NO_COMMENTS) -> str:
    """Write a problem as PDDL, with the comments of the table; its domain is only named."""
    return write_with_notes(table, lambda notes: _problem(problem, notes.at("problem")))


def _domain(domain: Domain, notes: Notes) -> str:
    sections: list[Form] = []
    if domain.requirements:
        sections.append(_section([":requirements", *domain.requirements], notes))
    if domain.types:
        sections.append(_names(":types", ((name, above or ("object",)) for name, above in domain.types.items()), notes))
    if domain.constants:
        sections.append(_names(":constants", domain.constants.items(), notes))
    if domain.predicates:
        sections.append(_declarations(":predicates", map(_declaration, domain.predicates.values()), domain.predicates, notes))
    if domain.functions:
        functions = [_declaration(declared) for declared in domain.functions.values()]
        if any(declared.values for declared in domain.functions.values()):
            types = (flat(types_form(declared.values or ("number",))) for declared in domain.functions.values())
            functions = [f"{flat(form)} - {values}" for form, values in zip(functions, types, strict=True)]
        sections.append(_declarations(":functions", functions, domain.functions, notes))
    for rule in domain.rules:
        key, head, body = form = rule_form(rule)
        own = notes.at(":derived", rule_anchor(form))
        sections.append(noted([key, head, commented(body, own)], own.take()))
    sections.extend(_constraints(domain.constraints, domain.preferences, notes))
    sections.extend(_verbatim(text, notes) for text in domain.hierarchy)  # other planners read tasks only in front of actions
    of_head = {ACTION: domain.actions, **{head: getattr(domain, key) for key, head in NATURE.items()}}
    for kind, schema in ((kind, schema) for kind, schemas in of_head.items() for schema in schemas.values()):
        own = notes.at(kind, schema.name.lower())
        forms = _parts(schema, rates=kind == NATURE["processes"])
        parts = [noted(Keyed(key, commented(form, own.at(PARTS[key]))), own.at(PARTS[key]).take()) for key, form in forms]
        head = kind if kind != ACTION else ":action" if schema.duration is None else ":durative-action"
        sections.append(noted([head, schema.name, *parts], own.take()))
    return definition_text(["domain", domain.name], sections, notes.take())


def _problem(problem: Problem, notes: Notes) -> str:
    sections: list[Form] = [_section([":domain", problem.domain.name], notes)]
    if problem.requirements:
        sections.append(_section([":requirements", *problem.requirements], notes))
    if problem.own_objects:
        sections.append(_names(":objects", problem.own_objects.items(), notes))
    if problem.network:
        sections.append(_verbatim(problem.network, notes))  # other planners read it only in front of :init
    facts = notes.at(":init")
    init: list[Form] = [change_form(fluent, value) for fluent, value in problem.init.items() if value is not False]
    for timed in problem.timed:
        init += (["at", number_text(timed.time), change_form(fluent, value)] for fluent, value in timed.changes.items())
    if facts:
        init = [noted(form, facts.at(fact_anchor(form)).take()) for form in init]
    sections.append(noted([":init", *init], facts.take()))
    goal = notes.at(":goal")
    wanted = _with_preferences(problem.goal, problem.preferences)
    sections.append(noted([":goal", commented(wanted, goal)], goal.take()))
    sections.extend(_constraints(problem.constraints, problem.preferences, notes))
    if problem.metric:
        sections.append(_section([":metric", problem.metric.direction, expression_form(problem.metric.expression)], notes))
    return definition_text(["problem", problem.name], sections, notes.take())


def _section(form: list[Form], notes: Notes) -> Form:
    return noted(form, notes.at(str(form[0])).take())


def _names(head: str, pairs: Iterable[tuple[str, tuple[str, ...]]], notes: Notes) -> Form:
    inner = notes.at(head)
    lines = [noted(text, note) for text, note in typed_lines(pairs, inner)]
    return noted([head, *lines], inner.take())


def _declarations(head: str, forms: Iterable[Form], names: Iterable[str], notes: Notes) -> Form:
    inner = notes.at(head)
    lines = [noted(form, inner.at(name.lower()).take()) for form, name in zip(forms, names, strict=True)]
    return noted([head, *lines], inner.take())


def _verbatim(text: str, notes: Notes) -> Form:
    return noted(Verbatim(text), notes.at(*hierarchy_anchor(text)).take())


def commented(form: Form, notes: Notes) -> Form:
    """Return a form of conditions or effects with the comments on these and on the forms inside them."""
    if not notes or not isinstance(form, list) or not form or str(form[0]).startswith("?"):
        return form
    if form[0] == "and":
        return ["and", *(commented(part, notes) for part in form[1:])]
    if is_timed(form):
        return [*form[:2], commented(form[2], notes)]
    own = notes.at(form_anchor(form))
    inner: list[Form] = [form[0], *(commented(part, own) for part in form[1:])] if form[0] in COMPOUND else form
    return noted(inner, own.take())


# --- forms of the model ---------------------------------------------------------------------------


def _declaration(declared: Declaration) -> Form:
    return [declared.name, *variables_form(declared.parameters)]


def change_form(fluent: Fluent, value: Value) -> Form:
    """Return a fact that becomes true or false, or a function that gets a value."""
    match value:
        case True:
            return list(fluent)
        case False:
            return ["not", list(fluent)]
        case _:
            return ["=", list(fluent), expression_form(Constant(value))]


def rule_form(rule: DerivationRule) -> list[Form]:
    """Return a rule as its section."""
    # each variable with its type: one without has the type of the declaration, not ``object``
    typed: list[Form] = [form for variable in rule.variables for form in (variable.name, "-", types_form(variable.types))]
    return [":derived", [rule.name, *typed], condition_form(rule.condition)]


def _with_preferences(condition: Condition, preferences: Iterable[Preference]) -> Form:
    soft = [preference_form(preference) for preference in preferences if not isinstance(preference.wanted, tuple)]
    return joined([*map(condition_form, conjuncts(condition)), *soft]) if soft else condition_form(condition)


def _constraints(constraints: tuple[Constraint, ...], preferences: tuple[Preference, ...], notes: Notes) -> Iterator[Form]:
    own = notes.at(":constraints")
    soft = [preference_form(preference) for preference in preferences if isinstance(preference.wanted, tuple)]
    if constraints or soft:
        yield noted([":constraints", commented(joined([*map(constraint_form, constraints), *soft]), own)], own.take())


def preference_form(preference: Preference) -> Form:
    """Return a preference as nested lists of words."""
    constraints = preference.wanted
    wanted = joined([*map(constraint_form, constraints)]) if isinstance(constraints, tuple) else condition_form(constraints)
    if preference.moment:
        wanted = _at(preference.moment, wanted)
    return _under(preference.variables, ["preference", *([preference.name] if preference.name else []), wanted])


def constraint_form(constraint: Constraint) -> Form:
    """Return a constraint as nested lists of words."""
    times: list[Form] = [number_text(time) for time in constraint.times]
    return _under(constraint.variables, [*constraint.operator.split(), *times, *map(condition_form, constraint.conditions)])


def _under(variables: tuple[Variable, ...], form: Form) -> Form:
    for group in reversed(nested(variables)):
        form = ["forall", variables_form(group), form]
    return form


def nested(variables: tuple[Variable, ...]) -> list[tuple[Variable, ...]]:
    """Split the variables of quantifiers where one hides another of the same name."""
    groups: list[list[Variable]] = []
    for variable in variables:
        if not groups or variable.name.lower() in {other.name.lower() for other in groups[-1]}:
            groups.append([])
        groups[-1].append(variable)
    return [tuple(group) for group in groups]


def _parts(schema: ActionSchema, *, rates: bool) -> Iterator[tuple[str, Form]]:
    yield ":parameters", variables_form(schema.parameters)
    if schema.duration is None:
        if schema.precondition != TRUE or schema.preferences:
            yield ":precondition", _with_preferences(schema.precondition, schema.preferences)
        yield ":effect", effects_form(schema.end_effects, rates=rates)
    else:
        bounds: list[Form] = [[bound.operation, "?duration", expression_form(bound.bound)] for bound in schema.duration]
        yield ":duration", joined(bounds) if bounds else []
        conditions = (("at start", schema.precondition), ("over all", schema.invariant), ("at end", schema.end_condition))
        hard = [_at(moment, condition_form(part)) for moment, condition in conditions for part in conjuncts(condition)]
        yield ":condition", joined([*hard, *map(preference_form, schema.preferences)])
        yield ":effect", joined([*_timed_effects("start", schema.start_effects), *_timed_effects("end", schema.end_effects)])


def _at(moment: str, form: Form) -> Form:
    return [*moment.split(), form]


def _timed_effects(moment: str, effects: Effects) -> list[Form]:
    """Return effects with their time specifier inside `forall` and `when`: other planners read no other order."""
    forms: list[Form] = []
    for effect in effects:
        match effect:
            case ForEach(variables, inner) if inner:
                forms.append(["forall", variables_form(variables), joined(_timed_effects(moment, inner))])
            case When(early, (When(late, inner, early=False),), early=True):
                both: Form = ["and", ["at", "start", condition_form(early)], ["at", moment, condition_form(late)]]
                forms.append(["when", both, _timed_body(moment, inner)])
            case OneOf() if is_early(effect):
                forms.append(outcomes_form(effect, lambda effects: joined(_timed_effects(moment, effects))))
            case When(condition, inner, early):
                forms.append(["when", ["at", "start" if early else moment, condition_form(condition)], _timed_body(moment, inner)])
            case _:
                forms.append(["at", moment, effects_form((effect,))])
    return forms


def outcomes_form(effect: OneOf, written: Callable[[Effects], Form]) -> Form:
    """Return effects that may turn out in several ways as nested lists of words, given how effects are written."""
    form: list[Form] = [effect.word]
    for way in effect.alternatives:
        form += [written(way.effects)] if way.chance is None else [number_text(way.chance), written(way.effects)]
    return form


def _timed_body(moment: str, effects: Effects) -> Form:
    if any(map(is_early, effects)):
        return joined(_timed_effects(moment, effects))
    return ["at", moment, effects_form(effects)]


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
        case All(operands) | Any(operands):
            return ["and" if isinstance(condition, All) else "or", *map(condition_form, operands)]
        case Implies(left, right):
            return ["imply", condition_form(left), condition_form(right)]
        case ForAll(variables, body) | Exists(variables, body):
            return ["forall" if isinstance(condition, ForAll) else "exists", variables_form(variables), condition_form(body)]
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


def effects_form(effects: Effects, *, rates: bool = False) -> Form:
    """Return effects as nested lists of words: one effect, or an ``and`` of several; `rates` are those of a process."""
    forms: list[Form] = []
    for effect in effects:
        match effect:
            case Set(fluent, Constant(True)):
                forms.append(list(fluent))
            case Set(fluent, Constant(False)):
                forms.append(["not", list(fluent)])
            case Set(fluent, value, operation):
                number = expression_form(value)
                forms.append([operation, list(fluent), ["*", "#t", number] if rates else number])
            case When(condition, inner):
                forms.append(["when", condition_form(condition), effects_form(inner, rates=rates)])
            case OneOf():
                forms.append(outcomes_form(effect, effects_form))
            case ForEach(variables, inner):
                forms.append(["forall", variables_form(variables), effects_form(inner, rates=rates)])
            case _:
                assert_never(effect)
    return joined(forms)


# --- anchors --------------------------------------------------------------------------------------
# Anchors: the names by which comments refer to conditions, effects, facts and rules of a PDDL definition.
#
# A form is named by its own words, in lower case and as the reader understands it: ``and`` and the time specifiers
# of a durative action are looked through, so that a condition has the same name wherever a writer puts it.


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
    if head == "*" and len(factors := [part for part in form if part not in ("#t", "#T")]) < len(form):  # a rate, as YAML has it
        return form_anchor(factors[1] if len(factors) == 2 else factors)
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


# --- text -----------------------------------------------------------------------------------------
# A list that fits is one line, any other has a line for each of its parts. Comments stand above their part, or behind the line it
# begins in.


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
