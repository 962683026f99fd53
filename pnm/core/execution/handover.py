"""Requests that are out, and their handover: a run that is succeeded by another hands them over.

The new run is made with the requests that its plan marks as under way; then it takes the place of the old one if nothing is lost
or invented by that (`RunView.check_successor`). Both are checked before anything changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, nextafter
from uuid import UUID

from pnm.core.execution.call_data import Intention, contradicted, denied_at_end, facts_of, may_be_late, may_turn_out, unseen
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Any, Condition, conjunction, conjuncts, evaluate, ground, names, observed, unmet
from pnm.core.logic.effects import Changes, undo, values_before
from pnm.core.machine.bindings import Binding
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Outcome, Request


@dataclass(slots=True)
class CallAttempt:
    """One request of a call, and what is known of it so far; what an earlier one had begun was undone, or is kept on purpose."""

    number: int
    """0 for a request that was taken over."""
    request: UUID
    action: GroundAction
    """As it was sent."""
    intended: Intention
    accepted: float | None = None
    """The time of its acceptance; None before it, or while it is being cancelled."""
    unanswered: Request | None = None
    """The request, until it is accepted or being cancelled."""
    begun: Changes | None = None
    """Values before what it has written; None before it has begun, and after a rollback."""
    begun_after: int = 0
    """After how many changes of the world it has begun."""
    ended: Changes | None = None
    """The changes at its end; None before."""
    denied: Mapping[Condition, str] | None = None
    """Conditions over all and at the end that were not so, and what was so instead, if there are any."""
    held: set[Condition] | None = field(default_factory=set)
    """Parts of its over-all condition that have been seen to hold; None for all of them."""
    broken: dict[tuple[Condition, bool], float] = field(default_factory=dict)
    """Since when parts of it have not held; and whether that may be for want of a report."""
    feedback: str = ""
    """The last feedback of its server."""
    told: Changes = field(default_factory=dict)
    """The fluents that its result sets."""

    def begin(self, world: KnowledgeBase, now: float) -> Changes:
        """Note that the request was accepted; return the effects of its start."""
        self.accepted, self.unanswered, self.begun_after = now, None, world.changes
        self.begun = values_before(self.intended.start, world)  # before they are written, for a rollback if the call ends without success
        return self.intended.start

    def learn(self, outcome: Outcome, call: ActionCall, binding: Binding, world: KnowledgeBase) -> None:
        """Note which fluents the result of its success sets, and which objects it names; if one cannot be there, it has not succeeded."""
        self.told = facts_of(outcome, call, self.action, binding, world)
        if binding.found is not None and outcome.result:
            found, wrong = binding.found.facts_in(outcome.result, self.action, world)
            self.told |= found
            self.denied = {**(self.denied or {}), **wrong} or None

    def finish(self, end: Changes, world: KnowledgeBase) -> Changes:
        """Note that the call has succeeded; return the effects of its end, of which its result knows best."""
        end = {**end, **self.told}
        known = {fluent: value for one in self.intended.outcomes for fluent, value in one.end.items()}  # unlike what may be one of several
        self.ended, self.begun = end, values_before({**end, **known}, world) | (self.begun or {})
        return end

    def undo(self, world: KnowledgeBase) -> Changes:
        """Take back what was written; return the changes that do so."""
        if self.begun is None:  # it was never accepted, so nothing was written
            return {}
        before, after = self.begun, self.intended.start | (self.ended or {})
        self.begun = self.ended = None
        return undo(before, after, world)

    def breaks(self, condition: Condition, context: EvaluationContext, now: float) -> float:
        """Return when its over-all condition counts as broken: after the lag of its report, or else as soon as the moment is over.

        Not at that very moment: the call may have ended then as well, and the order in which the two are heard says nothing.
        """
        opens = inf
        for part in conjuncts(ground(condition, context.environment())):
            if evaluate(part, context) is True:
                if self.held is not None:
                    self.held.add(part)
                self.broken.pop((part, False), None)
                self.broken.pop((part, True), None)
                continue
            is_late = may_be_late(part, self.action, context, has_held=self.held is None or part in self.held)
            since = self.broken.setdefault((part, is_late), now)
            lag = context.world.lag(names(part)) if is_late else 0.0
            opens = min(opens, max(since + lag, nextafter(since, inf)))
        return opens

    def end(self, context: EvaluationContext, now: float, outcome: Outcome) -> None:
        """Note which conditions over all and at the end were not so, now that the request has succeeded, and what it may have come to."""
        told = [
            one
            for one in self.intended.outcomes
            if (one.name == outcome.declared if outcome.declared else one.name not in context.binding.outcomes)
        ]
        self.intended = told[0] if len(told) == 1 else replace(self.intended, outcomes=tuple(told)) if told else self.intended
        is_watched = self.accepted is not None and self.accepted < now  # then the guard has seen all that broke before

        def breaks_now(part: Condition) -> bool:
            return is_watched and self.broken.get((part, False), now) >= now

        if denied := denied_at_end(self.action, context, breaks_now):
            self.denied = {**(self.denied or {}), **denied}

    def interrupt(self, context: EvaluationContext) -> None:
        """Note the false part of its over-all condition: the call has not succeeded, whatever its server reports."""
        self.denied = {part: observed(part, context) for part in unmet(self.action.invariant, context)}

    def unseen(self, context: EvaluationContext) -> tuple[Condition, ...]:
        """Return which of its effects are not seen, and which conditions until its end were not so."""
        others = [contradicted(one, self.intended, context) for one in self.intended.outcomes]
        unfit = (Any(tuple(map(conjunction, others))),) if others and all(others) else ()
        return tuple(dict.fromkeys((*(self.denied or ()), *unfit, *unseen(self.intended.expected, self.action, context))))

    def seen(self, context: EvaluationContext, since: float) -> float:
        """Return from when its effects count as seen, having been looked for since then; which of several it has had may be told late."""
        if self.unseen(context):
            return inf
        return since + self.lag(context) if may_turn_out(self.intended, context) else -inf

    def lag(self, context: EvaluationContext) -> float:
        """Return the seconds by which reports about its effects and its end condition may be late."""
        mentioned = {fluent[0] for fluent in (*self.intended.expected, *self.intended.before)}
        return context.world.lag({*mentioned, *names(self.action.end_condition), *names(self.action.expected)})


@dataclass(frozen=True, slots=True)
class UnderWay:
    """A request that was accepted and is not over, with what its run knows of it: another run may take it over."""

    call: ActionCall
    """As it was sent."""
    request: UUID
    accepted: float
    """The time of its acceptance."""
    result: CallResult
    """The result of the call so far."""
    intended: Intention
    begun: Changes | None
    """Values before its assumed start effects, for a rollback."""
    resources: tuple[str, ...]
