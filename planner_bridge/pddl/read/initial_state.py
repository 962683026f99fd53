"""The initial state of a PDDL problem: facts, values of functions, and what changes by itself later."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, TypeAlias

from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import CONTINGENT, counted, is_number, number, operands, time, unsupported
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Constant, Fluent, Value, show

_UNCERTAIN: Final = ("or", "oneof", "unknown")
_ASSIGNMENTS: Final = ("=", "assign")

_Change: TypeAlias = tuple[Fluent, Value]


def initial_state(parts: Iterable[Node], scope: TermScope) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    """Read what stands in ``(:init ...)``; a fact that no condition can ask for is left out."""
    init: dict[Fluent, Value] = {}
    timed: dict[float, dict[Fluent, Value]] = {}
    for part in parts:
        match part:
            # `at` may also be a predicate; only a timed literal has a number before a list
            case Group(items=(Atom(), Atom() as moment, Group() as change)) if part.head == "at" and is_number(moment):
                scope.symbols.requirements.need(part, ":timed-initial-literals", ":timed-initial-fluents")
                _put(timed.setdefault(time(moment), {}), _change(change, scope), part)
            case _:
                _put(init, _change(part, scope), part)
    true = {fluent: value for fluent, value in init.items() if value is not False}
    return true, tuple([TimedChange(moment, timed[moment]) for moment in sorted(timed) if timed[moment]])


def _change(node: Node, scope: TermScope) -> _Change | None:
    match node:
        case Group() if node.head in _ASSIGNMENTS:
            return _assignment(node, scope)
        case Group() if node.head == "not":
            (negated,) = operands(node, 1)
            fluent = _fact(negated, scope)
            return (fluent, False) if fluent else None
        case Group() if node.head in _UNCERTAIN and not scope.symbols.has_predicate(node.head):
            raise unsupported(node, f"uncertain initial states ({node.head} in :init)", CONTINGENT)
        case Group():
            fluent = _fact(node, scope)
            return (fluent, True) if fluent else None
        case _:
            raise wrong(node, f"expected a fact, (= FUNCTION VALUE) or (at TIME ...), found {node}")


def _fact(node: Node, scope: TermScope) -> Fluent | None:
    if isinstance(node, Group) and _is_idle(node, scope):
        return None
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; it follows from others and cannot be given")
    return fluent


def _is_idle(node: Group, scope: TermScope) -> bool:
    """Tell, with a warning, that no condition can ask for a fact like this."""
    if scope.symbols.is_undeclared(node):
        tolerate(node, f"the predicate {node.items[0]} is not declared; the fact is ignored")
        return True
    declared = scope.symbols.predicate(node)
    if len(node.rest) != len(declared.parameters):
        expected = counted(len(declared.parameters), "argument")
        tolerate(node, f"{declared} takes {expected}, found {len(node.rest)}; the fact is ignored")
        return True
    return False


def _assignment(node: Group, scope: TermScope) -> _Change | None:
    target, value = operands(node, 2)
    if node.head != "=":
        tolerate(node, f"'{node.head}' is read as '='")
    if scope.symbols.is_undeclared(target):
        tolerate(node, f"the function {target} is not declared; its value is ignored")
        return None
    declared = scope.symbols.function(target)
    fluent = scope.function(target)
    if not declared.values:
        return fluent, number(value)
    constant = scope.value(value, declared.values)
    if not isinstance(constant, Constant):
        raise wrong(value, f"expected an object, found {value}")
    return fluent, constant.value


def _put(found: dict[Fluent, Value], change: _Change | None, node: Node) -> None:
    if change is None:
        return
    fluent, value = change
    before = found.get(fluent, value)
    if before != value:
        if isinstance(value, bool):
            raise wrong(node, f"{show(fluent)} has another value before; expected one value")
        tolerate(node, f"{show(fluent)} has another value before; this one is used")
    elif fluent in found:
        tolerate(node, f"{show(fluent)} is there twice")
    found[fluent] = value
