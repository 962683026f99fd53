"""Domains, problems and plans as YAML in the language that people write.

The steps of a plan are nested blocks where their order is series-parallel, and have ``after`` lists where it is not. Temporal plans have
more than orderings of whole calls: a call starts or ends after the start of another, after a delay, or not before a time. Then all steps
stand in one list, and each has all it waits for.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from math import inf
from types import MappingProxyType
from typing import Final, TypeAlias, assert_never

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import writer as pddl
from planner_bridge.pddl.comments import NO_COMMENTS, NO_NOTE, NO_NOTES, CommentTable, Notes, write_with_notes
from planner_bridge.pddl.expressions import number_text
from planner_bridge.yaml.emitter import Bare, Entry, Value, YamlList, YamlMapping, depth, document, items, single
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration, DurationConstraint, Preference
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, When
from pnm.core.logic.expressions import Arithmetic, Constant, Expression, ValueOf, Variable, fluent_text
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import DEFAULT, NO_BINDINGS, Binding, Bindings, Foreign, Found, Table, WhenLost
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph, necessary
from pnm.core.message_fields import Combined, Comparison, FieldValue, Flag
from pnm.core.net.net import closure, places, reduced
from pnm.errors import InputError
from pnm.files.yaml_nodes import MAX_DEPTH
from pnm.language.grammar import RESERVED

LANGUAGE_DEFAULT: Final = Binding(retries=0)
"""The keys of an action in the language without information."""
_LONG: Final = 80
"""Characters of typed variables in one text, at most."""


def write_domain(domain: Domain, table: CommentTable = NO_COMMENTS, bindings: Bindings = NO_BINDINGS) -> str:
    """Write a domain as YAML, with the comments of the table, and with how its actions are bound to servers.

    Raises `InputError` if something is nested deeper than the language allows, or an action has the name of a word of the language.
    """
    return write_with_notes(table, lambda notes: written(domain_entries(domain, notes, bindings)))


def write_problem(problem: Problem, table: CommentTable = NO_COMMENTS, plan: Iterable[Entry] = (), bindings: Bindings = NO_BINDINGS) -> str:
    """Write a domain and a problem as one YAML file, with the comments of the table, and a plan for the problem; else as `write_domain`."""

    def write(notes: Notes) -> str:
        own = notes.at("problem")
        entry = Entry(YamlMapping(tuple(_problem(problem, own))), "problem", own.take(), apart=True)
        return written([*domain_entries(problem.domain, notes, bindings), entry, *plan])

    return write_with_notes(table, write)


def written(entries: Iterable[Entry]) -> str:
    """Write a file."""
    whole = YamlMapping(tuple(entries))
    if depth(whole) >= MAX_DEPTH:
        raise InputError(f"this is nested too deeply for YAML files, which may have {MAX_DEPTH} lists and mappings in each other")
    return document(whole)


def domain_entries(domain: Domain, notes: Notes, bindings: Bindings) -> list[Entry]:
    """Return the keys of a file with a domain."""
    if name := next((name for name in domain.actions if name in RESERVED), None):
        raise InputError(f"{name!r} is a word of the language; expected another name for the action in the domain")
    own = notes.at("domain")
    root = own.take().joined(notes.take())
    rules: list[Entry] = []
    for rule in domain.rules:
        form = pddl.rule_form(rule)
        inner = own.at(":derived", pddl.rule_anchor(form))
        note = inner.take()
        keys = Entry(pddl.flat(form[1]), "fact"), Entry(conditions(rule.condition, inner), "condition")
        rules.append(Entry(YamlMapping(keys), note=note))
    entries = [
        _requirements(domain.requirements, own),
        _names("types", ((name, above or ("object",)) for name, above in domain.types.items()), own),
        _names("constants", domain.constants.items(), own),
        _declarations("predicates", domain.predicates.values(), own),
        _declarations("functions", domain.functions.values(), own),
        Entry(YamlList(tuple(rules)), "derived"),
        _constraints(domain, own),
        Entry(preferences(domain.preferences, NO_NOTES, own.at(":constraints")), "preferences"),
        Entry(YamlList(tuple(Entry(text, note=own.at(*pddl.hierarchy_anchor(text)).take()) for text in domain.hierarchy)), "hierarchy"),
    ]
    actions: list[Entry] = []
    for schema in domain.actions.values():
        inner = own.at(pddl.ACTION, schema.name.lower())
        binding = bindings.actions.get(schema.name)
        bound = tuple(binding_entries(binding or LANGUAGE_DEFAULT, LANGUAGE_DEFAULT, {"type": "ros_type", "outcomes": "told_by"}))
        if binding == LANGUAGE_DEFAULT:  # said all the same: an action without keys is imported as one that has no binding
            bound = (Entry(_value(binding.retries), "retries"),)
        actions.append(Entry(YamlMapping((*_parts(schema, inner), *bound)), schema.name, inner.take(), apart=bool(actions)))
    entries.append(Entry(YamlMapping(tuple(actions)), "actions"))
    for key, head in pddl.NATURE.items():
        schemas = [(schema, own.at(head, schema.name.lower())) for schema in getattr(domain, key).values()]
        listed = (Entry(YamlMapping(tuple(_parts(schema, inner))), schema.name, inner.take()) for schema, inner in schemas)
        entries.append(Entry(YamlMapping(tuple(listed)), key))
    filled = (replace(entry, apart=entry.key != "requirements") for entry in entries if not _is_empty(entry))
    return [Entry(domain.name, "name", root), *filled]


def _is_empty(entry: Entry) -> bool:
    return isinstance(entry.value, YamlList | YamlMapping) and not entry.value.entries and not entry.note


def _requirements(words: tuple[str, ...], notes: Notes) -> Entry:
    return Entry(items((word.removeprefix(":") for word in words), short=True), "requirements", notes.at(":requirements").take())


def _names(key: str, pairs: Iterable[tuple[str, tuple[str, ...]]], notes: Notes) -> Entry:
    own = notes.at(f":{key}")
    lines = tuple([Entry(text, note=note) for text, note in pddl.typed_lines(pairs, own)])
    return Entry(YamlList(lines), key, own.take())


def _declarations(key: str, declared: Iterable[Declaration], notes: Notes) -> Entry:
    own = notes.at(f":{key}")
    lines: list[Entry] = []
    for declaration in declared:
        text = pddl.flat([declaration.name, *pddl.variables_form(declaration.parameters)])
        values = f" - {pddl.flat(pddl.types_form(declaration.values))}" if declaration.values else ""
        lines.append(Entry(f"{text}{values}", note=own.at(declaration.name.lower()).take()))
    return Entry(YamlList(tuple(lines)), key, own.take())


def _constraints(whole: Domain | Problem, notes: Notes) -> Entry:
    own = notes.at(":constraints")
    note = own.take() if whole.constraints or any(isinstance(preference.wanted, tuple) for preference in whole.preferences) else NO_NOTE
    return Entry(constraints(whole.constraints, own), "constraints", note)


def _parts(schema: ActionSchema, notes: Notes) -> Iterator[Entry]:
    if schema.parameters:
        yield Entry(typed(schema.parameters), "params", notes.at("parameters").take())
    if schema.duration is not None:
        yield Entry(duration(schema.duration), "duration", notes.at("duration").take())
    wanted, changing, is_timed = notes.at("condition"), notes.at("effect"), schema.duration is not None
    tests = (("at_start", schema.precondition), ("over_all", schema.invariant), ("at_end", schema.end_condition))
    if tested := [Entry(conditions(condition, wanted), key) for key, condition in tests if condition != TRUE]:
        yield Entry(YamlMapping(tuple(tested)) if is_timed else tested[0].value, "preconditions", wanted.take())
    if schema.preferences:
        yield Entry(preferences(schema.preferences, wanted, wanted), "preferences", wanted.take())
    *before, last = schema.end_effects or (None,)
    in_any_case = tuple(before) if isinstance(last, OneOf) else schema.end_effects
    changes = (("at_start", schema.start_effects), ("at_end", in_any_case))
    if changed := [Entry(effects(timed, changing), key) for key, timed in changes if timed]:
        yield Entry(YamlMapping(tuple(changed)) if is_timed else changed[0].value, "effects", changing.take())
    if isinstance(last, OneOf):
        own = changing.at(pddl.form_anchor(pddl.effects_form((last,))))
        yield Entry(outcomes(last, own), "outcomes", own.take())


def _problem(problem: Problem, notes: Notes) -> Iterator[Entry]:
    goal, facts = notes.at(":goal"), notes.at(":init")
    forms = [pddl.change_form(fluent, value) for fluent, value in problem.init.items() if value is not False]
    at_first = [Entry(pddl.flat(form), note=facts.at(pddl.fact_anchor(form)).take()) for form in forms]
    later: list[Entry] = []
    for timed in problem.timed:
        time = number_text(timed.time)
        forms = [pddl.change_form(fluent, value) for fluent, value in timed.changes.items()]
        changes = [Entry(pddl.flat(form), note=facts.at(pddl.fact_anchor(["at", time, form])).take()) for form in forms]
        later.append(Entry(YamlMapping((Entry(Bare(time), "at"), Entry(YamlList(tuple(changes)), "facts")))))
    entries = [
        _requirements(problem.requirements, notes),
        _names("objects", problem.own_objects.items(), notes),
        Entry(YamlList((*at_first, *later)), "init", facts.take()),
        _constraints(problem, notes),
        Entry(preferences(problem.preferences, goal, notes.at(":constraints")), "preferences"),
    ]
    yield Entry(problem.name, "name")
    yield from (entry for entry in entries if not _is_empty(entry))
    if problem.network:
        yield Entry(problem.network, "network", notes.at(*pddl.hierarchy_anchor(problem.network)).take())
    if problem.goal != TRUE or not problem.network:
        yield Entry(conditions(problem.goal, goal), "goal", goal.take())
    if problem.metric:
        metric = single(problem.metric.direction, expression(problem.metric.expression))
        yield Entry(metric, "metric", notes.at(":metric").take())


# --- formulas ------------------------------------------------------------------------------


def conditions(condition: Condition, notes: Notes) -> Value:
    """Write what must hold: one condition, or a list of them."""
    entries = [_noted(part, notes) for part in conjuncts(condition)]
    return entries[0].value if len(entries) == 1 and not entries[0].note else YamlList(tuple(entries))


def _noted(condition: Condition, notes: Notes) -> Entry:
    if isinstance(condition, All):  # which is looked through when comments are read
        return Entry(_condition(condition, notes))
    own = notes.at(pddl.form_anchor(pddl.condition_form(condition))) if notes else NO_NOTES
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
            return YamlMapping((Entry(entry.value, "not", entry.note),))
        case All(operands) | Any(operands):
            word = "and" if isinstance(condition, All) else "or"
            return single(word, YamlList(tuple([_noted(operand, notes) for operand in operands])))
        case Implies(left, right):
            return single("imply", YamlList((_noted(left, notes), _noted(right, notes))))
        case ForAll(variables, body) | Exists(variables, body):
            word = "forall" if isinstance(condition, ForAll) else "exists"
            return single(word, _quantified(variables, "condition", conditions(body, notes)))
        case Computed():
            raise InputError(f"PDDL cannot say {condition}: it knows facts and functions, not variables")
        case _:
            assert_never(condition)


def _quantified(variables: tuple[Variable, ...], key: str, body: Value) -> YamlMapping:
    return YamlMapping((Entry(typed(variables), "variables"), Entry(body, key)))


def typed(variables: tuple[Variable, ...]) -> Value:
    """Write variables with their types: as one text, or as a list of texts if that would be long."""
    text = " ".join(map(pddl.flat, pddl.variables_form(variables)))
    if len(text) <= _LONG:
        return text
    runs = groupby(variables, key=lambda variable: variable.types)
    return items(f"{' '.join(variable.name for variable in run)} - {pddl.flat(pddl.types_form(types))}" for types, run in runs)


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


def effects(listed: Effects, notes: Notes) -> YamlList:
    """Write effects, each an item of a list."""
    entries: list[Entry] = []
    for effect in listed:
        own = notes.at(pddl.form_anchor(pddl.effects_form((effect,)))) if notes else NO_NOTES
        written: Value
        match effect:
            case Set(fluent, Constant(True)):
                written = fluent_text(fluent)
            case Set(fluent, Constant(False)):
                written = single("not", fluent_text(fluent))
            case Set(fluent, value, operation):
                written = single(operation.replace("-", "_"), items([fluent_text(fluent), expression(value)], short=True), short=True)
            case When(condition, inner, early):
                tested = Entry(conditions(condition, own), "at_start" if early else "condition")
                written = single("when", YamlMapping((tested, Entry(effects(inner, own), "effects"))))
            case ForEach(variables, inner):
                written = single("forall", _quantified(variables, "effects", effects(inner, own)))
            case OneOf():
                written = single("one_of", outcomes(effect, own))
            case _:
                assert_never(effect)
        entries.append(Entry(written, note=own.take()))
    return YamlList(tuple(entries))


def outcomes(effect: OneOf, notes: Notes) -> YamlList:
    """Write the ways in which effects may turn out, each an item of a list."""
    entries: list[Entry] = []
    for way in effect.alternatives:
        keys = [Entry(way.name, "name")] if way.name else []
        keys += [Entry(Bare(number_text(way.chance)), "chance")] if way.chance is not None else []
        keys += [Entry(effects(way.effects, notes), "effects")] if way.effects or not keys else []
        entries.append(Entry(YamlMapping(tuple(keys))))
    return YamlList(tuple(entries))


def duration(bounds: tuple[DurationConstraint, ...]) -> Value:
    """Write how long an action takes: the one value it has, or a list of bounds."""
    match bounds:
        case (DurationConstraint("=", bound),):
            return expression(bound)
        case _:
            return items(single(bound.operation, expression(bound.bound), short=True) for bound in bounds)


def constraints(listed: Iterable[Constraint], notes: Notes) -> YamlList:
    """Write constraints on the course of states, each an item of a list."""
    entries: list[Entry] = []
    for constraint in listed:
        own = notes.at(pddl.form_anchor(pddl.constraint_form(constraint)))
        times: list[Entry] = [Entry(Bare(number_text(time))) for time in constraint.times]
        operands = [*times, *(_noted(condition, NO_NOTES) for condition in constraint.conditions)]
        value: Value = single(constraint.operator.replace(" ", "_"), operands[0].value if len(operands) == 1 else YamlList(tuple(operands)))
        for variables in reversed(pddl.nested(constraint.variables)):
            value = single("forall", _quantified(variables, "constraint", value))
        entries.append(Entry(value, note=own.take()))
    return YamlList(tuple(entries))


def preferences(listed: Iterable[Preference], states: Notes, courses: Notes) -> YamlList:
    """Write preferences, each an item of a list; the notes are those of the sections where PDDL has them."""
    entries: list[Entry] = []
    for preference in listed:
        wanted, quantifiers = preference.wanted, pddl.nested(preference.variables)
        own = (courses if isinstance(wanted, tuple) else states).at(pddl.form_anchor(pddl.preference_form(preference)))
        keys: list[Entry] = [Entry(preference.name, "name")] if preference.name else []
        if quantifiers:
            keys.append(Entry(typed(quantifiers[0]) if len(quantifiers) == 1 else items(map(typed, quantifiers)), "variables"))
        if preference.moment:
            keys.append(Entry(preference.moment.replace(" ", "_"), "moment"))
        if isinstance(wanted, tuple):
            keys.append(Entry(constraints(wanted, NO_NOTES), "constraints"))
        else:
            keys.append(Entry(conditions(wanted, NO_NOTES), "condition"))
        entries.append(Entry(YamlMapping(tuple(keys)), note=own.take()))
    return YamlList(tuple(entries))


# --- bindings ------------------------------------------------------------------------------


def binding_entries(binding: Binding, usual: Binding, names: Mapping[str, str] = MappingProxyType({})) -> Iterator[Entry]:
    """Yield a key for everything that is not as usual; some of them have other names."""
    for field in fields(binding):
        value = getattr(binding, field.name)
        if field.compare and value != getattr(usual, field.name):
            yield Entry(_value(value), names.get(field.name, field.name))


def write_bindings(bindings: Bindings) -> str:
    """Write a bindings file; an empty text if all is as usual."""
    parts = {name: tuple(binding_entries(binding, DEFAULT)) for name, binding in bindings.actions.items()}
    actions = tuple([Entry(YamlMapping(entries), name) for name, entries in parts.items() if entries])
    return document(YamlMapping((Entry(YamlMapping(actions), "actions"),))) if actions else ""


def unwritten(bindings: Bindings) -> tuple[str, ...]:
    """Return the keys of a bindings file that have no place in exported YAML."""
    return tuple(key for key in ("assumed", "lag") if getattr(bindings, key) != getattr(NO_BINDINGS, key))


def _value(value: object) -> Value:
    match value:
        case str():
            return value
        case Foreign() | WhenLost():
            return str(value.value)
        case Table(of, rows):
            return _value({"of": of, "table": rows})
        case Found(field, types, facts, limit, simulated):
            parts = {"field": str(field), "type": types[0], "facts": [fluent_text(fact) for fact in facts], "limit": limit}
            return _value(parts if simulated is None else {**parts, "simulated": simulated})
        case FieldValue(field, None):
            return str(field)
        case FieldValue(field, table):
            return _value({"field": str(field), "table": table})
        case Flag(field):
            return _value({"field": str(field)})
        case Comparison(field, operation, constant):
            return _value({"field": str(field), operation: constant})
        case Combined(word, tests):
            return _value({word: tests[0] if word == "not" else tests})
        case Mapping():
            return YamlMapping(tuple([Entry(_value(inner), str(key)) for key, inner in value.items()]), short=True)
        case list() | tuple():
            return items(map(_value, value), short=True)
        case float():
            return Bare(number_text(value))
        case _:
            return Bare(json.dumps(value))


# --- plans ---------------------------------------------------------------------------------


def plan_entries(graph: PlanGraph, domain: Domain) -> list[Entry]:
    """Return the keys of a file with a plan that a planner has made."""
    return [Entry(items(_StepWriter(graph, domain).steps() if graph.calls else ()), "plan", apart=True)]


@dataclass(frozen=True)
class _StepWriter:
    graph: PlanGraph
    domain: Domain

    def steps(self) -> list[YamlMapping]:
        orderings = necessary(self.graph.flow)
        simple = all(
            ordering.before.moment is Moment.END and ordering.after.moment is Moment.START and not ordering.delay for ordering in orderings
        )
        if not simple or any(call.release or min(call.latest_start, call.deadline) < inf for call in self.graph.calls):
            return self._explicit(orderings)
        calls = list(dict.fromkeys(event.call for event in self.graph.order))
        numbers = {call: number for number, call in enumerate(calls)}
        match blocks(reduced(len(calls), [(numbers[ordering.before.call], numbers[ordering.after.call]) for ordering in orderings])):
            case Series(parts):
                return [self._block(part, calls) for part in parts]
            case Mesh(before_each):
                return self._mesh(before_each, calls, in_sequence=True)
            case whole:
                return [self._block(whole, calls)]

    def _block(self, block: Block, calls: list[int]) -> YamlMapping:
        match block:
            case int():
                return self._step(calls[block], {})
            case Series(parts):
                return single("sequence", items(self._block(part, calls) for part in parts))
            case Parallel(parts):
                return single("concurrent_actions", items(self._block(part, calls) for part in parts))
            case Mesh(before):
                return single("concurrent_actions", items(self._mesh(before, calls, in_sequence=False)))
            case _:
                assert_never(block)

    def _mesh(self, before: Mapping[int, tuple[int, ...]], calls: list[int], *, in_sequence: bool) -> list[YamlMapping]:
        """Write steps with what they wait for, where that is not what a step of such a list waits for anyway."""
        named = self._names({calls[other] for others in before.values() for other in others})
        steps: list[YamlMapping] = []
        usual: set[int] = set()
        for number, others in before.items():
            after = [] if usual == {*others} else [Entry(items((named[calls[other]] for other in others), short=True), "after")]
            steps.append(self._step(calls[number], named, *after))
            usual = {*usual, number}.difference(others) if in_sequence else usual
        return steps

    def _explicit(self, orderings: Sequence[Ordering]) -> list[YamlMapping]:
        """Write all steps in one list, each with all it waits for and its times."""
        named = self._names({ordering.before.call for ordering in orderings})
        steps: list[YamlMapping] = []
        for call in sorted(self.graph.calls, key=lambda call: call.planned):
            waits = {moment: [ordering for ordering in orderings if ordering.after == PlanEvent(call.index, moment)] for moment in Moment}
            options = [
                Entry(items((_event(ordering, named) for ordering in waits[moment]), short=True), key)
                for moment, key in ((Moment.START, "after"), (Moment.END, "end_after"))
                if moment is Moment.START or waits[moment]
            ]
            fixed = any(bound.operation == "=" for bound in self.domain.actions[call.action.name].duration or ())
            times = [
                ("duration", None if fixed else call.action.duration),
                ("release", call.release or None),
                ("latest_start", call.latest_start if call.latest_start < inf else None),
                ("deadline", call.deadline if call.deadline < inf else None),
            ]
            options += [Entry(Bare(number_text(seconds)), key) for key, seconds in times if seconds is not None]
            steps.append(self._step(call.index, named, *options))
        return steps

    def _step(self, index: int, named: Mapping[int, str], *options: Entry) -> YamlMapping:
        action = self.graph.calls[index].action
        arguments = [Entry(argument, name) for name, argument in zip(action.parameters, action.arguments, strict=True)]
        call = Entry(YamlMapping(tuple(arguments), short=True), action.name)
        expected = [Entry(action.outcome, "outcome")] if action.outcomes and action.outcome != action.outcomes[0].name else []
        whole = (*([Entry(named[index], "id")] if index in named else ()), *expected, *options)
        if call.key in [option.key for option in whole]:
            raise InputError(
                f"this plan needs {call.key!r} as a word of the language; an action cannot be called so, expected another name"
            )
        return YamlMapping((call, *whole))

    def _names(self, wanted: Collection[int]) -> dict[int, str]:
        """Return names for calls: their action, and a number if it is called several times."""
        often, seen, names = Counter(call.action.name for call in self.graph.calls), Counter[str](), dict[int, str]()
        for call in self.graph.calls:
            name = call.action.name
            seen[name] += 1
            if call.index in wanted:
                names[call.index] = f"{name}_{seen[name]}" if often[name] > 1 else name
        return names


def _event(ordering: Ordering, named: Mapping[int, str]) -> Value:
    """Name what comes before: a step for its end, a mapping for its start or for a later time."""
    name, moment = named[ordering.before.call], ordering.before.moment
    if moment is Moment.END and not ordering.delay:
        return name
    delay = [Entry(Bare(number_text(ordering.delay)), "delay")] if ordering.delay else []
    return YamlMapping((Entry(name, moment.value), *delay), short=True)


# --- series-parallel orders ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Series:
    """One after the other."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Parallel:
    """In no order."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Mesh:
    """In an order that is not series-parallel."""

    before: Mapping[int, tuple[int, ...]]
    """For every element, in an order that fits, those directly before it."""


Block: TypeAlias = int | Series | Parallel | Mesh


def blocks(before: Sequence[tuple[int, ...]]) -> Block:
    """Take apart a transitively reduced order of at least one element."""
    earlier = closure(before)
    related = list(earlier)
    for number, ancestors in enumerate(earlier):
        for element in places(ancestors):
            related[element] |= 1 << number
    return _block((1 << len(before)) - 1, before, earlier, related)


def _block(members: int, before: Sequence[tuple[int, ...]], earlier: Sequence[int], related: Sequence[int]) -> Block:
    if members.bit_count() == 1:
        return members.bit_length() - 1
    beside = _components(members, related)
    if len(beside) > 1:
        return Parallel(tuple([_block(part, before, earlier, related) for part in beside]))
    chained = _components(members, [~neighbours for neighbours in related])
    if len(chained) > 1:
        chained.sort(key=lambda part: (earlier[next(places(part))] & members & ~part).bit_count())
        return Series(tuple([_block(part, before, earlier, related) for part in chained]))
    return Mesh({element: tuple(other for other in before[element] if members >> other & 1) for element in places(members)})


def _components(members: int, neighbours: Sequence[int]) -> list[int]:
    """Return the parts of a set that no neighbours connect, by their lowest members."""
    parts: list[int] = []
    left = members
    while left:
        part = frontier = left & -left
        while frontier:
            reached = 0
            for element in places(frontier):
                reached |= neighbours[element]
            frontier = reached & left & ~part
            part |= frontier
        parts.append(part)
        left &= ~part
    return parts
