"""The timed parts of a durative action: which condition and which effect belongs to which moment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, TypeVar, get_args

from planner_bridge.model import DurationConstraint
from planner_bridge.pddl.conditions import Reader, conjunction, operands
from planner_bridge.pddl.names import unsupported
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from pnm.conditions import TRUE, Condition, ForAll
from pnm.effects import OPERATIONS, Effect, Effects, ForEach, When

Moment: TypeAlias = Literal["at start", "over all", "at end"]
MOMENTS: Final[tuple[Moment, ...]] = get_args(Moment)
T = TypeVar("T")
Timed: TypeAlias = dict[Moment, list[T]]


def timed_conditions(node: Node, reader: Reader) -> dict[Moment, Condition]:
    """Return one condition for each moment."""
    found = _conditions(node, reader)
    return {moment: conjunction(found.get(moment, ())) for moment in MOMENTS}


def _conditions(node: Node, reader: Reader) -> Timed[Condition]:
    match node:
        case Group() if node.head == "and" or not node.items:
            return _merged([_conditions(part, reader) for part in node.rest])
        case Group() if node.head == "forall":
            variables, body = reader.quantified(node)
            inner = _conditions(body, reader.inside(variables))
            return {moment: [ForAll(variables, conjunction(parts))] for moment, parts in inner.items()}
        case Group() if node.head == "preference":
            reader.condition(node)  # which refuses it
    moment, body = _timed(node, MOMENTS, "and or forall")
    return {moment: [reader.condition(body)]}


def timed_effects(node: Node, reader: Reader) -> dict[Moment, Effects]:
    """Return the effects at the start and at the end."""
    found = _effects(node, reader)
    return {moment: tuple(found.get(moment, ())) for moment in MOMENTS}


def _effects(node: Node, reader: Reader) -> Timed[Effect]:
    match node:
        case Group() if node.head == "and" or not node.items:
            return _merged([_effects(part, reader) for part in node.rest])
        case Group() if node.head == "forall":
            variables, body = reader.quantified(node)
            inner = _effects(body, reader.inside(variables))
            return {moment: [ForEach(variables, tuple(parts))] for moment, parts in inner.items()}
        case Group() if node.head == "when":
            return _conditional(node, reader)
        case Group() if node.head in OPERATIONS:
            reader.effects(node)  # which refuses a continuous one
    moment, body = _timed(node, ("at start", "at end"), "and, forall or when")
    return {moment: list(reader.effects(body))}


def _conditional(node: Group, reader: Reader) -> Timed[Effect]:
    condition, effect = operands(node, 2)
    conditions = {moment: part for moment, part in timed_conditions(condition, reader).items() if part != TRUE}
    effects = _effects(effect, reader)
    for moment in conditions:
        if set(effects) - {moment}:
            what = f"conditional effects '{', '.join(effects)}' on a condition '{moment}'"
            raise unsupported(node, what, "a memory of the condition until the effect")
    return {moment: [When(conditions.get(moment, TRUE), tuple(parts))] for moment, parts in effects.items()}


def _timed(node: Node, moments: tuple[Moment, ...], others: str) -> tuple[Moment, Node]:
    if isinstance(node, Group) and len(node.items) == 3:
        first, second, body = node.items
        for moment in moments:
            if isinstance(first, Atom) and isinstance(second, Atom) and f"{first.key} {second.key}" == moment:
                return moment, body
    expected = ", ".join(f"({moment} ...)" for moment in moments)
    raise wrong(node, f"expected {expected}, {others}; found {node}")


def _merged(parts: list[Timed[T]]) -> Timed[T]:
    result: Timed[T] = {}
    for part in parts:
        for moment, found in part.items():
            result.setdefault(moment, []).extend(found)
    return result


# --- duration ------------------------------------------------------------------------------

_FORMS: Final[Mapping[str, Literal["=", "<=", ">="]]] = {"=": "=", "<=": "<=", ">=": ">="}


def duration(node: Node, reader: Reader) -> tuple[DurationConstraint, ...]:
    """Read the constraints on ``?duration``; ``()`` leaves it free."""
    match node:
        case Group(items=()):
            return ()
        case Group() if node.head == "and":
            return tuple([constraint for part in node.rest for constraint in duration(part, reader)])
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "start"):
            return duration(body, reader)
        case Group(items=(Atom() as at, Atom() as moment, _)) if (at.key, moment.key) == ("at", "end"):
            raise unsupported(node, "durations that are decided at the end", "a bound that is only known when the action ends")
        case Group() if node.head in _FORMS:
            subject, bound = operands(node, 2)
            if not isinstance(subject, Atom) or subject.key != "?duration":
                raise wrong(subject, f"expected ?duration, found {subject}")
            return (DurationConstraint(_FORMS[node.head], reader.expression(bound)),)
        case _:
            raise wrong(node, f"expected (= ?duration ...), <=, >= or and of these; found {node}")
