"""PDDL actions, instantaneous and durative: from their sections to `ActionSchema`.

The timed parts of a durative action: which condition and which effect belongs to which moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal, TypeAlias, TypeVar

from planner_bridge.model.problem import ActionSchema, DurationConstraint, Preference
from planner_bridge.pddl.read.constraints import is_preference, preference, split_preferences, with_variables
from planner_bridge.pddl.read.declarations import UniqueNames
from planner_bridge.pddl.read.formulas import condition, effects
from planner_bridge.pddl.read.symbols import SymbolTable
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.sections import keyed
from planner_bridge.pddl.syntax.words import TIME_SPECIFIERS, TimeSpecifier, new_name, operands, unsupported
from pnm.core.logic.conditions import TRUE, Condition, ForAll, conjunction
from pnm.core.logic.effects import OPERATIONS, Effect, Effects, ForEach, When
from pnm.core.logic.expressions import Arithmetic, Expression, ValueOf, Variable

T = TypeVar("T")
Timed: TypeAlias = dict[TimeSpecifier, list[T]]

_INSIDE: Final = ("or", "not", "imply", "exists")
"""What belongs inside a moment, not around it."""

# --- conditions ----------------------------------------------------------------------------


def timed_conditions(node: Node, scope: TermScope) -> tuple[dict[TimeSpecifier, Condition], tuple[Preference, ...]]:
    """Return one condition for each moment, and what should hold besides."""
    hard, soft = _conditions(node, scope)
    return {moment: conjunction(hard.get(moment, ())) for moment in TIME_SPECIFIERS}, tuple(soft)


def _conditions(node: Node, scope: TermScope) -> tuple[Timed[Condition], list[Preference]]:
    match node:
        case Group() if node.head == "and" or not node.items:
            both = [_conditions(part, scope) for part in node.rest]
            return _merged(hard for hard, _ in both), [one for _, soft in both for one in soft]
        case Group() if node.head == "forall":
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _conditions(body, scope.inside(variables))
            return {moment: [ForAll(variables, conjunction(parts))] for moment, parts in hard.items()}, with_variables(variables, soft)
        case Group() if is_preference(node, scope):
            name, (moment, wanted) = preference(node, scope, lambda body: _wanted(body, scope))
            return {}, [Preference(name, wanted, moment=moment)]
        case Group() if node.head in _INSIDE and len(moments := _moments(node)) == 1 and "over all" not in moments:
            (moment,) = moments
            tolerate(node, f"{node} is expected inside ({moment} ...)")
            return {moment: [condition(_untimed(node), scope)]}, []
    moment, body = _timed(node, TIME_SPECIFIERS, "and or forall")
    wanted, preferred = split_preferences(body, scope, moment)
    return ({} if wanted == TRUE and preferred else {moment: [wanted]}), list(preferred)


def _moments(node: Group) -> set[TimeSpecifier]:
    """Return the moments that are named inside a condition."""
    moment = _moment(node)
    return {moment} if moment else set().union(*[_moments(part) for part in node.rest if isinstance(part, Group)])


def _untimed(node: Node) -> Node:
    """Return the condition without the moments named inside it."""
    if not isinstance(node, Group):
        return node
    return node.items[2] if _moment(node) else Group(tuple([_untimed(part) for part in node.items]), node.offset, node.source)


def _wanted(node: Node, scope: TermScope) -> tuple[TimeSpecifier, Condition]:
    moment, body = _timed(node, TIME_SPECIFIERS, "one of them")
    wanted, preferred = split_preferences(body, scope)
    if preferred:
        raise wrong(node, "a preference cannot stand inside another")
    return moment, wanted


# --- effects -------------------------------------------------------------------------------


def timed_effects(node: Node, scope: TermScope) -> dict[TimeSpecifier, Effects]:
    """Return the effects at the start and at the end."""
    found = _effects(node, scope)
    return {moment: tuple(found.get(moment, ())) for moment in TIME_SPECIFIERS}


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
            return _conditional(node, scope)
        case Group() if node.head in OPERATIONS:
            effects(node, scope)  # which refuses a continuous one
    moment, body = _timed(node, ("at start", "at end"), "and, forall or when")
    return {moment: list(effects(body, scope))}


def _conditional(node: Group, scope: TermScope) -> Timed[Effect]:
    first, second = operands(node, 2)
    conditions, preferred = timed_conditions(first, scope)
    if preferred:
        raise wrong(first, "a preference cannot stand in the condition of an effect")
    if conditions["over all"] != TRUE:
        raise unsupported(first, "conditional effects on a condition 'over all'", "a watch over what is not required")
    return {moment: [_when(conditions, moment, tuple(parts), node)] for moment, parts in _effects(second, scope).items()}


def _when(conditions: Mapping[TimeSpecifier, Condition], moment: TimeSpecifier, parts: Effects, node: Node) -> Effect:
    early, late = conditions["at start"], conditions["at end"]
    if moment == "at start":
        if late != TRUE:
            raise wrong(node, "an effect 'at start' cannot depend on a condition 'at end'; expected one 'at start'")
        return When(early, parts)
    if early == TRUE:
        return When(late, parts)
    return When(early, (When(late, parts),) if late != TRUE else parts, early=True)


def _timed(node: Node, moments: tuple[TimeSpecifier, ...], others: str) -> tuple[TimeSpecifier, Node]:
    moment = _moment(node) if isinstance(node, Group) else None
    if isinstance(node, Group) and moment in moments:
        return moment, node.items[2]
    expected = ", ".join(f"({moment} ...)" for moment in moments)
    raise wrong(node, f"expected {expected}, {others}; found {node}")


def _moment(node: Group) -> TimeSpecifier | None:
    match node.items:
        case (Atom() as first, Atom() as second, _):
            return next((moment for moment in TIME_SPECIFIERS if moment == f"{first.key} {second.key}"), None)
        case _:
            return None


def _merged(parts: Iterable[Timed[T]]) -> Timed[T]:
    result: Timed[T] = {}
    for part in parts:
        for moment, found in part.items():
            result.setdefault(moment, []).extend(found)
    return result


# --- duration ------------------------------------------------------------------------------

_FORMS: Final[Mapping[str, Literal["=", "<=", ">="]]] = {"=": "=", "<=": "<=", ">=": ">="}
_TURNED: Final[Mapping[Literal["=", "<=", ">="], Literal["=", "<=", ">="]]] = {"=": "=", "<=": ">=", ">=": "<="}


def duration(node: Node, scope: TermScope) -> tuple[DurationConstraint, ...]:
    """Read the constraints on ``?duration``; ``()`` leaves it free."""
    match node:
        case Group(items=()):
            return ()
        case Group() if node.head == "and":
            return tuple([constraint for part in node.rest for constraint in duration(part, scope)])
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "start"):
            return duration(body, scope)
        case Group(items=(Atom() as at, Atom() as moment, _)) if (at.key, moment.key) == ("at", "end"):
            raise unsupported(node, "durations that are decided at the end", "a bound that is only known when the action ends")
        case Group() if node.head in _FORMS:
            return (_bound(node, scope),)
        case _:
            raise wrong(node, f"expected (= ?duration ...), <=, >= or and of these; found {node}")


def _bound(node: Group, scope: TermScope) -> DurationConstraint:
    left, right = operands(node, 2)
    operation = _FORMS[node.head]
    if _is_duration(right) and not _is_duration(left):
        tolerate(node, "?duration is expected first")
        left, right, operation = right, left, _TURNED[operation]
    if not _is_duration(left):
        raise wrong(left, f"expected ?duration, found {left}")
    if operation != "=":
        scope.symbols.requirements.need(node, ":duration-inequalities")
    bound = scope.expression(right)
    if _has_fluents(bound):
        scope.symbols.requirements.need(node, ":numeric-fluents")
    return DurationConstraint(operation, bound)


def _is_duration(node: Node) -> bool:
    return isinstance(node, Atom) and node.key == "?duration"


def _has_fluents(expression: Expression) -> bool:
    return isinstance(expression, ValueOf) or (isinstance(expression, Arithmetic) and any(map(_has_fluents, expression.operands)))


INSTANTANEOUS: Final = ":action"
DURATIVE: Final = ":durative-action"
_EMPTY: Final[tuple[Node, ...]] = ()
_VARS: Final = ":vars"
"""Of an early PDDL: variables that are no parameters, but have to be chosen just the same."""


def actions(sections: Iterable[Group], symbols: SymbolTable) -> dict[str, ActionSchema]:
    """Read the actions in the order of the file."""
    once = UniqueNames("action")
    found: dict[str, ActionSchema] = {}
    for section in sections:
        if not section.rest:
            raise wrong(section, f"expected a name after '{section.head}', found nothing")
        name = new_name(section.rest[0], "action")
        once.check(name, section)
        found[name] = (_durative if section.head == DURATIVE else _instantaneous)(name, section, symbols)
    return found


def _instantaneous(name: str, section: Group, symbols: SymbolTable) -> ActionSchema:
    parts = keyed(section.rest[1:], f"the action {name!r}", (":parameters", ":precondition", ":effect", _VARS))
    parameters = _parameters(parts, symbols)
    scope = TermScope(symbols).inside(parameters)
    nothing = Group(_EMPTY, section.offset, section.source)
    precondition, preferences = split_preferences(parts.get(":precondition", nothing), scope)
    return ActionSchema(
        name,
        parameters,
        precondition=precondition,
        end_effects=effects(parts.get(":effect", nothing), scope),
        preferences=preferences,
    )


def _durative(name: str, section: Group, symbols: SymbolTable) -> ActionSchema:
    symbols.requirements.need(section, ":durative-actions")
    parts = keyed(section.rest[1:], f"the durative action {name!r}", (":parameters", ":duration", ":condition", ":effect", _VARS))
    if ":duration" not in parts:
        raise wrong(section, f"the durative action {name!r} has no :duration; expected :duration (= ?duration ...), or () for any")
    parameters = _parameters(parts, symbols)
    bare = TermScope(symbols).inside(parameters)
    timed = TermScope(symbols, bare.variables, duration=True)
    nothing = Group(_EMPTY, section.offset, section.source)
    conditions, preferences = timed_conditions(parts.get(":condition", nothing), timed)
    changes = timed_effects(parts.get(":effect", nothing), timed)
    return ActionSchema(
        name,
        parameters,
        precondition=conditions["at start"],
        invariant=conditions["over all"],
        end_condition=conditions["at end"],
        start_effects=changes["at start"],
        end_effects=changes["at end"],
        duration=duration(parts[":duration"], bare),
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
            tolerate(node, "the variables of :vars are read as further parameters")
        words.extend(node.items)
    return symbols.variables(words)
