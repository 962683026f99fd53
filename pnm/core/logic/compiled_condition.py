"""Ground conditions as functions of a state: the same truth as `pnm.core.logic.evaluation.evaluate`, without walking through it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from pnm.core.logic.conditions import All, Condition, Holds, Not, conjuncts, data_in
from pnm.core.logic.evaluation import evaluate, negate
from pnm.core.logic.expressions import UNKNOWN, Fluent, State, Truth

TruthIn: TypeAlias = Callable[[State], Truth]


class CompiledCondition(NamedTuple):
    """A condition without free variables as a function."""

    truth: TruthIn
    reads_variables: bool
    """Whether it reads anything but facts and numbers."""

    def holds_by_facts(self, state: State) -> bool:
        """Return whether facts and numbers alone decide that it holds."""
        return not self.reads_variables and self.truth(state) is True


def compiled(condition: Condition) -> CompiledCondition:
    """Return what tells the truth of a condition without free variables in a state; raises what `evaluate` raises."""
    parts = conjuncts(condition)
    if (facts := _facts_only(parts)) is not None:
        return CompiledCondition(_all_facts(facts), reads_variables=False)
    truth = _truth_of(parts[0]) if len(parts) == 1 else _all_parts(tuple(map(_truth_of, parts)))
    return CompiledCondition(truth, any(True for _ in data_in(condition)))


def _facts_only(parts: tuple[Condition, ...]) -> tuple[Fluent, ...] | None:
    facts: list[Fluent] = []
    for part in parts:
        if not isinstance(part, Holds):
            return None
        facts.append(part.fluent)
    return tuple(facts)


def _truth_of(condition: Condition) -> TruthIn:
    match condition:
        case Holds(fluent):
            return lambda state: value if (value := state.value(fluent)) is UNKNOWN else bool(value)
        case Not(operand):
            truth = _truth_of(operand)
            return lambda state: negate(truth(state))
        case All():
            return compiled(condition).truth
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
