"""PDDL domains and problems: model to text, which reads back to an equal model.

A model becomes nested lists of words first and these become lines: a list that fits is written
on one line, any other with each of its parts on a line of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from planner_bridge.model import ActionSchema, Declaration, Domain, Preference, Problem
from planner_bridge.pddl.forms import (
    condition_form,
    effects_form,
    expression_form,
    joined,
    number_text,
    typed_lines,
    types_form,
    variables_form,
)
from planner_bridge.pddl.layout import Form, definition_text, flat, form_text, section_text
from pnm.conditions import TRUE, Condition, conjuncts
from pnm.effects import Effect, Effects, ForEach, Set, TimedChange, When
from pnm.expressions import Constant, Fluent, Value, Variable
from pnm.rules import Rule
from pnm.trajectory import Constraint

_NUMBER: Final = "number"


def write_domain(domain: Domain) -> str:
    """Write a domain as PDDL, with its own requirements."""
    sections: list[list[Form]] = []
    if domain.requirements:
        sections.append([":requirements", *domain.requirements])
    if domain.types:
        sections.append([":types", *typed_lines((name, above or ("object",)) for name, above in domain.types.items())])
    if domain.constants:
        sections.append([":constants", *typed_lines(domain.constants.items())])
    if domain.predicates:
        sections.append([":predicates", *map(_declaration, domain.predicates.values())])
    if domain.functions:
        sections.append([":functions", *_functions(tuple(domain.functions.values()))])
    sections.extend(_rule(rule) for rule in domain.rules)
    sections.extend(_constraints(domain.constraints, domain.preferences))
    actions = map(_action, domain.actions.values())  # other planners read tasks only in front of them
    return definition_text(["domain", domain.name], [*map(section_text, sections), *domain.hierarchy, *actions])


def write_problem(problem: Problem) -> str:
    """Write a problem as PDDL; its domain is only named."""
    sections: list[list[Form]] = [[":domain", problem.domain.name]]
    if problem.requirements:
        sections.append([":requirements", *problem.requirements])
    if problem.own_objects:
        sections.append([":objects", *typed_lines(problem.own_objects.items())])
    sections.append([":init", *_initial(problem)])
    sections.append([":goal", _with_preferences(problem.goal, problem.preferences)])
    sections.extend(_constraints(problem.constraints, problem.preferences))
    if problem.metric:
        sections.append([":metric", problem.metric.direction, expression_form(problem.metric.expression)])
    texts = [section_text(section) for section in sections]
    if problem.network:  # other planners read it only in front of :init
        texts.insert(next(position for position, section in enumerate(sections) if section[0] == ":init"), problem.network)
    return definition_text(["problem", problem.name], texts)


# --- declarations --------------------------------------------------------------------------


def _declaration(declared: Declaration) -> Form:
    return [declared.name, *variables_form(declared.parameters)]


def _functions(functions: tuple[Declaration, ...]) -> list[Form]:
    if not any(declared.values for declared in functions):
        return [_declaration(declared) for declared in functions]
    return [f"{flat(_declaration(declared))} - {flat(types_form(declared.values or (_NUMBER,)))}" for declared in functions]


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
    typed: list[Form] = [form for variable in rule.variables for form in (variable.name, "-", types_form(variable.types))]
    return [":derived", [rule.name, *typed], condition_form(rule.condition)]


def _with_preferences(condition: Condition, preferences: Iterable[Preference]) -> Form:
    """Write a goal or a precondition, with the preferences that stand in it."""
    soft = [_preference(one) for one in preferences if not isinstance(one.wanted, tuple)]
    return joined([*map(condition_form, conjuncts(condition)), *soft]) if soft else condition_form(condition)


def _constraints(constraints: tuple[Constraint, ...], preferences: tuple[Preference, ...]) -> Iterator[list[Form]]:
    soft = [_preference(one) for one in preferences if isinstance(one.wanted, tuple)]
    if constraints or soft:
        yield [":constraints", joined([*map(_constraint, constraints), *soft])]


def _preference(preference: Preference) -> Form:
    match preference.wanted:
        case tuple() as constraints:
            wanted = joined([*map(_constraint, constraints)])
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
            return ["forall", variables_form(variables[:count]), _under(variables[count:], form)]
    return ["forall", variables_form(variables), form] if variables else form


# --- actions -------------------------------------------------------------------------------


def _action(schema: ActionSchema) -> str:
    kind = ":action" if schema.duration is None else ":durative-action"
    parts = {":parameters": variables_form(schema.parameters), **_body(schema)}
    lines = "".join(f"\n    {key} {form_text(form, 4, len(key) + 1)}" for key, form in parts.items())
    return f"({kind} {schema.name}{lines})"


def _body(schema: ActionSchema) -> dict[str, Form]:
    if schema.duration is None:
        wanted = _with_preferences(schema.precondition, schema.preferences)
        precondition = {":precondition": wanted} if schema.precondition != TRUE or schema.preferences else {}
        return {**precondition, ":effect": effects_form(schema.end_effects)}
    bounds: list[Form] = [[bound.operation, "?duration", expression_form(bound.bound)] for bound in schema.duration]
    return {
        ":duration": joined(bounds) if bounds else [],
        ":condition": joined(_timed_conditions(schema)),
        ":effect": joined([*_timed_effects("start", schema.start_effects), *_timed_effects("end", schema.end_effects)]),
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
            return ["forall", variables_form(variables), joined(_timed_effects(moment, effects))]
        case When(early, (When(late, effects, early=False),), early=True):
            both: Form = ["and", ["at", "start", condition_form(early)], ["at", moment, condition_form(late)]]
            return ["when", both, _timed_body(moment, effects)]
        case When(condition, effects, early):
            return ["when", ["at", "start" if early else moment, condition_form(condition)], _timed_body(moment, effects)]
        case _:
            return ["at", moment, effects_form((effect,))]


def _timed_body(moment: str, effects: Effects) -> Form:
    if any(map(_is_early, effects)):
        return joined(_timed_effects(moment, effects))
    return ["at", moment, effects_form(effects)]


def _is_early(effect: Effect) -> bool:
    return not isinstance(effect, Set) and ((isinstance(effect, When) and effect.early) or any(map(_is_early, effect.effects)))
