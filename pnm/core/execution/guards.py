"""Guards: when they open, and how a check that fails is explained.

What a guard answers depends on the state, on knowledge and on how long its own condition has been so, never on which other guards
were asked before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, assert_never
from uuid import UUID

from pnm.core.execution.call_requests import Calls
from pnm.core.execution.call_results import Explanation
from pnm.core.execution.effect_checks import already_true, may_be_late
from pnm.core.execution.questions import EvaluationContext, Questions
from pnm.core.execution.resources import Claim, RunClaims, who_keeps
from pnm.core.execution.run_state import RunState
from pnm.core.logic.conditions import All, Condition, conjuncts, ground, names
from pnm.core.logic.evaluation import evaluate, explanation, observed
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.machine import (
    Accepts,
    Adopted,
    After,
    AlreadyTrue,
    Always,
    CancelAsked,
    ConditionFalse,
    ConditionTrue,
    ConditionUnknown,
    DataMissing,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Failing,
    InvariantFalse,
    PauseAsked,
    Rule,
    Withheld,
)
from pnm.core.machine.plan_graph import Cause

NEVER: Final = float("inf")


class Guards:
    """Evaluates the guards of a run. Questions may be asked for a guard at a place; without a place only what is known counts.

    The mutable state is since when conditions have not been true, since when resources have been withheld, and which parts of an
    over-all condition have held since the call began, by transition.
    """

    def __init__(self, state: RunState, calls: Calls, claims: RunClaims, questions: Questions) -> None:
        self._state = state
        self._calls = calls
        self._claims = claims
        self._questions = questions
        self._false_since: dict[int, float] = {}
        self._withheld_since: dict[int, float] = {}
        self._held: dict[int, list[Condition]] = {}

    def opens(self, transition: int, place: int) -> float:
        """Return when the guard opens as far as is known: now or earlier, at a later time, or never by itself.

        Raises:
            Unanswered: a question has to be asked first.
        """
        state = self._state
        rule = state.index.rules[transition]
        match rule.guard:
            case Always():
                return -NEVER
            case After(seconds):
                return state.marked_at[place] + seconds
            case Ending():
                return _now_if(state.ending)
            case Failing():
                return _now_if(state.failing)
            case CancelAsked():
                return _now_if(state.cancels)
            case PauseAsked():
                return _now_if(state.suspends)
            case ConditionTrue(condition):
                return _now_if(self._holds(condition, self.context(rule.call, place)))
            case ConditionFalse(condition):
                # Not false until the report delay has passed: sensors may be about to report what has just happened.
                context = self.context(rule.call, place)
                return self._after(self._false_since, transition, not self._holds(condition, context), context.world.lag(names(condition)))
            case InvariantFalse(condition):
                return self._breaks(condition, rule.call, transition, place)
            case ConditionUnknown(condition):
                context = self.context(rule.call, place)
                truth = evaluate(_grounded(condition, context), context)
                opens = self._after(self._false_since, transition, truth is not True, context.world.lag(names(condition)))
                return opens if truth is UNKNOWN else NEVER
            case AlreadyTrue(call):
                context = self.context(call, place)
                return _now_if(already_true(self._calls.ready(call, context), context))
            case DataMissing(call):
                return _now_if(bool(self._calls.goal(call, self.context(call, place))[1]))
            case Withheld():
                # While it is not withheld, the claim is waited for without limit: some call gives back what it needs.
                is_withheld = bool(self.withheld(rule.guard, place)) and not state.pause  # a pause stops this clock
                return self._after(self._withheld_since, transition, is_withheld, rule.guard.seconds)
            case EffectsSeen(call):
                return _now_if(not self.unseen(call, place))
            case EffectsMissing(call):
                # As above: an effect counts as missing only when reports about it can no longer be on their way.
                lag = self._calls.lag_of_effects(call, self.context(call, place))
                return self._after(self._false_since, transition, bool(self.unseen(call, place)), lag)
            case Adopted(call):
                return _now_if(call in state.adopted)
            case Accepts() | Ends():
                return NEVER  # opened by a report alone, see `Run._take`
            case Due(seconds, since):
                ids = state.engine.compiled.place_id
                return max([(state.origin or 0.0) + seconds, *(state.marked_at[ids[earlier]] + delay for earlier, delay in since)])
            case _:
                assert_never(rule.guard)

    def _after(self, since: dict[int, float], transition: int, is_pending: bool, seconds: float) -> float:
        """Return when the transition has been pending for so long; `NEVER`, and from the beginning next time, if it is not."""
        if is_pending:
            return since.setdefault(transition, self._state.now) + seconds
        since.pop(transition, None)  # a condition that was true in between begins to be false anew
        return NEVER

    def _breaks(self, condition: Condition, call: int | None, transition: int, place: int) -> float:
        """Return when the over-all condition of the call counts as broken: at once, unless all that is false of it may be a late report."""
        assert call is not None, "only calls have over-all conditions"
        context, held = self.context(call, place), self._held.setdefault(transition, [])
        false: list[Condition] = []
        for part in conjuncts(_grounded(condition, context)):
            if evaluate(part, context) is not True:
                false.append(part)
            elif part not in held:
                held.append(part)
        action = self._calls.action(call)
        if not all(may_be_late(part, action, context, has_held=part in held) for part in false):
            return -NEVER
        return self._after(self._false_since, transition, bool(false), context.world.lag(names(All(tuple(false)))))

    def postpone(self, call: int | None) -> None:
        """Have the limit for the acceptance of a call's request begin anew."""
        state = self._state
        for transition in () if call is None else state.index.reported[call]:
            if isinstance(state.index.rules[transition].guard, Accepts) and state.engine.is_enabled(transition):
                state.marked_at.update({place: state.now for place, _ in state.engine.compiled.inputs[transition]})

    def forget(self, place: int) -> Iterator[UUID]:
        """Forget since when guards at the place have been waiting; yield its questions, whose answers are no longer needed."""
        # The next token at this place is a new decision, with delays that begin anew.
        if self._false_since or self._withheld_since or self._held:
            for consumer in self._state.index.choices[place]:
                self._false_since.pop(consumer, None)
                self._withheld_since.pop(consumer, None)
                self._held.pop(consumer, None)
        return self._questions.left(place)

    def context(self, call: int | None, place: int | None) -> EvaluationContext:
        """Return what guards of the call at the place are evaluated from."""
        return self._calls.context_of(call, None if place is None else self._questions.answers_at(place))

    def unseen(self, call: int, place: int | None) -> tuple[Condition, ...]:
        """Return the effects of the call that are not seen."""
        return self._calls.unseen(call, self.context(call, place))

    def _holds(self, condition: Condition, context: EvaluationContext) -> bool:
        return evaluate(_grounded(condition, context), context) is True

    # --- resources ------------------------------------------------------------------------------

    def lacks_resources(self, transition: int) -> bool:
        """Return whether the transition would be enabled if no call of the run had resources."""
        # Enabled transitions lack nothing and are included, which does no harm: they are asked in any case.
        return self._state.engine.lacking(transition) <= self._state.index.resources

    def has_resources(self, transition: int, place: int) -> bool:
        """Return whether the resources that the transition takes are free; if not, its call stands in line for them."""
        return self._claims.are_free(place, self.claim(transition, place))

    def withheld(self, guard: Withheld, place: int | None) -> Mapping[str, str]:
        """Return which resources of the call belong to requests that were given up, and the names of these requests."""
        _, action = self._calls.claiming(guard.call, guard.action, self.context(guard.call, place))
        return self._claims.withheld_from(self._calls.resources(action))

    def claim(self, transition: int, place: int | None) -> Claim:
        """Return the claim that the transition makes for its call."""
        rule = self._state.index.rules[transition]
        assert rule.call is not None, "only calls have resources"
        # The claim is made for the request that is going to be sent, so that it holds the resources from its first moment.
        request, action = self._calls.claiming(rule.call, rule.action, self.context(rule.call, place))
        return self._claims.claim(request, self._calls.resources(action))

    # --- explanations ---------------------------------------------------------------------------

    def explain(self, condition: Condition, call: int | None, place: int | None) -> tuple[str, str]:
        """Return which parts of the condition are expected and not so, and what was seen instead."""
        context = self.context(call, place)
        expected, seen = explanation(_grounded(condition, context), context)
        return expected, "; ".join(filter(None, (seen, *self._questions.silence_at(place))))

    def explain_check(self, rule: Rule, place: int | None) -> Explanation | None:
        """Return the cause that a check has found, with what was expected and what was seen; None if the rule has no cause or no check."""
        if rule.cause is None:
            return None
        match rule.guard:
            case ConditionFalse(condition) | InvariantFalse(condition):
                return Explanation(rule.cause, *self.explain(condition, rule.call, place))
            case ConditionUnknown(condition):
                return Explanation(rule.cause, f"{condition} to be true or false", self.explain(condition, rule.call, place)[1])
            case ConditionTrue(condition):
                return Explanation(rule.cause, rule.expected or f"(not {condition})", observed(condition, self.context(rule.call, place)))
            case DataMissing(call):
                context = self.context(call, place)
                missing = self._calls.goal(call, context)[1]
                why = "".join(f"; {message}" for message in (*self._questions.silence_at(place), *context.uncomputable(missing)))
                return Explanation(rule.cause, f"values for {', '.join(missing)}", f"no argument, variable or constant of that name{why}")
            case Withheld(_, seconds):
                keepers = self.withheld(rule.guard, place)
                return Explanation(rule.cause, f"{', '.join(keepers)} within {seconds:g} s", who_keeps(keepers))
            case Due(seconds):
                passed = f"{self._state.passed:g} s have passed"
                what = "a start" if rule.cause is Cause.TOO_LATE else "an end"
                return Explanation(rule.cause, f"{what} within {seconds:g} s of the plan's start", passed)
            case _:
                return None


def _grounded(condition: Condition, context: EvaluationContext) -> Condition:
    env = context.environment()
    return ground(condition, env) if env else condition


def _now_if(is_open: bool) -> float:
    return -NEVER if is_open else NEVER
