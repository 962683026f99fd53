"""Ground conditions as functions of a state: the same truth as `pnm.core.logic.evaluation.evaluate`, without walking through it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from pnm.core.logic.conditions import All, Condition, Holds, Not, conjuncts
from pnm.core.logic.evaluation import evaluate, negate
from pnm.core.logic.expressions import UNKNOWN, Fluent, State, Truth

TruthIn: TypeAlias = Callable[[State], Truth]


def compiled(condition: Condition) -> TruthIn:
    """Return what tells the truth of a condition without free variables in a state; raises what `evaluate` raises."""
    match condition:
        case Holds(fluent):
            return lambda state: value if (value := state.value(fluent)) is UNKNOWN else bool(value)
        case Not(operand):
            truth = compiled(operand)
            return lambda state: negate(truth(state))
        case All():
            parts = conjuncts(condition)
            facts = tuple(part.fluent for part in parts if isinstance(part, Holds))
            return _all_facts(facts) if len(facts) == len(parts) else _all_parts(tuple(map(compiled, parts)))
        case _:
            return lambda state: evaluate(condition, state)


def _all_facts(fluents: tuple[Fluent, ...]) -> TruthIn:
    def hold(state: State) -> Truth:
        result: Truth = True
        for fluent in fluents:
            value = state.value(fluent)
            if value is UNKNOWN:
                result = UNKNOWN
            elif not value:
                return False
        return result

    return hold


def _all_parts(parts: tuple[TruthIn, ...]) -> TruthIn:
    def hold(state: State) -> Truth:
        result: Truth = True
        for part in parts:
            truth = part(state)
            if truth is False:
                return False
            if truth is UNKNOWN:
                result = UNKNOWN
        return result

    return hold
