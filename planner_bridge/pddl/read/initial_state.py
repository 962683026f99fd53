"""The initial state of a PDDL problem: facts, values of functions, and timed initial literals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from planner_bridge.pddl.read.requirements import REFUSED_IN_INIT, Leniency
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, wrong
from planner_bridge.pddl.syntax.words import is_number, number, operands, time
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Constant, Fluent, Value, fluent_text
from pnm.errors import counted

_Change: TypeAlias = tuple[Fluent, Value]


def initial_state(parts: Iterable[Node], scope: TermScope) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    """Read ``(:init ...)``: the state at first, without false facts, and the timed changes by time."""
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
    """Return a fluent and its value; None for one that no condition can read."""
    match node:
        case Group() if node.head in ("=", "assign"):
            target, value = operands(node, 2)
            if node.head != "=":
                Leniency.ASSIGN_IN_INIT.note(node, node.head)
            if scope.symbols.is_undeclared(target):
                Leniency.VALUE_UNDECLARED.note(node, target)
                return None
            declared = scope.symbols.function(target)
            fluent = scope.function(target)
            if not declared.values:
                return fluent, number(value)
            constant = scope.value(value, declared.values)
            if not isinstance(constant, Constant):
                raise wrong(value, f"expected an object, found {value}")
            return fluent, constant.value
        case Group() if node.head == "not":
            (negated,) = operands(node, 1)
            fact = _fact(negated, scope)
            return (fact, False) if fact else None
        case Group() if node.head in REFUSED_IN_INIT and not scope.symbols.has_predicate(node.head):
            raise REFUSED_IN_INIT[node.head].at(node)
        case Group():
            fact = _fact(node, scope)
            return (fact, True) if fact else None
        case _:
            raise wrong(node, f"expected a fact, (= FUNCTION VALUE) or (at TIME ...), found {node}")


def _fact(node: Node, scope: TermScope) -> Fluent | None:
    """Return a fact; None, with a warning, if it is not declared with these arguments."""
    if isinstance(node, Group):
        if scope.symbols.is_undeclared(node):
            Leniency.FACT_UNDECLARED.note(node, node.items[0])
            return None
        declared = scope.symbols.predicate(node)
        if len(node.rest) != len(declared.parameters):
            Leniency.FACT_ARITY.note(node, declared, counted(len(declared.parameters), "argument"), len(node.rest))
            return None
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; it follows from others and cannot be given")
    return fluent


def _put(state: dict[Fluent, Value], change: _Change | None, node: Node) -> None:
    if change is None:
        return
    fluent, value = change
    before = state.get(fluent, value)
    if before != value:
        if isinstance(value, bool):
            raise wrong(node, f"{fluent_text(fluent)} has another value before; expected one value")
        Leniency.VALUE_TWICE.note(node, fluent_text(fluent))
    elif fluent in state:
        Leniency.FACT_TWICE.note(node, fluent_text(fluent))
    state[fluent] = value
