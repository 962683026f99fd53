"""Guards: when they open, and how a check that fails is explained.

What a guard answers depends on the state, on knowledge and on how long its own condition has been so, never on which other guards
were asked before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final, assert_never
from uuid import UUID

from pnm.core.execution.call_data import already_true, ready
from pnm.core.execution.call_requests import Calls
from pnm.core.execution.call_results import Explanation
from pnm.core.execution.machine_index import Firing, Site
from pnm.core.execution.questions import EvaluationContext, Questions
from pnm.core.execution.run_state import RunState
from pnm.core.kept_state import KeptState
from pnm.core.logic.conditions import Condition, evaluate, explanation, ground, names, observed
from pnm.core.logic.expressions import UNKNOWN, Truth
from pnm.core.machine import guards
from pnm.core.machine.failure_causes import Cause
from pnm.core.resources import Claim, RunClaims, who_keeps

NEVER: Final = float("inf")


class Guards(KeptState):
    """Evaluates the guards of a run. Questions may be asked for a guard at a place; without a place only what is known counts.

    The mutable state is, by transition, since when its guard would be open but for a delay.
    """

    KEPT = ("_since",)

    def __init__(self, state: RunState, calls: Calls, claims: RunClaims[int], questions: Questions[int]) -> None:
        self.state, self._calls, self._claims, self._questions = state, calls, claims, questions
        self._since: dict[int, float] = {}

    def waits_until(self, site: Site, firing: Firing, place: int) -> float:
        """Return when a transition opens that only waits."""
        guard = self.state.index.guard(site, firing)
        assert isinstance(guard, guards.After)
        return self.state.marked_at[place] + guard.seconds

    def _not_true(self, site: Site, firing: Firing, place: int) -> float:
        # Not before the report delay has passed: sensors may be about to report what has just happened.
        truth = self.truth(site, firing, place)
        lag = 0.0 if truth is True else self._calls.world.lag(names(self._asked(site, firing)))
        opens = self._after(site, firing, place, truth is not True, lag)
        return opens if truth is UNKNOWN or firing.guarded is guards.ConditionFalse else NEVER

    def _invariant_false(self, site: Site, firing: Firing, place: int) -> float:
        call, now = _call(site, firing), self.state.now
        known, attempt = self.state.index.conditions[site.transition + firing.number], self._calls.attempts[call]
        if known is not None and known.holds_by_facts(self._calls.world):
            attempt.held = None
            attempt.broken.clear()
            return NEVER
        return attempt.breaks(self._asked(site, firing), self.context(call, place), now)

    def _already_true(self, site: Site, firing: Firing, place: int) -> float:
        call = _call(site, firing)
        closed = self.state.index.closed[call]
        if closed is not None and closed.effects is not None:
            return -NEVER if closed.effects.are_done(self._calls.world) else NEVER
        context = self.context(call, place)
        return _now_if(already_true(ready(context.action, context), context))

    def _data_missing(self, site: Site, firing: Firing, place: int) -> float:
        call = _call(site, firing)
        if self._calls.own_goal(call) is not None:
            return NEVER
        return _now_if(bool(self._calls.goal(call, self.context(call, place))[1]))

    def _withheld(self, site: Site, firing: Firing, place: int) -> float:
        # While it is not withheld, the claim is waited for without limit: some call gives back what it needs.
        guard = self.state.index.guard(site, firing)
        assert isinstance(guard, guards.Withheld)
        is_withheld = bool(self.withheld(_call(site, firing), guard, place))
        is_withheld = is_withheld and not self.state.pause and not self.in_hands(site, firing, place)  # a pause stops this clock
        return self._after(site, firing, place, is_withheld, guard.seconds)

    def _late(self, site: Site, firing: Firing, place: int) -> float:
        guard = self.state.index.guard(site, firing)
        assert isinstance(guard, guards.Late)
        return self._after(site, firing, place, not self.state.pause, guard.seconds)  # a pause stops this clock

    def _effects_seen(self, site: Site, firing: Firing, place: int) -> float:
        call = _call(site, firing)
        if self._calls.shows_nothing(call):
            return -NEVER
        return self._calls.attempts[call].seen(self.context(call, place), self.state.marked_at[place])

    def _effects_missing(self, site: Site, firing: Firing, place: int) -> float:
        # As above: an effect counts as missing only when reports about it can no longer be on their way.
        attempt, context = self._calls.attempts[_call(site, firing)], self.context(_call(site, firing), place)
        return self._after(site, firing, place, bool(attempt.unseen(context)), attempt.lag(context))

    def _due(self, site: Site, firing: Firing, place: int) -> float:
        state, guard = self.state, self.state.index.guard(site, firing)
        assert isinstance(guard, guards.Due)
        since = state.index.since[site.transition + firing.number]
        return max([(state.origin or 0.0) + guard.seconds, *(state.marked_at[earlier] + delay for earlier, delay in since)])

    def truth(self, site: Site, firing: Firing, place: int) -> Truth:
        """Return the truth of the condition that the guard asks for."""
        known = self.state.index.conditions[site.transition + firing.number]
        if known is not None and not known.reads_variables:
            return known.truth(self._calls.world)
        context = self.context(site.step_of(firing), place)
        return evaluate(_grounded(self._asked(site, firing), context), context) if known is None else known.truth(context)

    def _asked(self, site: Site, firing: Firing) -> Condition:
        """Return the condition that the guard asks for."""
        condition = self.state.index.guard(site, firing).asks
        assert condition is not None, "only such guards come here"
        return condition

    def _after(self, site: Site, firing: Firing, place: int, is_pending: bool, seconds: float) -> float:
        """Return when the transition has been pending for so long; `NEVER`, and from the beginning next time, if it is not."""
        transition = site.transition + firing.number
        if is_pending:
            self._questions.noted.add(place)
            return self._since.setdefault(transition, self.state.now) + seconds
        self._since.pop(transition, None)  # a condition that was true in between begins to be false anew
        return NEVER

    def postpone(self, call: int | None) -> None:
        """Have the limit for the acceptance of a call's request begin anew."""
        if call is None:
            return
        state, site = self.state, self.state.index.of_calls[call]
        for firing in site.shape.opened[None]:
            if state.engine.is_enabled(site.transition + firing.number):
                state.marked_at[site.place + firing.inputs[0]] = state.now

    def forget(self, place: int) -> Iterator[UUID]:
        """Forget since when guards at the place have been waiting; yield its questions, whose answers are no longer needed."""
        self._questions.noted.discard(place)
        # The next token at this place is a new decision, with delays that begin anew.
        index = self.state.index
        for within in index.decision(place).numbers:
            self._since.pop(index.sites[place].transition + within, None)
        return self._questions.left(place)

    def context(self, call: int | None, place: int | None) -> EvaluationContext:
        """Return the knowledge for the guards of the call at the place."""
        return self._calls.context_of(call, self._questions.answers_at(place))

    # --- resources ------------------------------------------------------------------------------

    def lacks_resources(self, transition: int) -> bool:
        """Return whether the transition would be enabled if no call of the run had resources."""
        # Enabled transitions lack nothing and are included, which does no harm: they are asked in any case.
        return self.state.engine.lacking(transition) <= self.state.index.resources.keys()

    def in_hands(self, site: Site, firing: Firing, place: int | None) -> str:
        """Return what people have in their hands that the transition needs for its call; empty if there is nothing."""
        if not self.state.hands:
            return ""
        call, rule = _call(site, firing), self.state.index.guard(site, firing)
        action = rule.action if isinstance(rule, guards.Withheld) else firing.action
        return self._calls.named(call, action, self.context(call, place), self.state.hands)

    def has_resources(self, site: Site, firing: Firing, place: int) -> bool:
        """Return whether the resources that the transition takes are free; if not, its call stands in line for them."""
        return self._claims.are_free(place, self.claim(site, firing, place))

    def withheld(self, call: int, guard: guards.Withheld, place: int | None) -> Mapping[str, str]:
        """Return which resources of the call belong to requests that were given up, and the names of these requests."""
        _, action = self._calls.claiming(call, guard.action, self.context(call, place))
        return self._claims.resources.withheld_from(self._calls.bindings.resources(action))

    def claim(self, site: Site, firing: Firing, place: int | None) -> Claim:
        """Return the claim that the transition makes for its call."""
        # The claim is made for the request that is going to be sent, so that it holds the resources from its first moment.
        call = _call(site, firing)
        request, action = self._calls.claiming(call, firing.action, self.context(call, place))
        return self._claims.claim(request, self._calls.bindings.resources(action))

    # --- explanations ---------------------------------------------------------------------------

    def explain(self, condition: Condition, call: int | None, place: int | None) -> tuple[str, str]:
        """Return which parts of the condition are expected and not so, and what was seen instead."""
        context = self.context(call, place)
        expected, seen = explanation(_grounded(condition, context), context)
        return expected, "; ".join(filter(None, (seen, *self._questions.silence_at(place))))

    def explain_check(self, rule: guards.Rule, place: int | None) -> Explanation | None:
        """Return the cause that a check has found, with what was expected and what was seen; None if the rule has no cause or no check."""
        if rule.cause is None:
            return None
        match rule.guard:
            case guards.ConditionFalse(condition) | guards.InvariantFalse(condition):
                return Explanation(rule.cause, *self.explain(condition, rule.call, place))
            case guards.ConditionUnknown(condition):
                return Explanation(rule.cause, f"{condition} to be true or false", self.explain(condition, rule.call, place)[1])
            case guards.ConditionTrue(condition):
                return Explanation(rule.cause, rule.expected or f"(not {condition})", observed(condition, self.context(rule.call, place)))
            case guards.DataMissing(call):
                context = self.context(call, place)
                missing = self._calls.goal(call, context)[1]
                why = "".join(f"; {message}" for message in (*self._questions.silence_at(place), *context.uncomputable(missing)))
                return Explanation(rule.cause, f"values for {', '.join(missing)}", f"no argument, variable or constant of that name{why}")
            case guards.Withheld(_, seconds):
                keepers = self.withheld(rule.guard.call, rule.guard, place)
                return Explanation(rule.cause, f"{', '.join(keepers)} within {seconds:g} s", who_keeps(keepers))
            case guards.Late(seconds, condition):
                expected, seen = self.explain(condition, rule.call, place)
                return Explanation(rule.cause, f"{expected} within {seconds:g} s", seen)
            case guards.Due(seconds):
                passed = f"{self.state.passed:g} s have passed"
                what = "a start" if rule.cause is Cause.TOO_LATE else "an end"
                return Explanation(rule.cause, f"{what} within {seconds:g} s of the plan's start", passed)
            case guards.Always() if rule.expected:
                return Explanation(rule.cause, rule.expected, rule.observed)
            case guards.Always() | guards.After() | guards.Ending() | guards.Failing() | guards.CancelAsked() | guards.PauseAsked():
                return None
            case guards.AlreadyTrue() | guards.EffectsSeen() | guards.EffectsMissing():
                return None  # explained by what the call lacks
            case guards.Adopted() | guards.Accepts() | guards.Ends():
                return None  # explained by the end of the request
            case _ as unexplained:
                assert_never(unexplained)


def _grounded(condition: Condition, context: EvaluationContext) -> Condition:
    env = context.environment()
    return ground(condition, env) if env else condition


def _call(site: Site, firing: Firing) -> int:
    """Return the call that a transition belongs to."""
    call = firing.step if site.step is None else site.step
    assert call is not None, "only calls have requests, effects, resources and conditions over all"
    return call


def _now_if(is_open: bool) -> float:
    return -NEVER if is_open else NEVER


OPENS: Final[Mapping[type, Callable[[Guards, Site, Firing, int], float]]] = {
    guards.Always: lambda run, site, firing, place: -NEVER,
    guards.After: Guards.waits_until,
    guards.Late: Guards._late,
    guards.Ending: lambda run, site, firing, place: _now_if(run.state.ending),
    guards.Failing: lambda run, site, firing, place: _now_if(run.state.failing),
    guards.CancelAsked: lambda run, site, firing, place: _now_if(run.state.cancels),
    guards.PauseAsked: lambda run, site, firing, place: _now_if(run.state.suspends or bool(run.in_hands(site, firing, place))),
    guards.ConditionTrue: lambda run, site, firing, place: -NEVER if run.truth(site, firing, place) is True else NEVER,
    guards.ConditionFalse: Guards._not_true,
    guards.ConditionUnknown: Guards._not_true,
    guards.InvariantFalse: Guards._invariant_false,
    guards.AlreadyTrue: Guards._already_true,
    guards.DataMissing: Guards._data_missing,
    guards.Withheld: Guards._withheld,
    guards.EffectsSeen: Guards._effects_seen,
    guards.EffectsMissing: Guards._effects_missing,
    guards.Adopted: lambda run, site, firing, place: _now_if(_call(site, firing) in run.state.adopted),
    guards.Accepts: lambda run, site, firing, place: NEVER,  # opened by a report alone, see `Run._take`
    guards.Ends: lambda run, site, firing, place: NEVER,
    guards.Due: Guards._due,
}
"""For every kind of guard, when it opens: with the block of the transition, the transition and the place at which it is decided on."""
