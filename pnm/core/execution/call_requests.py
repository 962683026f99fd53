"""Requests of the calls of a run: sent, cancelled, and with the effects that they assume.

Decides nothing: `pnm.core.execution.run` decides when, and gets the commands that have to be carried out outside.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final, TypeAlias
from uuid import UUID

from pnm.core.execution.call_data import GoalFields, Intention, finished, goal, possible, ready, sending, variables_of
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Cancel, Command, Performed, Reattach, Send, Store
from pnm.core.execution.handover import CallAttempt, UnderWay
from pnm.core.execution.machine_index import index_of
from pnm.core.execution.questions import EvaluationContext, carry_out
from pnm.core.kept_state import KeptState
from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import Question
from pnm.core.logic.conditions import observed
from pnm.core.logic.effects import Changes, is_fixed, names_written
from pnm.core.logic.expressions import Fluent, bind, same_value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Feedback, Outcome, Request, TransitionAction, identities

_NOTHING: Final = Performed()
_CHANGED: Final = Performed(changes_knowledge=True)
_AS_PLANNED: Final = GroundAction("")
"""Stands for the action of the plan."""
_BEGIN, _FINISH = TransitionAction.BEGIN, TransitionAction.FINISH

Answers: TypeAlias = Mapping[Question, object] | None
"""The knowledge for a decision; None where no questions are asked."""


class Calls(KeptState):
    """The calls of one run.

    The mutable state is what the constructor sets under "state".
    """

    KEPT = ("open", "attempts", "_stores")

    def __init__(
        self, run: UUID, machine: PetriNetMachine, knowledge: Layered, bindings: Bindings, goal_fields: GoalFields, *, asks: bool
    ) -> None:
        self.identity, self.bindings, self._goal_fields = identities(run), bindings, goal_fields
        self._plan, self._closed = machine.plan, index_of(machine).closed
        self._knowledge, self.world = knowledge, knowledge.world
        self.asks = asks
        """Whether questions can be asked outside."""
        # state
        self.open: dict[UUID, int] = {}
        """The requests that are not over, as far as is known, and their calls."""
        self.attempts: dict[int, CallAttempt] = {}
        """The last one of each call that was sent."""
        self._stores: dict[UUID, Store] = {}
        """Updates outside that are not confirmed."""
        self._contexts: dict[tuple[int | None, bool], EvaluationContext] = {}
        """Those without answers, which do not change, by call and whether questions may be asked."""

    def values(self) -> dict[str, Any]:
        """Return the state; of an attempt without what is so by the plan, which is most of it."""
        attempts: dict[int, CallAttempt] = {}
        for call, attempt in self.attempts.items():
            action = _AS_PLANNED if attempt.action == self._plan.calls[call].action else attempt.action
            intended = Intention() if attempt.intended == self._constant(call) else attempt.intended
            attempts[call] = replace(attempt, action=action, intended=intended)
        return {**super().values(), "attempts": attempts}

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back."""
        super().restore(values)
        for call, attempt in self.attempts.items():
            action = self._plan.calls[call].action if attempt.action == _AS_PLANNED else attempt.action
            intended = self._constant(call) if attempt.intended == Intention() else attempt.intended
            held = None if attempt.held is None else set(attempt.held)
            self.attempts[call] = replace(attempt, action=action, intended=intended, held=held, broken=dict(attempt.broken))

    def _constant(self, call: int) -> Intention:
        """Return what the call is going to change if that depends on nothing, as it would be sent now."""
        closed = self._closed[call]
        return Intention() if closed is None or closed.effects is None else closed.effects.intended(self.world)

    # --- what is asked about a call -----------------------------------------------------------

    def action(self, call: int) -> GroundAction:
        """Return the action as it was sent last."""
        return self.attempts[call].action if call in self.attempts else self._plan.calls[call].action

    def as_sent(self, call: int) -> ActionCall:
        """Return the call with what its parameters had for values when it was sent last."""
        planned, attempt = self._plan.calls[call], self.attempts.get(call)
        return planned if attempt is None or attempt.action is planned.action else replace(planned, action=attempt.action)

    def note_feedback(self, feedback: Feedback) -> ActionCall | None:
        """Note the feedback of a server about a request; return its call if it is under way, and the feedback is new."""
        call = self.open.get(feedback.request)
        if call is None or self.attempts[call].feedback == feedback.text:
            return None
        self.attempts[call].feedback = feedback.text
        return self.as_sent(call)

    def limit(self, call: int) -> float:
        """Return the seconds of the call from its acceptance; 0 for an operation on knowledge."""
        action = self._plan.calls[call].action
        return 0.0 if action.operation is not None else self.bindings.timeout(action)

    def arguments(self, call: int) -> tuple[str, ...]:
        """Return the arguments that the call would be sent with now; parameters without a value by their names."""
        return bind(self._plan.calls[call].action.arguments, self.context_of(call, None).environment())

    def binding(self, call: int) -> Binding:
        """Return the binding of the call's action."""
        return self.bindings.of(self._plan.calls[call].action.name)

    def context_of(self, call: int | None, answers: Answers) -> EvaluationContext:
        """Return the evaluation context of the call; no questions are asked when there are no answers."""
        asks = self.asks and answers is not None
        if answers:
            return replace(self.context_of(call, {}), answers=answers)
        if (found := self._contexts.get((call, asks))) is None:
            if call is None or call >= len(self._plan.calls):
                found = EvaluationContext(self._knowledge, asks=asks)
            else:
                found = EvaluationContext(self._knowledge, self._plan.calls[call].action, self.binding(call), asks=asks)
            self._contexts[call, asks] = found
        return found

    def own_goal(self, call: int) -> Mapping[str, object] | None:
        """Return the fields of the goal where the call by itself has values for all of them."""
        closed, action = self._closed[call], self._plan.calls[call].action
        if closed is None or self.bindings.of(action.name).goal is not None:
            return None
        if (names := self._goal_fields(action)) is None:
            return closed.own
        return {name: closed.own[name] for name in names} if closed.own.keys() >= {*names} else None

    def goal(self, call: int, context: EvaluationContext) -> tuple[Mapping[str, object], tuple[str, ...]]:
        """Return the fields of the goal, and the names of those for which there is no value."""
        if (own := self.own_goal(call)) is not None:
            return own, ()
        return goal(context.action, self._goal_fields, context)

    def claiming(self, call: int, action: TransitionAction | None, context: EvaluationContext) -> tuple[UUID, GroundAction]:
        """Return for which request, and with which parameters, the call claims resources: for the next one if it is being sent."""
        # A retry is another request, with the values that knowledge has now; all other actions are about the one that is out.
        if action is TransitionAction.SEND:
            return self._next(call)[1], ready(context.action, context)
        return self.attempts[call].request, self.action(call)

    def named(self, call: int, action: TransitionAction | None, context: EvaluationContext, names: Collection[str]) -> str:
        """Return the first of these robots, objects and resources that the call needs; see `claiming`."""
        is_next = action is TransitionAction.SEND or call not in self.attempts
        return self.bindings.named(ready(context.action, context) if is_next else self.action(call), names)

    def shows_nothing(self, call: int) -> bool:
        """Return whether nothing of the call's effects can be seen, whatever is so."""
        attempt, closed = self.attempts[call], self._closed[call]
        intended = attempt.intended
        return closed is not None and not (closed.expects or attempt.denied or intended.expected or intended.outcomes)

    def is_assumed(self, call: int) -> bool:
        """Return whether nothing reports some of what the call changes."""
        if (closed := self._closed[call]) is not None:
            return not self.world.senses(closed.names)
        action = self.action(call)
        return not self.world.senses(names_written((*action.start_effects, *action.possible_effects)))

    def declared(self, call: int) -> str:
        """Return which of its declared outcomes the call has had, as far as is known; empty if its action has only one."""
        intended = self.attempts[call].intended
        return " or ".join(one.name for one in possible(intended, self.context_of(call, None))) if intended.outcomes else intended.name

    def explain_unseen(self, call: int, context: EvaluationContext) -> tuple[str, str]:
        """Return the effects of the call that are not observed, and the observations instead, as texts."""
        denied, missing = self.attempts[call].denied or {}, self.attempts[call].unseen(context)
        seen = dict.fromkeys(denied.get(part) or observed(part, context) for part in missing)
        return " ".join(map(str, missing)), "; ".join(seen)

    # --- actions of transitions -----------------------------------------------------------------

    def compute_intention(self, action: TransitionAction | None, call: int, context: EvaluationContext) -> None:
        """Compute what the action of a transition is going to change, only to raise `Unanswered` if that depends on a question."""
        planned, attempt = context.action, self.attempts.get(call)
        match action:
            case TransitionAction.SEND if not all(map(is_fixed, (*planned.start_effects, *planned.possible_effects))):
                sending(self._plan.calls[call], context)
            case TransitionAction.FINISH if attempt and not all(map(is_fixed, attempt.action.possible_effects)):
                finished(attempt.action, attempt.intended, context)
            case _:
                pass

    def send(self, call: int, count: int, answers: Answers) -> Performed:
        """Send a request, the `count`-th since the call was reached; or carry out an operation on knowledge."""
        (number, identity), closed = self._next(call), self._closed[call]
        # Computed now: once the robot moves, sensors report some of the effects, and conditions would read the new state.
        if closed is not None and closed.effects is not None:
            action, intended = self._plan.calls[call].action, closed.effects.intended(self.world)
        else:
            action, intended = sending(self._plan.calls[call], self.context_of(call, answers))
        self.open[identity] = call
        if action.operation is not None:
            self.attempts[call] = CallAttempt(number, identity, action, intended)
            performed = carry_out(identity, action.operation, self.context_of(call, answers))
            self._stores.update({command.id: command for command in performed.commands if isinstance(command, Store)})
            return performed
        own = self.own_goal(call)
        request = Request(identity, action, self.goal(call, self.context_of(call, answers))[0] if own is None else own, count)
        self.attempts[call] = CallAttempt(number, identity, action, intended, unanswered=request)
        return Performed((Send(request),))

    def perform(self, action: TransitionAction, call: int, answers: Answers, now: float) -> Performed:
        """Carry out the action of a transition that fires, about the request that was sent last; nothing if there is none."""
        attempt = self.attempts.get(call)
        if attempt is None:
            return _NOTHING
        if action is _BEGIN:
            return self._write(attempt.begin(self.world, now))
        if action is _FINISH:
            closed = self._closed[call]
            is_constant = closed is not None and closed.effects is not None
            end = attempt.intended.end if is_constant else finished(attempt.action, attempt.intended, self.context_of(call, answers))
            return self._write(attempt.finish(end, self.world))
        if action is TransitionAction.CANCEL:
            attempt.accepted = attempt.unanswered = None  # it is not handed over: a successor would take it for one that goes on
            return Performed((Cancel(attempt.request),))
        assert action is TransitionAction.UNDO, f"{action} is about no request that was sent"
        return self._write(attempt.undo(self.world))

    def again(self) -> tuple[Command, ...]:
        """Return the decisions of another process about open requests.

        It finds out about them, asks once more for the end of those that are being cancelled, and repeats updates, which set values.
        """
        commands: list[Command] = []
        for identity, call in self.open.items():
            if identity in self._stores:
                commands.append(self._stores[identity])
                continue
            attempt = self.attempts[call]
            request = attempt.unanswered or Request(identity, self.action(call), {})
            commands.append(Reattach(request, accepted=attempt.unanswered is None))
            if attempt.unanswered is None and attempt.accepted is None:  # its process may have died before it could say so
                commands.append(Cancel(identity))
        return tuple(commands)

    def unreported(self, call: int) -> Changes:
        """Return the changes at the start of the call that sensors report, but have not reported since."""
        attempt, awaited, world = self.attempts[call], self._awaited(call), self.world
        changed = world.changed_since(attempt.begun_after) if awaited else None
        if changed is None:  # nothing is awaited, or anything may have been reported
            return {}
        said = frozenset(changed)
        return {fluent: value for fluent, value in awaited.items() if fluent not in said and not same_value(world.value(fluent), value)}

    def _awaited(self, call: int) -> dict[Fluent, bool | float | str]:
        """Return the changes at the start of a call that has begun that sensors report."""
        attempt = self.attempts[call]
        told = {fluent: value for fluent, value in attempt.intended.start.items() if isinstance(value, bool | str)}
        return {} if attempt.begun is None else self.world.reported(told)

    def asked_since(self, calls: Iterable[int]) -> int:
        """Return the number of changes of the world since which it is asked what was reported of open calls, and of some others."""
        begun = (self.attempts[call].begun_after for call in (*self.open.values(), *calls) if call in self.attempts and self._awaited(call))
        return min(begun, default=self.world.changes)

    def go_on_with(self, others: Calls) -> None:
        """Note since when the requests taken over from other calls have been under way."""
        before = {attempt.request: attempt.begun_after for attempt in others.attempts.values()}
        for attempt in self.attempts.values():
            attempt.begun_after = before.get(attempt.request, attempt.begun_after)

    def adopt(self, call: int, taken: UnderWay) -> None:
        """Take over a request with all that its run knew of it."""
        self.open[taken.request] = call
        self.attempts[call] = CallAttempt(
            0, taken.request, taken.call.action, taken.intended, taken.accepted, begun=taken.begun, begun_after=self.world.changes
        )

    def under_way(self, result: Callable[[int], CallResult]) -> tuple[UnderWay, ...]:
        """Return the requests that another run may take over, in the order of their calls; `result` returns the result so far of a call."""
        resources = self.bindings.resources
        return tuple(
            UnderWay(self.as_sent(call), request, last.accepted, result(call), last.intended, last.begun, resources(last.action))
            for request, call in sorted(self.open.items(), key=lambda entry: entry[1])
            if (last := self.attempts[call]).accepted is not None
        )

    def succeeded(self, call: int, outcome: Outcome, now: float) -> bool:
        """Store the fields of the result, as variables or as facts for its end, and note what the end relies on and was not so.

        Return whether anything was stored.
        """
        values = variables_of(outcome, self._plan.calls[call], self.binding(call))
        if values:
            self._knowledge.local.store(values)
        closed, attempt = self._closed[call], self.attempts[call]
        attempt.learn(outcome, self._plan.calls[call], self.binding(call), self.world)
        has_all = closed is not None and (closed.needed is None or closed.needed.holds_by_facts(self.world))
        # now, before anything is written of its effects: they may change what it relies on
        if not has_all or attempt.intended.outcomes:
            attempt.end(self.context_of(call, None), now, outcome)
        return bool(values)

    def _next(self, call: int) -> tuple[int, UUID]:
        """Return the number and the identity of the next request."""
        attempt = self.attempts.get(call)
        number = 1 if attempt is None else attempt.number + 1
        return number, self.identity(f"{call}/{number}")

    def _write(self, changes: Changes) -> Performed:
        """Write the assumed effects; sensors report all others."""
        # What sensors report is not overwritten with what the model expects: the check of the effects would see its own expectation.
        return _CHANGED if changes and self.world.record(self.world.assumed(changes)) else _NOTHING
