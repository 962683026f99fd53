"""The decision at a place: what it is made from, when guards open, and how it is explained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, assert_never
from uuid import UUID

from pnm.core.execution.call_requests import Calls, UnderWay
from pnm.core.execution.call_results import Explanation
from pnm.core.execution.effect_checks import already_true
from pnm.core.execution.questions import Consultation, Questions
from pnm.core.execution.resources import Claim, Claims, who_keeps
from pnm.core.execution.run_state import Situation
from pnm.core.logic.conditions import Condition, ground, names
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.explain import failing, observed
from pnm.core.machine.machine import (
    Accepts,
    Adopted,
    After,
    AlreadyTrue,
    Always,
    CancelAsked,
    DataMissing,
    Denied,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Failing,
    Holding,
    PauseAsked,
    Rule,
    Withheld,
)

NEVER: Final = float("inf")


class Decision:
    """The decision that is being made.

    The mutable state is what the constructor sets under "state".
    """

    def __init__(self, situation: Situation, calls: Calls, claims: Claims, questions: Questions, adopted: Mapping[int, UnderWay]) -> None:
        self._situation = situation
        self._calls = calls
        self._claims = claims
        self._questions = questions
        # state
        self.place: int | None = None
        """Where it is made; None when only what is known counts."""
        self.adopted = dict(adopted)
        """Requests of another run that are still to be taken over, by call."""
        self.arrived: dict[int, float] = {}
        """When places were marked."""
        self.missing: dict[int, tuple[str, ...]] = {}
        """For every call, the effects that were not seen when they were last looked for."""
        self._denied_since: dict[int, float] = {}
        self._withheld_since: dict[int, float] = {}

    def opens(self, transition: int, place: int) -> float:
        """Return when the guard opens as far as is known: now or earlier, at a later time, or never by itself.

        Raises:
            Unanswered: a question has to be asked first.
        """
        rule, situation = self._situation.roles.rules[transition], self._situation
        match rule.guard:
            case Always():
                return -NEVER
            case Ending():
                return _now_if(situation.ending)
            case Failing():
                return _now_if(situation.failing)
            case CancelAsked():
                return _now_if(situation.cancels)
            case PauseAsked():
                return _now_if(situation.suspends)
            case Holding(condition):
                return _now_if(self.holds(condition, rule.call))
            case Denied(condition):
                return self._denied(transition, self.holds(condition, rule.call), self.consult(rule.call).world.lag(names(condition)))
            case AlreadyTrue(call):
                consulted = self.consult(call)
                return _now_if(already_true(self._calls.ready(call, consulted), consulted))
            case DataMissing(call):
                return _now_if(bool(self._calls.goal(call, self.consult(call))[1]))
            case Withheld():
                return self._withheld(transition, bool(self.withheld(rule.guard)), rule.guard.seconds)
            case EffectsSeen(call):
                self.missing[call] = self._calls.unseen(call, self.consult(call))
                return _now_if(not self.missing[call])
            case EffectsMissing(call):
                return self._denied(transition, not self.missing[call], self._calls.lag_of_effects(call, self.consult(call)))
            case Adopted(call):
                return _now_if(call in self.adopted)
            case Accepts() | Ends():
                return NEVER
            case After(seconds):
                return self.arrived[place] + seconds
            case Due(seconds, since):
                ids = situation.engine.compiled.place_id
                return max([(situation.origin or 0.0) + seconds, *(self.arrived[ids[one]] + delay for one, delay in since)])
            case _:
                assert_never(rule.guard)

    def _denied(self, transition: int, holds: bool, lag: float) -> float:
        if holds:
            self._denied_since.pop(transition, None)
            return NEVER
        return self._denied_since.setdefault(transition, self._situation.now) + lag

    def lacks_resources(self, transition: int) -> bool:
        """Tell whether the transition would be enabled if no call of the run had what it needs for itself."""
        return self._situation.engine.lacking(transition) <= self._situation.roles.resources

    def has_resources(self, transition: int, place: int) -> bool:
        """Tell whether the call can have what the transition needs for it; if not, it waits for that."""
        return self._claims.are_free(place, self.claim(transition))

    def withheld(self, guard: Withheld) -> Mapping[str, str]:
        """Return which resources the call could not have until the end of requests is known that were given up, and theirs."""
        _, action = self._calls.claiming(guard.call, guard.action, self.consult(guard.call))
        return self._claims.withheld_from(self._calls.resources(action))

    def claim(self, transition: int) -> Claim:
        """Return what the transition needs for its call."""
        rule = self._situation.roles.rules[transition]
        assert rule.call is not None, "only calls have resources"
        request, action = self._calls.claiming(rule.call, rule.action, self.consult(rule.call))
        return self._claims.claim(request, self._calls.resources(action))

    def _withheld(self, transition: int, is_so: bool, seconds: float) -> float:
        if not is_so or self._situation.pause:  # during which nothing is waited for
            self._withheld_since.pop(transition, None)
            return NEVER
        return self._withheld_since.setdefault(transition, self._situation.now) + seconds

    def left(self, place: int) -> Iterator[UUID]:
        """Forget what the decision at the place was made from; yield the questions whose answers are no longer needed."""
        for consumer, _ in self._situation.engine.compiled.consumers[place]:
            self._denied_since.pop(consumer, None)
            self._withheld_since.pop(consumer, None)
        return self._questions.left(place)

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

    def explain_check(self, rule: Rule) -> Explanation | None:
        """Return the cause that a check has found, with what was expected and what was seen; None if the rule has no cause or no check."""
        if rule.cause is None:
            return None
        match rule.guard:
            case Denied(condition):
                return Explanation(rule.cause, *self.explain(condition, rule.call))
            case Holding(condition):
                return Explanation(rule.cause, rule.expected or f"(not {condition})", observed(condition, self.consult(rule.call)))
            case DataMissing(call):
                consulted = self.consult(call)
                missing = self._calls.goal(call, consulted)[1]
                why = "".join(f"; {message}" for message in (*self._questions.silence_at(self.place), *consulted.uncomputable(missing)))
                return Explanation(rule.cause, f"values for {', '.join(missing)}", f"no argument, variable or constant of that name{why}")
            case Withheld(_, seconds):
                keepers = self.withheld(rule.guard)
                return Explanation(rule.cause, f"{', '.join(keepers)} within {seconds:g} s", who_keeps(keepers))
            case Due(seconds):
                passed = f"{self._situation.passed:g} s have passed"
                return Explanation(rule.cause, f"an end within {seconds:g} s of the plan's start", passed)
            case _:
                return None


def _grounded(condition: Condition, consulted: Consultation) -> Condition:
    env = consulted.environment()
    return ground(condition, env) if env else condition


def _now_if(is_open: bool) -> float:
    return -NEVER if is_open else NEVER
