"""The definition of a Petri Net Machine, to be read and to be run: PNM = (Σ, PN, m₀, δ̂, P_g), as in the paper of 2019.

PN   A place/transition net: places P, transitions T and weighted arcs. Of each transition `net.inputs` has the places that it takes
     tokens from, and `net.outputs` those that it puts tokens on, both with the number of tokens.
m₀   The initial marking, `machine.initial`. A marking m says how many tokens each place holds.
P_g  The goal places, `machine.goal_places`. The machine has reached its goal when P_g ∩ m ≠ ∅, and has failed when `failed_place` is
     marked. Of a machine that was proved sound, one of the two becomes true in the end.
Σ    The input symbols, `Symbol`: a server's report about a request, a change of knowledge or of resources, a moment in time, a person's
     answer, and control: begin, pause, resume, step, stop, and what people have in their hands.
δ̂    The transition function, `ReferenceRun.delta`. In the paper δ̂: Σ × M × T → T̄, where T̄ says how often each transition fires, and then
     m' = T̄·D + m with the incidence matrix D. Here δ̂ gives the firings in their order, because one may change knowledge that decides
     the next. T̄ counts them, so the equation holds for every symbol; a test checks it.

Each transition has a *rule*: a guard and an action. It *may fire* if it is enabled, which means that the marking covers its inputs, and
if its guard is open. There are two kinds of guards:

- `Accepts` and `Ends` are opened by a report: the server has accepted the request of a call, or the request has ended in some way. The
  report fires one transition by itself. So the outcome of an action chooses the transition, as in the paper's figure of an action.
- All others are asked at marked places. `opens` gives the moment from which such a guard is open: it may be past, to come, or never.

After each symbol the machine *settles*: one transition fires after the other until none may. A Petri net leaves open which one goes
first; here the same symbols always give the same firings. A token puts its place in a queue. At a place the transitions are asked in the
order of the net, and the first that may fire fires. If none may, the place is *undecided*: it is asked again when knowledge that it may
read has changed, when its moment comes, and when the run is stopped, paused or resumed, or begins to end.

The *action* of a transition is what its firing does besides moving tokens: it sends the request of a call or has it cancelled, or writes
to knowledge which effects a call is assumed to have. Sensors report all other effects; they are never written, but looked for.

Four ideas go beyond the paper:

- *Knowledge* lies outside the marking. Guards read it, and it is shared by all machines.
- A run is *ending* once a failure place or a restart place is marked, or it was stopped. Then nothing new starts, and every place at which
  something is waited for has a way out, which leads to the end.
- *Resources* are tokens, so that within a net no two calls have the same arm. Machines that share resources stand in one line for them.
- A *question* to a person or a database may have to be answered before a guard can be evaluated. The place waits for the answer.

Defined elsewhere: conditions, effects, goals and results of calls, the firing rule, the line for resources, and answers. Left out:
explanations, observers, going on in another process (`Restarted`), and answers that a run has from the run before it. The same machine
made fast, by number and asking only what may have changed, is `pnm.core.execution.run`; `python -m tests.random_runs reference` holds it
against this one, on random machines and symbols.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import TypeAlias, assert_never
from uuid import UUID

from pnm.core.execution import call_data, events
from pnm.core.execution.handover import CallAttempt, UnderWay
from pnm.core.execution.questions import EvaluationContext, Questions, carry_out, subject_of
from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import Unanswered
from pnm.core.logic.conditions import evaluate, ground, names
from pnm.core.logic.effects import Changes
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine import guards, requests
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.net.net import Marking, fire, is_enabled
from pnm.core.resources import Claim, Resources, RunClaims

_Report: TypeAlias = requests.Accepted | requests.Ended
_Change: TypeAlias = events.KnowledgeChanged | events.ResourcesChanged | events.Tick | events.Answered
_Control: TypeAlias = events.Begin | events.Stop | events.Pause | events.Resume | events.InHands | events.SingleStep | events.Settled
Symbol: TypeAlias = _Report | requests.Postponed | _Change | _Control
"""Σ. All other events move no token."""

ALWAYS, NEVER = -inf, inf


@dataclass
class ReferenceRun:
    """A Petri Net Machine and where it stands. It is made as `Run` is, with the fields up to `adopted`; all else changes."""

    machine: PetriNetMachine
    knowledge: Layered
    id: UUID
    bindings: Bindings = field(default_factory=Bindings)
    goal_fields: call_data.GoalFields = lambda action: None
    asks: bool = False
    origin: float | None = None
    resources: Resources | None = None
    adopted: dict[int, UnderWay] = field(default_factory=dict)  # by call: requests of another run, until they are taken over
    marking: Marking = field(init=False)
    marked_at: dict[str, float] = field(default_factory=dict)  # by place, when it was marked last
    now: float = ALWAYS
    has_begun: bool = False
    stop: events.Stop | None = None
    pause: events.Pause | None = None
    hands: tuple[str, ...] = ()  # robots, and other objects and resources, that people have in their hands
    is_stepping: bool = False  # one request may be sent although the run is paused
    queue: deque[str] = field(default_factory=deque)  # places to be asked
    undecided: dict[str, None] = field(default_factory=dict)  # places to be asked again, in the order in which they became undecided
    moments: dict[str, float] = field(default_factory=dict)  # when to ask them again at the latest
    wake: float = NEVER  # the moment asked for last
    since: dict[str, float] = field(default_factory=dict)  # by transition, since when its guard would be open but for a delay
    alive: dict[UUID, int] = field(default_factory=dict)  # requests that are not over, as far as is known, and their calls
    attempts: dict[int, CallAttempt] = field(default_factory=dict)  # by call, its last request
    counts: dict[int, int] = field(default_factory=dict)  # by call, how many requests there were since it was reached
    early: list[_Report] = field(default_factory=list)  # reports about adopted requests from before the beginning
    operated: deque[requests.Ended] = field(default_factory=deque)  # ends of operations on knowledge, which need no server
    has_change: bool = False  # knowledge has changed, and no place was asked about it yet
    questions: Questions[str] = field(default_factory=Questions)
    firings: list[str] = field(default_factory=list)
    commands: list[events.Command] = field(default_factory=list)

    def __post_init__(self) -> None:
        net, self.rules, self.marking = self.machine.net, self.machine.rules, self.machine.initial
        self.asked_at = {place: [name for name in net.transitions if place in net.inputs[name]] for place in net.places}
        takes = {name for name, inputs in net.inputs.items() if self.machine.resource_places.keys() & inputs.keys()}
        self.claiming = {name for name in takes if self.rules[name].action is not requests.TransitionAction.ADOPT}  # which brings its own
        self.claims = RunClaims[str](self.resources or Resources(self.machine.capacities), self.id, 0)
        self.identity = requests.identities(self.id)
        for call, taken in self.adopted.items():
            self.alive[taken.request], action = call, taken.call.action
            self.attempts[call] = CallAttempt(0, taken.request, action, taken.intended, taken.accepted, begun=taken.begun)
            if taken.resources:
                self.claims.keep(call, self.claims.claim(taken.request, taken.resources))

    @property
    def is_over(self) -> bool:
        """Whether it has reached its goal, which is that P_g ∩ m ≠ ∅, or failed."""
        return self._marks([*self.machine.goal_places, self.machine.failed_place])

    @property
    def is_failing(self) -> bool:
        """Whether it can no longer reach its goal."""
        return self.stop is not None or self._marks(self.machine.failure_places)

    @property
    def is_ending(self) -> bool:
        """Whether nothing new starts: it is failing, or the plan is to begin anew."""
        return self.is_failing or self._marks(self.machine.restart_places)

    def _marks(self, places: Iterable[str]) -> bool:
        return any(self.marking[place] for place in places)

    # --- δ̂ --------------------------------------------------------------------------------------

    def delta(self, symbol: Symbol, now: float) -> tuple[list[str], list[events.Command]]:
        """Take a symbol in and settle; return the transitions that fire, in their order, and what is to be done outside."""
        self.firings, self.commands, self.now = [], [], max(self.now, now)
        match symbol:
            case requests.Accepted() | requests.Ended():
                (self._report if self.has_begun else self.early.append)(symbol)
            case events.Begin():
                self.has_begun, self.origin = True, self.now if self.origin is None else self.origin
                self._mark([place for place in self.machine.net.places if self.marking[place]], self.now)
            case events.KnowledgeChanged():
                self._ask_about_knowledge()
            case events.ResourcesChanged():
                self.queue += self.claims.served()
            case events.Tick():
                places = [place for place in self.machine.net.places if self.moments.get(place, NEVER) <= self.now]
                self.queue += sorted(places, key=self.moments.pop)
                self.wake = NEVER
            case events.Answered(identity, value, message):
                place = self.questions.answered(identity, value, message)
                self.queue += [] if place is None else [place]
            case events.Stop(cancel):
                self.stop = symbol if self.stop is None or cancel else self.stop
                self.commands += self.questions.close("the run was stopped") if cancel else ()
                self.queue += self.undecided
            case events.Pause(at_once):
                self.pause = events.Pause(at_once or (self.pause is not None and self.pause.at_once))
                self.queue += self.undecided
            case events.Resume():
                self.pause = None
                self.queue += self.undecided
            case events.InHands(names):
                self.hands = names
                self.queue += self.undecided
            case events.SingleStep():
                self.pause, self.is_stepping = self.pause and events.Pause(), self.pause is not None
                self.queue += self.undecided
                self._settle()
                self.is_stepping = False
                self.queue += self.undecided
            case events.Settled(request):  # a person says how it ends: it is cancelled, and its end is reported so
                self.commands += [events.Cancel(request)] if request in self.alive else []
            case requests.Postponed(request):  # its server has not come to it yet: the limit for its acceptance begins anew
                for transition in self._opened_by(self.alive[request], None) if request in self.alive else ():
                    self.marked_at |= dict.fromkeys(self.machine.net.inputs[transition], self.now)
            case _:
                assert_never(symbol)
        self._settle()
        while self.early and self.has_begun:
            self._report(self.early.pop(0))
            self._settle()
        return self.firings, self.commands

    def _report(self, report: _Report) -> None:
        """Fire the transition that a report opens, if its request is alive."""
        kind = report.outcome.kind if isinstance(report, requests.Ended) else None
        if (call := self.alive.get(report.request)) is None:
            if isinstance(report, requests.Ended):  # of a request that was given up: now its resources are free
                self.claims.resources.confirm(report.request)
                self.queue += self.claims.served()
            return
        if isinstance(report, requests.Ended):
            attempt, planned, context = self.attempts[call], self.machine.plan.calls[call], self._context(call, None)
            if attempt.accepted is None and kind not in requests.BEFORE_ACCEPTANCE:
                self._report(requests.Accepted(report.request))  # a client may leave out what goes without saying
            del self.alive[report.request]
            if kind is requests.OutcomeKind.SUCCEEDED:
                if values := call_data.variables_of(report.outcome, planned, context.binding):
                    self.knowledge.local.store(values)
                    self.has_change = True
                attempt.learn(report.outcome, planned, context.binding, self.knowledge.world)
                attempt.end(context, self.now, report.outcome)
        for transition in self._opened_by(call, kind)[:1]:
            self._fire(transition, None)

    def _opened_by(self, call: int, kind: requests.OutcomeKind | None) -> list[str]:
        """Return the transitions that may fire when the request of the call ends in this way; None stands for its acceptance."""

        def is_open(guard: guards.Guard) -> bool:
            if kind is None:
                return guard == guards.Accepts(call)
            return isinstance(guard, guards.Ends) and guard.call == call and kind in guard.kinds

        return [name for name, rule in self.rules.items() if is_open(rule.guard) and is_enabled(self.machine.net, self.marking, name)]

    def _settle(self) -> None:
        """Fire transitions until none may; then ask to be woken at the next moment."""
        while self.queue or self.operated:
            if self.operated:  # first, so that no other call sees the operation done and its own call not
                self._report(self.operated.popleft())
            elif self.marking[place := self.queue.popleft()]:
                self._decide(place)
        if self.moments and not self.is_over and (moment := min(self.moments.values())) < self.wake:
            self.wake = moment
            self.commands.append(events.Wake(moment))

    def _decide(self, place: str) -> None:
        """Fire the first transition that may fire at the place; if there is none, the place is undecided."""
        is_undecided, is_in_line, has_asked, moment = False, False, False, NEVER
        for transition in self.asked_at[place]:
            rule, takes = self.rules[transition], transition in self.claiming
            opener = rule.guard.opened_by
            if opener is guards.Opener.REPORT or (opener is guards.Opener.ENDING and not (self.is_ending or self.pause or self.hands)):
                is_undecided = True  # a report, or the end of the run, is waited for
                continue
            # A transition that lacks nothing but resources is asked as well: its call has to stand in line for them.
            free = self.machine.resource_places if takes else ()
            wanted = {one: weight for one, weight in self.machine.net.inputs[transition].items() if one not in free}
            if not self.marking.covers(wanted) or (has_asked and opener is not guards.Opener.TIME):
                continue  # while an answer is awaited that may open an earlier transition, no later one fires but those of time
            is_undecided = True
            try:
                begins = takes or rule.action is requests.TransitionAction.SEND
                if begins and ((self.pause and not self.is_stepping) or self._in_hands(rule.call, rule.action, place)):
                    break  # until the run is resumed, or a person gives back what the call needs
                if takes and rule.call is not None and not self.claims.are_free(place, self._claim(rule.call, rule.action, place)):
                    is_in_line = True
                    break
                opens = self.opens(transition, place)
                if opens <= self.now:
                    if self.asks and rule.call is not None:  # what it is going to change may depend on questions
                        if rule.action is requests.TransitionAction.SEND:
                            call_data.sending(self.machine.plan.calls[rule.call], self._context(rule.call, place))
                        elif rule.action is requests.TransitionAction.FINISH:
                            attempt = self.attempts[rule.call]
                            call_data.finished(attempt.action, attempt.intended, self._context(rule.call, place))
                    self._fire(transition, place)
                    return
                moment = min(moment, opens)
            except Unanswered as needed:
                has_asked = True
                need = self.questions.need(place, subject_of(self.machine.plan, rule.call), needed.question, self.now, self.identity)
                self.commands += need.commands
                self.queue += [place] if need.until is None else []  # it is answered, if only with nothing
                moment = moment if need.until is None else min(moment, need.until)
        if not is_in_line and self.claims.leave(place):  # others need not wait behind what waits for something else, such as an answer
            self.queue += self.claims.served()
        if is_undecided:
            self.undecided.setdefault(place)
        self.moments[place] = min(moment, self.moments.get(place, NEVER))

    def _fire(self, transition: str, place: str | None) -> None:
        """Carry out the action of a transition and move the tokens. Its place is the one that it was asked at; a report has none."""
        rule, was_ending, marked_at = self.rules[transition], self.is_ending, self.now
        step, taken, given = rule.call, self.machine.net.inputs[transition], self.machine.net.outputs[transition]
        if step is not None and transition in self.claiming:
            self.claims.take(step, self._claim(step, rule.action, place))
        if step is not None and step < len(self.machine.plan.calls):
            if isinstance(rule.guard, guards.Adopted):
                marked_at = self.adopted[step].accepted  # its limits count from there
            self._act(rule, step, place)
        self.marking = fire(self.machine.net, self.marking, transition)
        if step is not None and not given.keys().isdisjoint(self.machine.resource_places):
            if rule.gives_up:  # outside of the net the request keeps its resources until its server says that it is over
                self.claims.withhold(step, str(self.attempts[step].action))
            else:
                self.claims.give(step)
            self.queue += self.claims.served()
        for left in taken:  # the next token there is decided anew
            self.undecided.pop(left, None)
            self.moments.pop(left, None)
            if self.claims.leave(left):  # others may have the resources now
                self.queue += self.claims.served()
            for asked in self.asked_at[left]:
                self.since.pop(asked, None)
            self.commands += map(events.Withdraw, self.questions.left(left))
        self._mark(given, marked_at)
        if self.is_ending and not was_ending:
            self.queue += self.undecided
        self.firings.append(transition)

    def _mark(self, places: Iterable[str], time: float) -> None:
        """Note that tokens have arrived. Nothing starts from counters and resources: they are looked at from other places."""
        for place in places:
            self.marked_at[place] = time
        self.queue += [place for place in places if place not in self.machine.record_places]

    # --- guards ---------------------------------------------------------------------------------

    def opens(self, transition: str, place: str) -> float:
        """Return the moment from which the guard is open; it is `NEVER` if nothing but a change can open it."""
        rule, guard = self.rules[transition], self.rules[transition].guard
        context = self._context(rule.call, place)
        match guard:
            case guards.Always():
                is_open = True
            case guards.Ending():
                is_open = self.is_ending
            case guards.Failing():
                is_open = self.is_failing
            case guards.CancelAsked():
                is_open = (self.stop is not None and self.stop.cancel) or (self.is_ending and self.machine.on_failure is OnFailure.CANCEL)
            case guards.PauseAsked():
                is_open = (self.pause is not None and self.pause.at_once) or self._in_hands(rule.call, rule.action, place)
            case guards.ConditionTrue(condition):
                is_open = evaluate(ground(condition, context.environment()), context) is True
            case guards.ConditionFalse(condition) | guards.ConditionUnknown(condition):
                truth = evaluate(ground(condition, context.environment()), context)  # what is not true yet may be about to be reported
                opens = self._after(transition, truth is not True, self.knowledge.world.lag(names(condition)))
                return opens if truth is UNKNOWN or isinstance(guard, guards.ConditionFalse) else NEVER
            case guards.InvariantFalse(condition):
                return self.attempts[rule.call or 0].breaks(condition, context, self.now)
            case guards.AlreadyTrue():
                is_open = call_data.already_true(call_data.ready(context.action, context), context)
            case guards.DataMissing():
                is_open = bool(call_data.goal(context.action, self.goal_fields, context)[1])
            case guards.Withheld(call, seconds, action):
                is_withheld = bool(self.claims.resources.withheld_from(self._claim(call, action, place).names))
                return self._after(transition, is_withheld and not self.pause and not self._in_hands(call, action, place), seconds)
            case guards.EffectsSeen(call):
                return self.attempts[call].seen(context, self.marked_at[place])  # which of several outcomes it was may be reported late
            case guards.EffectsMissing(call):
                attempt = self.attempts[call]
                return self._after(transition, bool(attempt.unseen(context)), attempt.lag(context))
            case guards.Adopted(call):
                is_open = call in self.adopted
            case guards.Accepts() | guards.Ends():
                is_open = False
            case guards.After(seconds):
                return self.marked_at[place] + seconds
            case guards.Late(seconds):
                return self._after(transition, not self.pause, seconds)
            case guards.Due(seconds, since):
                return max([(self.origin or 0.0) + seconds, *(self.marked_at[earlier] + delay for earlier, delay in since)])
            case _:
                assert_never(guard)
        return ALWAYS if is_open else NEVER

    def _after(self, transition: str, is_so: bool, seconds: float) -> float:
        """Return when something has been so for that long; `NEVER` if it is not so now, and then the time begins anew."""
        if is_so:
            return self.since.setdefault(transition, self.now) + seconds
        self.since.pop(transition, None)
        return NEVER

    # --- actions --------------------------------------------------------------------------------

    def _act(self, rule: guards.Rule, call: int, place: str | None) -> None:
        """Carry out the meaning of a firing for its call: send, cancel, or write assumed effects."""
        attempt, world, changes = self.attempts.get(call), self.knowledge.world, Changes()
        begins = rule.outcome is requests.CallOutcome.RUNNING
        self.counts[call] = 0 if rule.outcome is requests.CallOutcome.WAITING else self.counts.get(call, 0) + begins
        if attempt and rule.gives_up:
            self.alive.pop(attempt.request, None)
        if attempt and isinstance(rule.guard, guards.InvariantFalse):
            attempt.interrupt(self._context(call, None))
        match rule.action:
            case None:
                return
            case requests.TransitionAction.ADOPT:
                self.counts[call] = self.adopted.pop(call).result.attempts
                return
            case requests.TransitionAction.SEND:
                self._send(call, place)
            case _ if attempt is None:
                pass  # no request was sent
            case requests.TransitionAction.CANCEL:
                attempt.accepted = None
                self.commands.append(events.Cancel(attempt.request))
            case requests.TransitionAction.BEGIN:
                changes = attempt.begin(world, self.now)
            case requests.TransitionAction.FINISH:
                changes = attempt.finish(call_data.finished(attempt.action, attempt.intended, self._context(call, place)), world)
            case requests.TransitionAction.UNDO:
                changes = attempt.undo(world)
            case _:
                assert_never(rule.action)
        # What sensors report is not written: the check of the effects would see its own expectation.
        if world.record(world.assumed(changes)) or self.has_change:
            self.has_change = False
            self._ask_about_knowledge()

    def _send(self, call: int, place: str | None) -> None:
        """Send a request of the call, or carry out its operation on knowledge."""
        context, before = self._context(call, place), self.attempts.get(call)
        request = self._claim(call, requests.TransitionAction.SEND, place).request
        # What it intends is computed now: as soon as the robot moves, sensors report some of it.
        action, intended = call_data.sending(self.machine.plan.calls[call], context)
        self.attempts[call] = CallAttempt(before.number + 1 if before else 1, request, action, intended)
        self.alive[request], self.is_stepping = call, False
        if action.operation is not None:
            performed = carry_out(request, action.operation, context)
            self.commands += performed.commands
            self.operated += performed.reports
            self.has_change |= performed.changes_knowledge
        else:
            fields, _ = call_data.goal(context.action, self.goal_fields, context)
            self.commands.append(events.Send(requests.Request(request, action, fields, self.counts[call])))

    # --- knowledge and resources ----------------------------------------------------------------

    def _context(self, step: int | None, place: str | None) -> EvaluationContext:
        """Return the context of a step's conditions; what is not decided at a place asks no questions."""
        calls, answers, asks = self.machine.plan.calls, self.questions.answers_at(place) or {}, self.asks and place is not None
        if step is None or step >= len(calls):
            return EvaluationContext(self.knowledge, answers=answers, asks=asks)
        return EvaluationContext(self.knowledge, calls[step].action, self.bindings.of(calls[step].action.name), answers, asks)

    def _ask_about_knowledge(self) -> None:
        """Have the undecided places asked again at which a guard reads knowledge."""
        knowing = {name for name, rule in self.rules.items() if rule.guard.opened_by is guards.Opener.KNOWLEDGE}
        self.queue += [place for place in self.undecided if knowing.intersection(self.asked_at[place])]

    def _in_hands(self, call: int | None, action: requests.TransitionAction | None, place: str | None) -> bool:
        """Return whether a person has something in hand that the call needs: for its next request if that is being sent."""
        if call is None or not self.hands:
            return False
        attempt, context = self.attempts.get(call), self._context(call, place)
        is_out = attempt and action is not requests.TransitionAction.SEND
        return bool(self.bindings.named(attempt.action if attempt and is_out else call_data.ready(context.action, context), self.hands))

    def _claim(self, call: int, action: requests.TransitionAction | None, place: str | None) -> Claim:
        """Return the claims of a call for its request; for the next one if that is being sent."""
        attempt, context = self.attempts.get(call), self._context(call, place)
        if attempt and action is not requests.TransitionAction.SEND:
            return self.claims.claim(attempt.request, self.bindings.resources(attempt.action))
        request = self.identity(f"{call}/{attempt.number + 1 if attempt else 1}")
        return self.claims.claim(request, self.bindings.resources(call_data.ready(context.action, context)))
