"""Domains and problems as YAML in the language that people write; `planner_bridge.yaml.reader` is the way back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.comments import NO_NOTE, NO_NOTES, Notes, Table, write_with_notes
from planner_bridge.pddl.expressions import number_text
from planner_bridge.pddl.forms import ACTION, fact_anchor, flat, hierarchy_anchor, rule_anchor, typed_lines, types_form, variables_form
from planner_bridge.pddl.writer import NO_COMMENTS, change_form, rule_form
from planner_bridge.yaml.emitter import Bare, Entry, Mapping, Sequence, Value, depth, document, items, single
from planner_bridge.yaml.write_bindings import LANGUAGE_DEFAULT, binding_entries
from planner_bridge.yaml.write_formulas import conditions, constraints, duration, effects, expression, preferences, typed
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.rules import DerivationRule
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.errors import InputError
from pnm.files.yaml_nodes import MAX_DEPTH
from pnm.language.grammar import RESERVED

SCHEMA_MARK: Final = "# yaml-language-server:"
"""Begins a comment that is for editors."""
SCHEMA: Final = ""
"""The URL of the JSON Schema of these files for editors; empty as long as there is none."""


def write_domain(domain: Domain, table: Table = NO_COMMENTS, bindings: Bindings = NO_BINDINGS) -> str:
    """Write a domain as YAML, with the comments of the table, and with how its actions are bound to servers.

    Raises `InputError` if something is nested deeper than the language allows, or an action has the name of a word of the language.
    """
    return write_with_notes(table, lambda notes: written(domain_entries(domain, notes, bindings)))


def write_problem(problem: Problem, table: Table = NO_COMMENTS, plan: Iterable[Entry] = (), bindings: Bindings = NO_BINDINGS) -> str:
    """Write a domain and a problem as one YAML file, with the comments of the table, and a plan for the problem; else as `write_domain`."""

    def write(notes: Notes) -> str:
        own = notes.at("problem")
        entry = Entry(Mapping(tuple(_problem(problem, own))), "problem", own.take(), apart=True)
        return written([*domain_entries(problem.domain, notes, bindings), entry, *plan])

    return write_with_notes(table, write)


def written(entries: Iterable[Entry]) -> str:
    """Write a file."""
    whole = Mapping(tuple(entries))
    if depth(whole) >= MAX_DEPTH:
        raise InputError(f"this is nested too deeply for YAML files, which may have {MAX_DEPTH} lists and mappings in each other")
    return (f"{SCHEMA_MARK} $schema={SCHEMA}\n" if SCHEMA else "") + document(whole)


def domain_entries(domain: Domain, notes: Notes, bindings: Bindings) -> list[Entry]:
    """Return the keys of a file with a domain."""
    for name in domain.actions:
        if name in RESERVED:
            raise InputError(f"{name!r} is a word of the language; expected another name for the action in the domain")
    own = notes.at("domain")
    root = own.take().joined(notes.take())
    lines = [("types", ((name, above or ("object",)) for name, above in domain.types.items())), ("constants", domain.constants.items())]
    entries = [
        _requirements(domain.requirements, own),
        *(_names(key, pairs, own) for key, pairs in lines),
        _declarations("predicates", domain.predicates.values(), own),
        _declarations("functions", domain.functions.values(), own),
        Entry(Sequence(tuple(_rule(rule, own) for rule in domain.rules)), "derived"),
        _constraints(domain, own),
        Entry(preferences(domain.preferences, NO_NOTES, own.at(":constraints")), "preferences"),
        Entry(Sequence(tuple(Entry(text, note=own.at(*hierarchy_anchor(text)).take()) for text in domain.hierarchy)), "hierarchy"),
    ]
    actions: list[Entry] = []
    for schema in domain.actions.values():
        inner = own.at(ACTION, schema.name.lower())
        bound = binding_entries(bindings.actions.get(schema.name, LANGUAGE_DEFAULT), LANGUAGE_DEFAULT, type_key="ros_type")
        actions.append(Entry(Mapping((*_parts(schema, inner), *bound)), schema.name, inner.take(), apart=bool(actions)))
    entries.append(Entry(Mapping(tuple(actions)), "actions"))
    return [
        Entry(domain.name, "name", root),
        *(replace(entry, apart=entry.key != "requirements") for entry in entries if not _is_empty(entry)),
    ]


def _is_empty(entry: Entry) -> bool:
    return isinstance(entry.value, Sequence | Mapping) and not entry.value.entries and not entry.note


def _requirements(words: tuple[str, ...], notes: Notes) -> Entry:
    return Entry(items((word.removeprefix(":") for word in words), short=True), "requirements", notes.at(":requirements").take())


def _names(key: str, pairs: Iterable[tuple[str, tuple[str, ...]]], notes: Notes) -> Entry:
    own = notes.at(f":{key}")
    lines = tuple([Entry(text, note=note) for text, note in typed_lines(pairs, own)])
    return Entry(Sequence(lines), key, own.take())


def _declarations(key: str, declared: Iterable[Declaration], notes: Notes) -> Entry:
    own = notes.at(f":{key}")
    lines: list[Entry] = []
    for declaration in declared:
        text = flat([declaration.name, *variables_form(declaration.parameters)])
        values = f" - {flat(types_form(declaration.values))}" if declaration.values else ""
        lines.append(Entry(f"{text}{values}", note=own.at(declaration.name.lower()).take()))
    return Entry(Sequence(tuple(lines)), key, own.take())


def _rule(rule: DerivationRule, notes: Notes) -> Entry:
    form = rule_form(rule)
    own = notes.at(":derived", rule_anchor(form))
    note = own.take()
    return Entry(Mapping((Entry(flat(form[1]), "fact"), Entry(conditions(rule.condition, own), "condition"))), note=note)


def _constraints(whole: Domain | Problem, notes: Notes) -> Entry:
    own = notes.at(":constraints")
    note = own.take() if whole.constraints or any(isinstance(preference.wanted, tuple) for preference in whole.preferences) else NO_NOTE
    return Entry(constraints(whole.constraints, own), "constraints", note)


def _parts(schema: ActionSchema, notes: Notes) -> Iterator[Entry]:
    if schema.parameters:
        yield Entry(typed(schema.parameters), "params", notes.at("parameters").take())
    if schema.duration is not None:
        yield Entry(duration(schema.duration), "duration", notes.at("duration").take())
    wanted = notes.at("condition")
    tests = (("at_start", schema.precondition), ("over_all", schema.invariant), ("at_end", schema.end_condition))
    if schema.duration is None:
        conditional = conditions(schema.precondition, wanted) if schema.precondition != TRUE else None
    else:
        conditional = _moments((key, conditions(condition, wanted)) for key, condition in tests if condition != TRUE)
    if conditional is not None:
        yield Entry(conditional, "preconditions", wanted.take())
    if schema.preferences:
        yield Entry(preferences(schema.preferences, wanted, wanted), "preferences", wanted.take())
    changing = notes.at("effect")
    changes = (("at_start", schema.start_effects), ("at_end", schema.end_effects))
    if schema.duration is None:
        conditional = effects(schema.end_effects, changing) if schema.end_effects else None
    else:
        conditional = _moments((key, effects(timed, changing)) for key, timed in changes if timed)
    if conditional is not None:
        yield Entry(conditional, "effects", changing.take())


def _moments(parts: Iterable[tuple[str, Value]]) -> Value | None:
    entries = tuple([Entry(value, key) for key, value in parts])
    return Mapping(entries) if entries else None


def _problem(problem: Problem, notes: Notes) -> Iterator[Entry]:
    goal, facts = notes.at(":goal"), notes.at(":init")
    entries = [
        _requirements(problem.requirements, notes),
        _names("objects", problem.own_objects.items(), notes),
        Entry(Sequence(tuple(_initial(problem, facts))), "init", facts.take()),
        _constraints(problem, notes),
        Entry(preferences(problem.preferences, goal, notes.at(":constraints")), "preferences"),
    ]
    yield Entry(problem.name, "name")
    yield from (entry for entry in entries if not _is_empty(entry))
    if problem.network:
        yield Entry(problem.network, "network", notes.at(*hierarchy_anchor(problem.network)).take())
    if problem.goal != TRUE or not problem.network:
        yield Entry(conditions(problem.goal, goal), "goal", goal.take())
    if problem.metric:
        metric = single(problem.metric.direction, expression(problem.metric.expression))
        yield Entry(metric, "metric", notes.at(":metric").take())


def _initial(problem: Problem, notes: Notes) -> Iterator[Entry]:
    for fluent, value in problem.init.items():
        if value is not False:
            form = change_form(fluent, value)
            yield Entry(flat(form), note=notes.at(fact_anchor(form)).take())
    for timed in problem.timed:
        time = number_text(timed.time)
        forms = [change_form(fluent, value) for fluent, value in timed.changes.items()]
        facts = [Entry(flat(form), note=notes.at(fact_anchor(["at", time, form])).take()) for form in forms]
        yield Entry(Mapping((Entry(Bare(time), "at"), Entry(Sequence(tuple(facts)), "facts"))))
