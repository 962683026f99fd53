"""PDDL domains and problems: model to text, which reads back to an equal model.

A model becomes nested lists of words first and these become lines: a list that fits is written
on one line, any other with each of its parts on a line of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from decimal import Decimal
from itertools import groupby, takewhile
from operator import itemgetter
from typing import Final, TypeAlias, assert_never

from planner_bridge.model import UNDEFINED, ActionSchema, Declaration, Domain, Preference, Problem
from pnm.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.effects import Effect, Effects, ForEach, Set, TimedChange, When
from pnm.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, Value, ValueOf, Variable
from pnm.rules import Rule
from pnm.trajectory import Constraint

Form: TypeAlias = "str | list[Form]"
_WIDTH: Final = 100
_NUMBER: Final = "number"
_ONE_A_LINE: Final = (":types", ":constants", ":objects", ":predicates", ":functions", ":init")


def write_domain(domain: Domain) -> str:
    """Write a domain as PDDL, with its own requirements."""
    sections: list[list[Form]] = []
    if domain.requirements:
        sections.append([":requirements", *domain.requirements])
    if domain.types:
        sections.append([":types", *_run_lines((name, above or ("object",)) for name, above in domain.types.items())])
    if domain.constants:
        sections.append([":constants", *_run_lines(domain.constants.items())])
    if domain.predicates:
        sections.append([":predicates", *map(_declaration, domain.predicates.values())])
    if domain.functions:
        sections.append([":functions", *_functions(tuple(domain.functions.values()))])
    sections.extend(_rule(rule) for rule in domain.rules)
    sections.extend(_constraints(domain.constraints, domain.preferences))
    return _lines(["domain", domain.name], [*map(_section, sections), *map(_action, domain.actions.values()), *domain.hierarchy])


def write_problem(problem: Problem) -> str:
    """Write a problem as PDDL; its domain is only named."""
    sections: list[list[Form]] = [[":domain", problem.domain.name]]
    if problem.requirements:
        sections.append([":requirements", *problem.requirements])
    if problem.own_objects:
        sections.append([":objects", *_run_lines(problem.own_objects.items())])
    sections.append([":init", *_initial(problem)])
    sections.append([":goal", _with_preferences(problem.goal, problem.preferences)])
    sections.extend(_constraints(problem.constraints, problem.preferences))
    if problem.metric:
        sections.append([":metric", problem.metric.direction, expression_form(problem.metric.expression)])
    network = [problem.network] if problem.network else []
    return _lines(["problem", problem.name], [*map(_section, sections), *network])


# --- declarations --------------------------------------------------------------------------


def _runs(pairs: Iterable[tuple[str, tuple[str, ...]]]) -> list[list[Form]]:
    """Write neighbours of the same types together: ``a b - t``."""
    return [[*(name for name, _ in group), "-", _types(types)] for types, group in groupby(pairs, key=itemgetter(1))]


def _types(types: tuple[str, ...]) -> Form:
    return types[0] if len(types) == 1 else ["either", *types]


def _run_lines(pairs: Iterable[tuple[str, tuple[str, ...]]]) -> list[Form]:
    return [" ".join(map(_flat, run)) for run in _runs(pairs)]


def _variables(variables: tuple[Variable, ...]) -> list[Form]:
    forms = [form for run in _runs((variable.name, variable.types) for variable in variables) for form in run]
    return forms[:-2] if forms[-2:] == ["-", "object"] else forms


def _declaration(declared: Declaration) -> Form:
    return [declared.name, *_variables(declared.parameters)]


def _functions(functions: tuple[Declaration, ...]) -> list[Form]:
    if not any(declared.values for declared in functions):
        return [_declaration(declared) for declared in functions]
    return [f"{_flat(_declaration(declared))} - {_flat(_types(declared.values or (_NUMBER,)))}" for declared in functions]


def _initial(problem: Problem) -> Iterator[Form]:
    for fluent, value in problem.init.items():
        if value is not False:
            yield _change(fluent, value)
    for change in problem.timed:
        yield from _timed_change(change)


def _timed_change(timed: TimedChange) -> Iterator[Form]:
    for fluent, value in timed.changes.items():
        yield ["at", number_text(timed.time), _change(fluent, value)]


def _change(fluent: Fluent, value: Value) -> Form:
    match value:
        case True:
            return list(fluent)
        case False:
            return ["not", list(fluent)]
        case _:
            return ["=", list(fluent), expression_form(Constant(value))]


# --- rules, preferences, constraints -------------------------------------------------------


def _rule(rule: Rule) -> list[Form]:
    # each variable with its type: one without has the type of the declaration, not ``object``
    typed: list[Form] = [form for variable in rule.variables for form in (variable.name, "-", _types(variable.types))]
    return [":derived", [rule.name, *typed], condition_form(rule.condition)]


def _with_preferences(condition: Condition, preferences: Iterable[Preference]) -> Form:
    """Write a goal or a precondition, with the preferences that stand in it."""
    soft = [_preference(one) for one in preferences if not isinstance(one.wanted, tuple)]
    return _and([*map(condition_form, conjuncts(condition)), *soft]) if soft else condition_form(condition)


def _constraints(constraints: tuple[Constraint, ...], preferences: tuple[Preference, ...]) -> Iterator[list[Form]]:
    soft = [_preference(one) for one in preferences if isinstance(one.wanted, tuple)]
    if constraints or soft:
        yield [":constraints", _and([*map(_constraint, constraints), *soft])]


def _preference(preference: Preference) -> Form:
    match preference.wanted:
        case tuple() as constraints:
            wanted = _and([*map(_constraint, constraints)])
        case condition:
            wanted = condition_form(condition)
    if preference.moment:
        wanted = _at(preference.moment, wanted)
    return _under(preference.variables, ["preference", *([preference.name] if preference.name else []), wanted])


def _constraint(constraint: Constraint) -> Form:
    times: list[Form] = [number_text(time) for time in constraint.times]
    return _under(constraint.variables, [*constraint.operator.split(), *times, *map(condition_form, constraint.conditions)])


def _under(variables: tuple[Variable, ...], form: Form) -> Form:
    """Write a quantifier around a form, and another one inside it where a variable hides one of the same name."""
    for count, variable in enumerate(variables):
        if variable.name.lower() in {before.name.lower() for before in variables[:count]}:
            return ["forall", _variables(variables[:count]), _under(variables[count:], form)]
    return ["forall", _variables(variables), form] if variables else form


# --- actions -------------------------------------------------------------------------------


def _action(schema: ActionSchema) -> str:
    kind = ":action" if schema.duration is None else ":durative-action"
    parts = {":parameters": _variables(schema.parameters), **_body(schema)}
    lines = "".join(f"\n    {key} {_text(form, 4, len(key) + 1)}" for key, form in parts.items())
    return f"({kind} {schema.name}{lines})"


def _body(schema: ActionSchema) -> dict[str, Form]:
    if schema.duration is None:
        wanted = _with_preferences(schema.precondition, schema.preferences)
        precondition = {":precondition": wanted} if schema.precondition != TRUE or schema.preferences else {}
        return {**precondition, ":effect": effects_form(schema.end_effects)}
    bounds: list[Form] = [[bound.operation, "?duration", expression_form(bound.bound)] for bound in schema.duration]
    return {
        ":duration": _and(bounds) if bounds else [],
        ":condition": _and(_timed_conditions(schema)),
        ":effect": _and([*_timed_effects("start", schema.start_effects), *_timed_effects("end", schema.end_effects)]),
    }


def _timed_conditions(schema: ActionSchema) -> list[Form]:
    every = (("at start", schema.precondition), ("over all", schema.invariant), ("at end", schema.end_condition))
    hard = [_at(moment, condition_form(part)) for moment, condition in every for part in conjuncts(condition)]
    return [*hard, *map(_preference, schema.preferences)]


def _at(moment: str, form: Form) -> Form:
    return [*moment.split(), form]


def _timed_effects(moment: str, effects: Effects) -> list[Form]:
    return [_timed_effect(moment, effect) for effect in effects]


def _timed_effect(moment: str, effect: Effect) -> Form:
    # The moment goes inside `forall` and `when`: other planners read no other order.
    match effect:
        case ForEach(variables, effects) if effects:
            return ["forall", _variables(variables), _and(_timed_effects(moment, effects))]
        case When(early, (When(late, effects, early=False),), early=True):
            both: Form = ["and", ["at", "start", condition_form(early)], ["at", moment, condition_form(late)]]
            return ["when", both, _timed_body(moment, effects)]
        case When(condition, effects, early):
            return ["when", ["at", "start" if early else moment, condition_form(condition)], _timed_body(moment, effects)]
        case _:
            return ["at", moment, effects_form((effect,))]


def _timed_body(moment: str, effects: Effects) -> Form:
    if any(map(_is_early, effects)):
        return _and(_timed_effects(moment, effects))
    return ["at", moment, effects_form(effects)]


def _is_early(effect: Effect) -> bool:
    return not isinstance(effect, Set) and ((isinstance(effect, When) and effect.early) or any(map(_is_early, effect.effects)))


# --- conditions, expressions, effects ------------------------------------------------------


def _and(forms: list[Form]) -> Form:
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
            return ["forall", _variables(variables), condition_form(body)]
        case Exists(variables, body):
            return ["exists", _variables(variables), condition_form(body)]
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
        case ValueOf(fluent) if fluent == UNDEFINED:
            return UNDEFINED[0]
        case ValueOf(fluent):
            return list(fluent)
        case Arithmetic(operation, operands):
            return [operation, *map(expression_form, operands)]
        case _:
            assert_never(expression)


def effects_form(effects: Effects) -> Form:
    """Return effects as nested lists of words: one effect, or an ``and`` of several."""
    return _and([_effect(effect) for effect in effects])


def _effect(effect: Effect) -> Form:
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
            return ["forall", _variables(variables), effects_form(effects)]
        case _:
            assert_never(effect)


def number_text(value: float) -> str:
    """Write a number exactly and without an exponent.

    >>> number_text(1e-7), number_text(3.0), number_text(0.1)
    ('0.0000001', '3', '0.1')
    """
    text = f"{Decimal(repr(value)):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


# --- layout --------------------------------------------------------------------------------


def _lines(head: Form, sections: Iterable[str]) -> str:
    return "\n  ".join([f"(define {_flat(head)}", *sections]) + ")\n"


def _section(form: list[Form]) -> str:
    return _broken(form, 2, 1) if form[0] in _ONE_A_LINE else _text(form, 2)


def _text(form: Form, indent: int, before: int = 0) -> str:
    """Write a form that begins in this column, or so many characters behind it."""
    flat = _flat(form)
    if isinstance(form, str) or indent + before + len(flat) <= _WIDTH:
        return flat
    return _broken(form, indent, sum(1 for _ in takewhile(lambda part: isinstance(part, str), form)))


def _broken(form: list[Form], indent: int, words: int) -> str:
    """Write the first words on this line and each other part on a line of its own."""
    first = " ".join(map(_flat, form[:words]))
    return "(" + f"\n{' ' * (indent + 2)}".join([first, *(_text(part, indent + 2) for part in form[words:])]) + ")"


def _flat(form: Form) -> str:
    return form if isinstance(form, str) else f"({' '.join(map(_flat, form))})"
