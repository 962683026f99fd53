"""Explanations for people: which conjuncts of a condition fail, and which values the state has instead."""

from __future__ import annotations

import json
from typing import Protocol

from pnm.core.logic.computed_values import MISSING, Answers, Data, Parameter, Query, Unanswered, compute, parts
from pnm.core.logic.conditions import Computed, Condition, conjuncts, fluents
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import (
    UNKNOWN,
    Fluent,
    State,
    Unknown,
    Value,
    ValueOf,
    fluent_text,
)
from pnm.core.logic.operators import Uncomputable


def failing(condition: Condition, state: State) -> tuple[Condition, ...]:
    """Return the conjuncts that do not hold in the state: what was expected and is not so.

    Those that nobody had to ask about, because others did not hold, are not among them.
    """
    return tuple(part for part in conjuncts(condition) if _fails(part, state))


def _fails(condition: Condition, state: State) -> bool:
    try:
        return evaluate(condition, state) is not True
    except Unanswered:
        return False


class Witness(State, Protocol):
    """A state that can also say why it has the derived facts it has."""

    def because(self, fluent: Fluent, /) -> str:
        """Say why the fluent has its value, to be read after that; empty for what is recorded and nothing more."""


def observed(condition: Condition, state: Witness) -> str:
    """Say what the state has in place of the condition: the value of each fluent in it, and why if it is derived."""
    if isinstance(condition, Computed) and isinstance(state, Answers):
        return observed_values(condition.data, state)
    said = sorted(_told(fluent, state) for fluent in fluents(condition, state))
    return ", ".join(said) or "no fluent involved"


def _told(fluent: Fluent, state: Witness) -> str:
    reason = state.because(fluent)
    return f"{fluent_text(fluent)} is {_say(state.value(fluent))}{' ' if reason else ''}{reason}"


def _say(value: Value | Unknown | None) -> str:
    if value is UNKNOWN:
        return "unknown"
    return "false" if value is None else str(value).lower() if isinstance(value, bool) else f"{value}"


def observed_values(data: Data, answers: Answers) -> str:
    """Say what the queries and fluents in the data have for values."""
    said: dict[str, None] = {}
    for part in parts(data):
        if isinstance(part, Query | ValueOf | Parameter):
            name = fluent_text(part.fluent) if isinstance(part, ValueOf) else str(part)
            try:
                found = compute(part, answers)
            except (Unanswered, Uncomputable):
                continue
            said[f"{name} is {'missing' if found is MISSING else json.dumps(found, ensure_ascii=False, default=str)}"] = None
    return ", ".join(said) or "no variable involved"
