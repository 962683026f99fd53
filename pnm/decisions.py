"""What the decision at a place is made from: what is known, and what was answered there; and how it is explained."""

from __future__ import annotations

from typing import Final

from pnm.calls import Calls
from pnm.conditions import Condition, evaluate, failing, ground, observed
from pnm.consultation import Consultation, Questions
from pnm.machine import DataMissing, Denied, Due, Holding, Rule
from pnm.plan_graph import Loop, PlanGraph

CHECKS: Final = frozenset({"precondition_false", "data_missing", "before", "after"})
"""What happens when a check does not hold."""


class Decision:
    """The decision that is being made.

    The mutable state is `place`, where it is made; None when only what is known counts.
    """

    def __init__(self, plan: PlanGraph, calls: Calls, questions: Questions) -> None:
        self._plan = plan
        self._calls = calls
        self._questions = questions
        self.place: int | None = None

    def consult(self, call: int | None) -> Consultation:
        """Return what a decision about the call is made from here."""
        answers = None if self.place is None else self._questions.answers_at(self.place)
        return self._calls.consult(call, answers)

    def holds(self, condition: Condition, call: int | None) -> bool:
        """Tell whether the condition is true.

        Raises:
            Unanswered: a question has to be asked first.
        """
        consulted = self.consult(call)
        return evaluate(_grounded(condition, consulted), consulted) is True

    def explain(self, condition: Condition, call: int | None) -> tuple[str, str]:
        """Return which parts of the condition are expected and not so, and what was seen instead."""
        consulted = self.consult(call)
        missing = failing(_grounded(condition, consulted), consulted)
        seen = (*(observed(part, consulted) for part in missing), *self._questions.silence_at(self.place))
        return " ".join(map(str, missing)), "; ".join(seen)

    def why(self, step: int, rule: Rule, passed: float) -> tuple[str, str, str] | None:
        """Return the cause of a failure that a check has found, with what was expected and what was seen.

        Args:
            step: what has failed.
            rule: how.
            passed: the seconds since the plan's start.
        """
        match rule.guard:
            case Denied(condition):
                return rule.name, *self.explain(condition, rule.call)
            case Holding(condition) if rule.name == "loop_limit":
                rounds = next(one.limit for one in self._plan.every_step if isinstance(one, Loop) and one.index == step)
                return rule.name, f"(not {condition}) after {rounds} rounds", observed(condition, self.consult(step))
            case Holding(condition) if rule.name in CHECKS:
                return rule.name, f"(not {condition})", observed(condition, self.consult(step))
            case DataMissing():
                missing = self._calls.goal(step, self.consult(step))[1]
                silence = self._questions.silence_at(self.place)
                why = "".join(f"; {message}" for message in (*silence, *self.consult(step).uncomputable(missing)))
                return rule.name, f"values for {', '.join(missing)}", f"no argument, variable or constant of that name{why}"
            case Due(seconds):
                return rule.name, f"an end within {seconds:g} s of the plan's start", f"{passed:g} s have passed"
            case _:
                return None


def _grounded(condition: Condition, consulted: Consultation) -> Condition:
    env = consulted.environment()
    return ground(condition, env) if env else condition
