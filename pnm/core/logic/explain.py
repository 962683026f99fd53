"""Explanations for people: which conjuncts of a condition fail, and which values the state has instead."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Protocol

from pnm.core.logic.computed_values import MISSING, Answers, Data, Parameter, Query, Unanswered, compute, parts
from pnm.core.logic.conditions import Computed, Condition, conjuncts, fluents
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Fluent, State, Unknown, ValueOf, fluent_text
from pnm.core.logic.operators import Uncomputable


class Witness(State, Protocol):
    """A state that can explain its derived facts."""

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact has its truth, to be read after that; empty for a recorded fluent."""


def explanation(condition: Condition, state: Witness) -> tuple[str, str]:
    """Return which conjuncts are expected and not so, and what is observed instead.

    A conjunct that depends on a question that was never asked is no reason, unless there is no other. To decide whether
    a condition holds is for `pnm.core.logic.evaluation`: it has such questions asked.
    """
    parts = conjuncts(condition)
    failed = []
    for part in parts:
        with suppress(Unanswered):
            if evaluate(part, state) is not True:
                failed.append(part)
    return " ".join(map(str, failed or parts)), "; ".join(observed(part, state) for part in failed or parts)


def observed(condition: Condition, state: Witness) -> str:
    """Return the value of each fluent in the condition, and why it has it if it is derived."""
    if isinstance(condition, Computed) and isinstance(state, Answers):
        return _observed_values(condition.data, state)
    return ", ".join(sorted(_observed_fluent(fluent, state) for fluent in fluents(condition, state))) or "no fluent involved"


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


def _observed_values(data: Data, answers: Answers) -> str:
    """Return the values of the queries, parameters and fluents in the data, without those that cannot be computed."""
    texts: dict[str, None] = {}
    for part in parts(data):
        if isinstance(part, Query | ValueOf | Parameter):
            name = fluent_text(part.fluent) if isinstance(part, ValueOf) else str(part)
            try:
                value = compute(part, answers)
            except (Unanswered, Uncomputable):
                continue
            texts[f"{name} is {'missing' if value is MISSING else json.dumps(value, ensure_ascii=False, default=str)}"] = None
    return ", ".join(texts) or "no variable involved"
