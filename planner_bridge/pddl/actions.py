"""PDDL actions, instantaneous and durative, processes and events: from their sections to `ActionSchema`.

The conditions and effects of a durative action are sorted by their time specifiers: at start, over all, at end.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import count
from typing import Final, Literal, TypeAlias, TypeVar

from planner_bridge.pddl.expressions import TIME_SPECIFIERS, Atom, Group, Node, TimeSpecifier, new_name, operands, where, wrong
from planner_bridge.pddl.formulas import (
    TermScope,
    alternatives,
    condition,
    effects,
    has_alternatives,
    is_preference,
    preference,
    split_preferences,
    with_variables,
)
from planner_bridge.pddl.sections import Leniency, Refused, keyed
from planner_bridge.pddl.symbols import SymbolTable
from pnm.core.logic.conditions import TRUE, Condition, ForAll, conjunction
from pnm.core.logic.domain import ActionSchema, DurationConstraint, Preference
from pnm.core.logic.effects import OPERATIONS, Alternative, Effect, Effects, ForEach, OneOf, Set, When, has_outcomes, outcomes
from pnm.core.logic.expressions import Constant, OnlyObjects, Variable, expression_fluents, fluent_text
from pnm.errors import InputError

T = TypeVar("T")
Timed: TypeAlias = dict[TimeSpecifier, list[T]]

INSTANTANEOUS: Final = ":action"
DURATIVE: Final = ":durative-action"
PROCESS: Final = ":process"
EVENT: Final = ":event"
_VARS: Final = ":vars"
"""Of an early PDDL: variables that are no parameters, but have to be chosen just the same."""
_INSIDE: Final = ("or", "not", "imply", "exists")
"""Connectives that belong inside a time specifier, not around it."""


def actions(sections: Iterable[Group], symbols: SymbolTable) -> dict[str, ActionSchema]:
    """Read the actions, the processes or the events in the order of the file."""
    schemas: dict[str, ActionSchema] = {}
    first: dict[str, Group] = {}
    named: list[tuple[str, Group]] = []
    for section in sections:
        if not section.rest:
            raise wrong(section, f"expected a name after '{section.head}', found nothing")
        named.append((new_name(section.rest[0], section.head[1:]), section))
        first.setdefault(named[-1][0].lower(), section)
    for name, section in named:
        if first[name.lower()] is not section:
            same = name
            name = next(one for number in count(2) if (one := f"{same}-{number}").lower() not in first)
            first[name.lower()] = section
            Leniency.ACTION_TWICE.note(section, same, where(first[same.lower()]).line, name)
        if section.head == DURATIVE:
            schemas[name] = _durative(name, section, symbols)
            continue
        parts = keyed(section.rest[1:], f"the {section.head[1:]} {name!r}", (":parameters", ":precondition", ":effect", _VARS))
        parameters = _parameters(parts, symbols)
        scope = TermScope(symbols, rates=section.head == PROCESS).inside(parameters)
        empty = Group((), section.offset, section.source)
        precondition, preferences = split_preferences(parts.get(":precondition", empty), scope)
        changes = effects(parts.get(":effect", empty), scope)
        schemas[name] = ActionSchema(name, parameters, precondition=precondition, end_effects=changes, preferences=preferences)
        if section.head != INSTANTANEOUS:
            symbols.requirements.need(section, ":time", ":processes" if section.head == PROCESS else ":events")
            if preferences or has_outcomes(changes):
                raise wrong(section, f"{name} happens by itself; preferences and several outcomes are for actions")
    for schema, (_, section) in zip(schemas.values(), named, strict=True):
        if has_outcomes(schema.end_effects):
            try:
                ways = outcomes(schema.end_effects, OnlyObjects({}))
            except InputError as error:
                raise wrong(section, error.message) from error
            for way in ways:
                added, deleted = (
                    dict.fromkeys(one.fluent for one in way.effects if isinstance(one, Set) and one.value == Constant(truth))
                    for truth in (True, False)
                )
                for fluent in (one for one in deleted if one in added):
                    Leniency.ADDED_AND_DELETED.note(section, way.name, schema.name, fluent_text(fluent))
    return schemas


def _durative(name: str, section: Group, symbols: SymbolTable) -> ActionSchema:
    symbols.requirements.need(section, ":durative-actions")
    parts = keyed(section.rest[1:], f"the durative action {name!r}", (":parameters", ":duration", ":condition", ":effect", _VARS))
    if ":duration" not in parts:
        raise wrong(section, f"the durative action {name!r} has no :duration; expected :duration (= ?duration ...), or () for any")
    parameters = _parameters(parts, symbols)
    bare = TermScope(symbols).inside(parameters)
    timed = TermScope(symbols, bare.variables, duration=True)
    empty = Group((), section.offset, section.source)
    conditions, preferences = _timed_conditions(parts.get(":condition", empty), timed)
    changes = _effects(parts.get(":effect", empty), timed)
    return ActionSchema(
        name,
        parameters,
        precondition=conditions["at start"],
        invariant=conditions["over all"],
        end_condition=conditions["at end"],
        start_effects=tuple(changes.get("at start", ())),
        end_effects=tuple(changes.get("at end", ())),
        duration=_duration(parts[":duration"], bare),
        preferences=preferences,
    )


def _parameters(parts: dict[str, Node], symbols: SymbolTable) -> tuple[Variable, ...]:
    words: list[Node] = []
    for key in (":parameters", _VARS):
        node = parts.get(key)
        if node is None:
            continue
        if not isinstance(node, Group):
            raise wrong(node, f"expected the parameters in parentheses, found {node}")
        if key == _VARS:
            Leniency.VARS.note(node)
        words.extend(node.items)
    return symbols.variables(words)


def _time_specifier(node: Group) -> TimeSpecifier | None:
    match node.items:
        case (Atom() as first, Atom() as second, _):
            return next((specifier for specifier in TIME_SPECIFIERS if specifier == f"{first.key} {second.key}"), None)
        case _:
            return None


def _timed(node: Node, allowed: tuple[TimeSpecifier, ...], others: str) -> tuple[TimeSpecifier, Node]:
    """Return the moment and the body of ``(at start X)``, ``(over all X)`` or ``(at end X)``."""
    moment = _time_specifier(node) if isinstance(node, Group) else None
    if isinstance(node, Group) and moment in allowed:
        return moment, node.items[2]
    expected = ", ".join(f"({moment} ...)" for moment in allowed)
    raise wrong(node, f"expected {expected}, {others}; found {node}")


def _moments_inside(node: Group) -> set[TimeSpecifier]:
    moment = _time_specifier(node)
    return {moment} if moment else set().union(*[_moments_inside(part) for part in node.rest if isinstance(part, Group)])


def _untimed(node: Node) -> Node:
    if not isinstance(node, Group):
        return node
    return node.items[2] if _time_specifier(node) else Group(tuple([_untimed(part) for part in node.items]), node.offset, node.source)


def _merged(parts: Iterable[Timed[T]]) -> Timed[T]:
    merged: Timed[T] = {}
    for part in parts:
        for moment, items in part.items():
            merged.setdefault(moment, []).extend(items)
    return merged


def _timed_conditions(node: Node, scope: TermScope) -> tuple[dict[TimeSpecifier, Condition], tuple[Preference, ...]]:
    hard, soft = _conditions(node, scope)
    return {moment: conjunction(hard.get(moment, ())) for moment in TIME_SPECIFIERS}, tuple(soft)


def _conditions(node: Node, scope: TermScope) -> tuple[Timed[Condition], list[Preference]]:
    match node:
        case Group() if node.head == "and" or not node.items:
            parts = [_conditions(part, scope) for part in node.rest]
            return _merged(hard for hard, _ in parts), [preference for _, soft in parts for preference in soft]
        case Group() if node.head == "forall":
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _conditions(body, scope.inside(variables))
            return {moment: [ForAll(variables, conjunction(parts))] for moment, parts in hard.items()}, with_variables(variables, soft)
        case Group() if is_preference(node, scope):
            name, (moment, body) = preference(node, scope, lambda timed: _timed(timed, TIME_SPECIFIERS, "one of them"))
            wanted, inner = split_preferences(body, scope)
            if inner:
                raise wrong(node.rest[-1], "a preference cannot stand inside another")
            return {}, [Preference(name, wanted, moment=moment)]
        case Group() if node.head in _INSIDE and len(moments := _moments_inside(node)) == 1 and "over all" not in moments:
            (moment,) = moments
            Leniency.MOMENT_INSIDE.note(node, node, moment)
            return {moment: [condition(_untimed(node), scope)]}, []
    moment, body = _timed(node, TIME_SPECIFIERS, "and or forall")
    required, preferred = split_preferences(body, scope, moment)
    return ({} if required == TRUE and preferred else {moment: [required]}), list(preferred)


def _effects(node: Node, scope: TermScope) -> Timed[Effect]:
    match node:
        case Group() if node.head == "and" or not node.items:
            return _merged(_effects(part, scope) for part in node.rest)
        case Group() if node.head == "forall":
            scope.symbols.requirements.need(node, ":conditional-effects")
            variables, body = scope.quantified(node)
            inner = _effects(body, scope.inside(variables))
            return {moment: [ForEach(variables, tuple(parts))] for moment, parts in inner.items()}
        case Group() if node.head == "when":
            scope.symbols.requirements.need(node, ":conditional-effects")
            first, second = operands(node, 2)
            conditions, preferred = _timed_conditions(first, scope)
            if preferred:
                raise wrong(first, "a preference cannot stand in the condition of an effect")
            if conditions["over all"] != TRUE:
                raise Refused.CONDITIONAL_OVER_ALL.at(first)
            return {moment: [_when(conditions, moment, tuple(parts), node)] for moment, parts in _effects(second, scope).items()}
        case Group() if has_alternatives(node, scope):
            parts = [(_effects(part, scope), chance) for part, chance in alternatives(node, scope)]
            if any("at start" in timed for timed, _ in parts):
                raise Refused.OUTCOMES_AT_START.at(node)
            return {"at end": [OneOf(tuple([Alternative(tuple(timed.get("at end", ())), chance) for timed, chance in parts]))]}
        case Group() if node.head in OPERATIONS:
            effects(node, scope)  # which refuses a continuous one
    moment, body = _timed(node, ("at start", "at end"), "and, forall or when")
    changes = effects(body, scope)
    if moment == "at start" and has_outcomes(changes):
        raise Refused.OUTCOMES_AT_START.at(body)
    return {moment: list(changes)}


def _when(conditions: Mapping[TimeSpecifier, Condition], moment: TimeSpecifier, parts: Effects, node: Node) -> Effect:
    early, late = conditions["at start"], conditions["at end"]
    if moment == "at start":
        if late != TRUE:
            raise wrong(node, "an effect 'at start' cannot depend on a condition 'at end'; expected one 'at start'")
        return When(early, parts)
    if early == TRUE:
        return When(late, parts)
    return When(early, (When(late, parts),) if late != TRUE else parts, early=True)


_Comparison: TypeAlias = Literal["=", "<=", ">="]
_COMPARISONS: Final[Mapping[str, _Comparison]] = {"=": "=", "<=": "<=", ">=": ">="}
_CONVERSE: Final[Mapping[_Comparison, _Comparison]] = {"=": "=", "<=": ">=", ">=": "<="}


def _duration(node: Node, scope: TermScope) -> tuple[DurationConstraint, ...]:
    """Read the constraints on ``?duration``; ``()`` leaves it free."""
    match node:
        case Group(items=()):
            return ()
        case Group() if node.head == "and":
            return tuple([constraint for part in node.rest for constraint in _duration(part, scope)])
        case Group() if _time_specifier(node) == "at start":
            return _duration(node.items[2], scope)
        case Group() if _time_specifier(node) == "at end":
            raise Refused.DURATION_AT_END.at(node)
        case Group() if node.head in _COMPARISONS:
            left, right = operands(node, 2)
            operation = _COMPARISONS[node.head]
            if _is_duration(right) and not _is_duration(left):
                Leniency.DURATION_SECOND.note(node)
                left, right, operation = right, left, _CONVERSE[operation]
            if not _is_duration(left):
                raise wrong(left, f"expected ?duration, found {left}")
            if operation != "=":
                scope.symbols.requirements.need(node, ":duration-inequalities")
            bound = scope.expression(right)
            if any(expression_fluents(bound)):
                scope.symbols.requirements.need(node, ":numeric-fluents")
            return (DurationConstraint(operation, bound),)
        case _:
            raise wrong(node, f"expected (= ?duration ...), <=, >= or and of these; found {node}")


def _is_duration(node: Node) -> bool:
    return isinstance(node, Atom) and node.key == "?duration"
