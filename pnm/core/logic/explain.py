"""Explanations for people: which conjuncts of a condition fail, and which values the state has instead."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Protocol

from pnm.core.logic.computed_values import MISSING, Answers, Parameter, Query, Unanswered, compute, parts
from pnm.core.logic.conditions import Computed, Condition, conjuncts, fluents
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Fluent, State, Unknown, ValueOf, fluent_text
from pnm.core.logic.operators import Uncomputable


def failing(condition: Condition, state: State) -> tuple[Condition, ...]:
    """Return the conjuncts that do not hold in the state, without those that depend on a question that was never asked."""
    failed = []
    for part in conjuncts(condition):
        with suppress(Unanswered):
            if evaluate(part, state) is not True:
                failed.append(part)
    return tuple(failed)


class Witness(State, Protocol):
    """A state that can explain its derived facts."""

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact has its truth, to be read after that; empty for a recorded fluent."""


def observed(condition: Condition, state: Witness) -> str:
    """Return the value of each fluent in the condition, and why it has it if it is derived; of a computed condition, of what it reads."""
    if not isinstance(condition, Computed) or not isinstance(state, Answers):
        return ", ".join(sorted(_observed_fluent(fluent, state) for fluent in fluents(condition, state))) or "no fluent involved"
    texts: dict[str, None] = {}
    for part in parts(condition.data):
        if isinstance(part, Query | ValueOf | Parameter):
            name = fluent_text(part.fluent) if isinstance(part, ValueOf) else str(part)
            with suppress(Unanswered, Uncomputable):
                value = compute(part, state)
                texts[f"{name} is {'missing' if value is MISSING else json.dumps(value, ensure_ascii=False, default=str)}"] = None
    return ", ".join(texts) or "no variable involved"


def _observed_fluent(fluent: Fluent, state: Witness) -> str:
    value, reason = state.value(fluent), state.because(fluent)
    match value:
        case None | bool():
            text = "true" if value else "false"
        case Unknown():
            text = "unknown"
        case _:
            text = str(value)
    return f"{fluent_text(fluent)} is {text}{' ' if reason else ''}{reason}"
