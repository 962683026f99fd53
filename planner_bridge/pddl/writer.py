"""Writer of PDDL domains and problems: model to text, which reads back to an equal model.

A model becomes nested lists of words first, which are then pretty-printed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.comments import Notes, Table, write_with_notes
from planner_bridge.pddl.expressions import number_text
from planner_bridge.pddl.forms import (
    ACTION,
    COMPOUND,
    PARTS,
    Form,
    Keyed,
    Verbatim,
    condition_form,
    definition_text,
    effects_form,
    expression_form,
    fact_anchor,
    flat,
    form_anchor,
    hierarchy_anchor,
    is_timed,
    joined,
    noted,
    rule_anchor,
    typed_lines,
    types_form,
    variables_form,
)
from pnm.core.logic.conditions import TRUE, Condition, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration, Preference
from pnm.core.logic.effects import Effect, Effects, ForEach, When, is_early
from pnm.core.logic.expressions import Constant, Fluent, Value, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.core.logic.trajectory import Constraint

NO_COMMENTS: Final[Table] = {}


def write_domain(domain: Domain, table: Table = NO_COMMENTS) -> str:
    """Write a domain as PDDL, with its own requirements and the comments of the table."""
    return write_with_notes(table, lambda notes: _domain(domain, notes.at("domain")))


def write_problem(problem: Problem, table: Table = NO_COMMENTS) -> str:
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
    for schema in domain.actions.values():
        own = notes.at(ACTION, schema.name.lower())
        parts = [noted(Keyed(key, commented(form, own.at(PARTS[key]))), own.at(PARTS[key]).take()) for key, form in _parts(schema)]
        sections.append(noted([":action" if schema.duration is None else ":durative-action", schema.name, *parts], own.take()))
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
    """Write a goal or a precondition, with the preferences that stand in it."""
    soft = [preference_form(preference) for preference in preferences if not isinstance(preference.wanted, tuple)]
    return joined([*map(condition_form, conjuncts(condition)), *soft]) if soft else condition_form(condition)


def _constraints(constraints: tuple[Constraint, ...], preferences: tuple[Preference, ...], notes: Notes) -> Iterator[Form]:
    own = notes.at(":constraints")
    soft = [preference_form(preference) for preference in preferences if isinstance(preference.wanted, tuple)]
    if constraints or soft:
        yield noted([":constraints", commented(joined([*map(constraint_form, constraints), *soft]), own)], own.take())


def preference_form(preference: Preference) -> Form:
    """Return a preference as nested lists of words."""
    match preference.wanted:
        case tuple() as constraints:
            wanted = joined([*map(constraint_form, constraints)])
        case condition:
            wanted = condition_form(condition)
    if preference.moment:
        wanted = _at(preference.moment, wanted)
    return _under(preference.variables, ["preference", *([preference.name] if preference.name else []), wanted])


def constraint_form(constraint: Constraint) -> Form:
    """Return a constraint as nested lists of words."""
    times: list[Form] = [number_text(time) for time in constraint.times]
    return _under(constraint.variables, [*constraint.operator.split(), *times, *map(condition_form, constraint.conditions)])


def _under(variables: tuple[Variable, ...], form: Form) -> Form:
    """Write a quantifier around a form, and another one inside it where a variable hides one of the same name."""
    for count, variable in enumerate(variables):
        if variable.name.lower() in {before.name.lower() for before in variables[:count]}:
            return ["forall", variables_form(variables[:count]), _under(variables[count:], form)]
    return ["forall", variables_form(variables), form] if variables else form


def _parts(schema: ActionSchema) -> Iterator[tuple[str, Form]]:
    yield ":parameters", variables_form(schema.parameters)
    if schema.duration is None:
        if schema.precondition != TRUE or schema.preferences:
            yield ":precondition", _with_preferences(schema.precondition, schema.preferences)
        yield ":effect", effects_form(schema.end_effects)
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
    return [_timed_effect(moment, effect) for effect in effects]


def _timed_effect(moment: str, effect: Effect) -> Form:
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
    if any(map(is_early, effects)):
        return joined(_timed_effects(moment, effects))
    return ["at", moment, effects_form(effects)]
