"""Guards: when they open, and how a check that fails is explained.

What a guard answers depends on the state, on knowledge and on how long its own condition has been so, never on which other guards
were asked before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final
from uuid import UUID

from pnm.core.execution.call_requests import Calls
from pnm.core.execution.call_results import Explanation
from pnm.core.execution.effect_checks import already_true, may_be_late
from pnm.core.execution.machine_index import Firing
from pnm.core.execution.questions import EvaluationContext, Questions
from pnm.core.execution.run_state import RunState
from pnm.core.logic.conditions import All, Condition, conjuncts, ground, names
from pnm.core.logic.evaluation import evaluate, explanation, observed
from pnm.core.logic.expressions import UNKNOWN, Truth
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
from pnm.core.resources import Claim, RunClaims, who_keeps

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

    def opens(self, firing: Firing, place: int) -> float:
        """Return when the guard opens as far as is known: now or earlier, at a later time, or never by itself.

        Raises:
            Unanswered: a question has to be asked first.
        """
        return OPENS[firing.guarded](self, firing.rule.guard, firing, place)

    # each with its guard, the transition and its place

    def _always(self, _: Always, firing: Firing, place: int) -> float:
        return -NEVER

    def _wait(self, guard: After, firing: Firing, place: int) -> float:
        return self._state.marked_at[place] + guard.seconds

    def _ending(self, _: Ending, firing: Firing, place: int) -> float:
        return _now_if(self._state.ending)

    def _failing(self, _: Failing, firing: Firing, place: int) -> float:
        return _now_if(self._state.failing)

    def _cancel_asked(self, _: CancelAsked, firing: Firing, place: int) -> float:
        return _now_if(self._state.cancels)

    def _pause_asked(self, _: PauseAsked, firing: Firing, place: int) -> float:
        return _now_if(self._state.suspends)

    def _true(self, guard: ConditionTrue, firing: Firing, place: int) -> float:
        return -NEVER if self._truth(guard.condition, firing, place) is True else NEVER

    def _false(self, guard: ConditionFalse, firing: Firing, place: int) -> float:
        # Not false until the report delay has passed: sensors may be about to report what has just happened.
        is_false = self._truth(guard.condition, firing, place) is not True
        return self._after(self._false_since, firing.number, place, is_false, self._lag(guard.condition) if is_false else 0.0)

    def _unknown(self, guard: ConditionUnknown, firing: Firing, place: int) -> float:
        truth = self._truth(guard.condition, firing, place)
        opens = self._after(self._false_since, firing.number, place, truth is not True, self._lag(guard.condition))
        return opens if truth is UNKNOWN else NEVER

    def _invariant_false(self, guard: InvariantFalse, firing: Firing, place: int) -> float:
        return self._breaks(guard.condition, firing.rule.call, firing.number, place)

    def _already_true(self, guard: AlreadyTrue, firing: Firing, place: int) -> float:
        closed = self._state.index.closed[guard.call]
        if closed is not None and closed.effects is not None:
            return -NEVER if closed.effects.are_done(self._calls.world) else NEVER
        context = self.context(guard.call, place)
        return _now_if(already_true(self._calls.ready(guard.call, context), context))

    def _data_missing(self, guard: DataMissing, firing: Firing, place: int) -> float:
        if self._calls.own_goal(guard.call) is not None:
            return NEVER
        return _now_if(bool(self._calls.goal(guard.call, self.context(guard.call, place))[1]))

    def _withheld(self, guard: Withheld, firing: Firing, place: int) -> float:
        # While it is not withheld, the claim is waited for without limit: some call gives back what it needs.
        is_withheld = bool(self.withheld(guard, place)) and not self._state.pause  # a pause stops this clock
        return self._after(self._withheld_since, firing.number, place, is_withheld, guard.seconds)

    def _effects_seen(self, guard: EffectsSeen, firing: Firing, place: int) -> float:
        return _now_if(self._calls.shows_nothing(guard.call) or not self.unseen(guard.call, place))

    def _effects_missing(self, guard: EffectsMissing, firing: Firing, place: int) -> float:
        # As above: an effect counts as missing only when reports about it can no longer be on their way.
        lag = self._calls.lag_of_effects(guard.call, self.context(guard.call, place))
        return self._after(self._false_since, firing.number, place, bool(self.unseen(guard.call, place)), lag)

    def _adopted(self, guard: Adopted, firing: Firing, place: int) -> float:
        return _now_if(guard.call in self._state.adopted)

    def _reported(self, _: Accepts | Ends, firing: Firing, place: int) -> float:
        return NEVER  # opened by a report alone, see `Run._take`

    def _due(self, guard: Due, firing: Firing, place: int) -> float:
        state = self._state
        return max([(state.origin or 0.0) + guard.seconds, *(state.marked_at[earlier] + delay for earlier, delay in firing.since)])

    def _truth(self, condition: Condition, firing: Firing, place: int) -> Truth:
        known = firing.condition
        if known is not None and not known.reads_variables:
            return known.truth(self._calls.world)
        context = self.context(firing.rule.call, place)
        return evaluate(_grounded(condition, context), context) if known is None else known.truth(context)

    def _lag(self, condition: Condition) -> float:
        return self._calls.world.lag(names(condition))

    def _after(self, since: dict[int, float], transition: int, place: int, is_pending: bool, seconds: float) -> float:
        """Return when the transition has been pending for so long; `NEVER`, and from the beginning next time, if it is not."""
        if is_pending:
            self._questions.noted.add(place)
            return since.setdefault(transition, self._state.now) + seconds
        since.pop(transition, None)  # a condition that was true in between begins to be false anew
        return NEVER

    def _breaks(self, condition: Condition, call: int | None, transition: int, place: int) -> float:
        """Return when the over-all condition of the call counts as broken: at once, unless all that is false of it may be a late report."""
        assert call is not None, "only calls have over-all conditions"
        context, held = self.context(call, place), self._held.setdefault(transition, [])
        self._questions.noted.add(place)
        false: list[Condition] = []
        for part in conjuncts(_grounded(condition, context)):
            if evaluate(part, context) is not True:
                false.append(part)
            elif part not in held:
                held.append(part)
        action = self._calls.action(call)
        if not all(may_be_late(part, action, context, has_held=part in held) for part in false):
            return -NEVER
        return self._after(self._false_since, transition, place, bool(false), context.world.lag(names(All(tuple(false)))))

    def postpone(self, call: int | None) -> None:
        """Have the limit for the acceptance of a call's request begin anew."""
        state = self._state
        for number, place in () if call is None else state.index.opened[call, None]:
            if state.engine.is_enabled(number):
                state.marked_at[place] = state.now

    def forget(self, place: int) -> Iterator[UUID]:
        """Forget since when guards at the place have been waiting; yield its questions, whose answers are no longer needed."""
        self._questions.noted.discard(place)
        # The next token at this place is a new decision, with delays that begin anew.
        for number in self._state.index.places[place].numbers:
            self._false_since.pop(number, None)
            self._withheld_since.pop(number, None)
            self._held.pop(number, None)
        return self._questions.left(place)

    def context(self, call: int | None, place: int | None) -> EvaluationContext:
        """Return what guards of the call at the place are evaluated from."""
        return self._calls.context_of(call, self._questions.answers_at(place))

    def unseen(self, call: int, place: int | None) -> tuple[Condition, ...]:
        """Return the effects of the call that are not seen."""
        return self._calls.unseen(call, self.context(call, place))

    # --- resources ------------------------------------------------------------------------------

    def lacks_resources(self, transition: int) -> bool:
        """Return whether the transition would be enabled if no call of the run had resources."""
        # Enabled transitions lack nothing and are included, which does no harm: they are asked in any case.
        return self._state.engine.lacking(transition) <= self._state.index.resources

    def has_resources(self, firing: Firing, place: int) -> bool:
        """Return whether the resources that the transition takes are free; if not, its call stands in line for them."""
        return self._claims.are_free(place, self.claim(firing, place))

    def withheld(self, guard: Withheld, place: int | None) -> Mapping[str, str]:
        """Return which resources of the call belong to requests that were given up, and the names of these requests."""
        _, action = self._calls.claiming(guard.call, guard.action, self.context(guard.call, place))
        return self._claims.withheld_from(self._calls.resources(action))

    def claim(self, firing: Firing, place: int | None) -> Claim:
        """Return the claim that the transition makes for its call."""
        rule = firing.rule
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


OPENS: Final[Mapping[type, Callable[[Guards, Any, Firing, int], float]]] = {
    Always: Guards._always,
    After: Guards._wait,
    Ending: Guards._ending,
    Failing: Guards._failing,
    CancelAsked: Guards._cancel_asked,
    PauseAsked: Guards._pause_asked,
    ConditionTrue: Guards._true,
    ConditionFalse: Guards._false,
    ConditionUnknown: Guards._unknown,
    InvariantFalse: Guards._invariant_false,
    AlreadyTrue: Guards._already_true,
    DataMissing: Guards._data_missing,
    Withheld: Guards._withheld,
    EffectsSeen: Guards._effects_seen,
    EffectsMissing: Guards._effects_missing,
    Adopted: Guards._adopted,
    Accepts: Guards._reported,
    Ends: Guards._reported,
    Due: Guards._due,
}
"""For every kind of guard, when it opens."""
