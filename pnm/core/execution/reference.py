"""The definition of a Petri Net Machine, to be read and to be run: PNM = (Σ, PN, m₀, δ̂, P_g), as in the paper of 2019.

PN   A place/transition net: places P, transitions T and weighted arcs. For each transition `net.inputs` has the places that it takes
     tokens from, and `net.outputs` those that it puts tokens on, both with the number of tokens.
m₀   The initial marking, `machine.initial`. A marking m says how many tokens each place holds.
P_g  The goal places, `machine.goal_places`. The machine has reached its goal when P_g ∩ m ≠ ∅, and has failed when `failed_place` is
     marked. Of a machine that was proved sound, one of the two becomes true in the end.
Σ    The input symbols, `Symbol`: a server's report about a request, a change of knowledge or of resources, a moment in time, a person's
     answer, and control: begin, pause, resume, step, stop.
δ̂    The transition function, `ReferenceRun.delta`. In the paper δ̂: Σ × M × T → T̄, where T̄ says how often each transition fires, and then
     m' = T̄·D + m with the incidence matrix D. Here δ̂ gives the firings in their order, because one may change knowledge that decides
     the next. T̄ is how often each of them is in that order, so the equation holds for every symbol; a test checks it.

Each transition has a *rule*: a guard and an action. A transition *may fire* if it is enabled, which means that the marking covers its
inputs, and if its guard is open. There are two kinds of guards:

- `Accepts` and `Ends` are opened by a report: the server has accepted the request of a call, or the request has ended in some way. The
  report fires one transition by itself. So the outcome of an action chooses the transition, as in the paper's figure of an action.
- All others are asked at marked places. `opens` gives the moment from which such a guard is open: it may be past, to come, or never.

After each symbol the machine *settles*: one transition fires after the other until none may. A Petri net leaves open which one goes
first. Here it is determined, so that the same symbols always give the same firings:

- Between places there is a queue. A place is asked when a token arrives. If no transition may fire there yet, the place is *undecided*:
  it is asked again when knowledge changes, when its moment comes, and when the run is stopped, paused, resumed or begins to end.
- At one place the transitions are asked in the order of the net. The first that may fire fires.

The *action* of a transition is what its firing does besides moving tokens: it sends the request of a call or has it cancelled, or writes
to knowledge which effects a call is assumed to have. Sensors report all other effects; they are never written, but looked for.

Four ideas go beyond the paper:

- *Knowledge* lies outside the marking. Guards read it, and it is shared by all machines.
- A run is *ending* once a failure place or a restart place is marked, or it was stopped. Then nothing new starts, and every place at which
  something is waited for has a way out, which leads to the end.
- *Resources* are tokens, so that within a net no two calls have the same arm. Machines that share resources stand in one line for them.
- A *question* to a person or a database may have to be answered before a guard can be evaluated. The place waits for the answer.

Used here and defined elsewhere: conditions (`pnm.core.logic`), effects (`pnm.core.execution.call_data`), goals and results of calls
(`pnm.core.execution.call_data`), the firing rule (`pnm.core.net.firing_rule`), the line for resources (`pnm.core.resources`) and answers
(`pnm.core.execution.questions`). Left out: explanations for people, observers, going on in another process (`Restarted`), and answers
that a run has from the run before it. `pnm.core.execution.run` is the same machine, made fast: by number, and asking only what may have
changed. A test holds it against this one, on random machines and symbols.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from math import inf, nextafter
from typing import Final, NamedTuple, TypeAlias, assert_never
from uuid import UUID

from pnm.core.execution import events
from pnm.core.execution.call_data import (
    GoalFields,
    already_true,
    carry_out,
    denied_at_end,
    finished,
    goal,
    intention,
    lag_of_effects,
    may_be_late,
    ready,
    unseen,
    variables_of,
)
from pnm.core.execution.handover import CallAttempt, UnderWay
from pnm.core.execution.questions import EvaluationContext, Questions, subject_of
from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import Question, Unanswered
from pnm.core.logic.conditions import Condition, conjuncts, ground, names
from pnm.core.logic.effects import Changes, undo, values_before
from pnm.core.logic.evaluation import evaluate, unmet
from pnm.core.logic.expressions import UNKNOWN, Truth
from pnm.core.machine import guards
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.guards import Opener
from pnm.core.machine.machine import CallOutcome, OnFailure, PetriNetMachine, Rule
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import (
    BEFORE_ACCEPTANCE,
    Accepted,
    Ended,
    Feedback,
    Outcome,
    OutcomeKind,
    Postponed,
    Request,
    TransitionAction,
    identities,
)
from pnm.core.net.firing_rule import fire, is_enabled
from pnm.core.net.net import Marking, PetriNet
from pnm.core.resources import Claim, Resources, RunClaims

_Control: TypeAlias = events.Begin | events.Stop | events.Pause | events.Resume | events.SingleStep | events.Settled
_Change: TypeAlias = events.KnowledgeChanged | events.ResourcesChanged | events.Tick | events.Answered
Symbol: TypeAlias = Accepted | Ended | Postponed | Feedback | _Change | _Control
"""Σ."""

ALWAYS: Final = -inf
NEVER: Final = inf


class Answer(NamedTuple):
    """Value of δ̂: the transitions that fire, in their order, and what is to be done outside: requests, cancellations, questions."""

    firings: tuple[str, ...]
    commands: tuple[events.Command, ...]


@dataclass
class ReferenceRun:
    """A Petri Net Machine and where it stands. It is made as `Run` is, with the fields up to `adopted`; all else changes."""

    machine: PetriNetMachine
    knowledge: Layered
    id: UUID
    bindings: Bindings = field(default_factory=Bindings)
    goal_fields: GoalFields = lambda action: None
    asks: bool = False
    origin: float | None = None
    resources: Resources | None = None
    adopted: dict[int, UnderWay] = field(default_factory=dict)
    """By call, the requests of another run that this one goes on with, until it has taken them over."""
    marking: Marking = field(init=False)
    marked_at: dict[str, float] = field(default_factory=dict)
    """When places were marked last."""
    now: float = ALWAYS
    has_begun: bool = False
    stop: events.Stop | None = None
    pause: events.Pause | None = None
    is_stepping: bool = False
    """One request may be sent although the run is paused."""
    queue: deque[str] = field(default_factory=deque)
    """Places to be asked."""
    undecided: dict[str, None] = field(default_factory=dict)
    """Places to be asked again, in the order in which they became undecided."""
    moments: set[tuple[float, int]] = field(default_factory=set)
    """When to ask them again, with their positions in the net."""
    wake: float = NEVER
    """The moment that was asked for last."""
    since: dict[str, float] = field(default_factory=dict)
    """By transition, since when its guard would be open, if there were no delay."""
    alive: dict[UUID, int] = field(default_factory=dict)
    """Requests that are not over, as far as is known, with their calls."""
    attempts: dict[int, CallAttempt] = field(default_factory=dict)
    """The last request of each call."""
    counts: dict[int, int] = field(default_factory=dict)
    """How many requests of each call there were since it was reached."""
    early: list[Accepted | Ended] = field(default_factory=list)
    """Reports about adopted requests that came before the beginning."""
    operated: deque[Ended] = field(default_factory=deque)
    """Ends of operations on knowledge, which need no server."""
    has_result: bool = False
    """A result was stored, and no place was asked about it yet."""
    questions: Questions[str] = field(default_factory=Questions)
    firings: list[str] = field(default_factory=list)
    commands: list[events.Command] = field(default_factory=list)

    def __post_init__(self) -> None:
        net, self.marking = self.machine.net, self.machine.initial
        arcs = [{name: dict(weights[name]) for name in net.transitions} for weights in (net.inputs, net.outputs)]
        self.net = PetriNet(tuple(net.places), *arcs)
        self.rules: dict[str, Rule] = {name: self.machine.rules[name] for name in net.transitions}
        self.claims = RunClaims[str](self.resources or Resources(self.machine.capacities), self.id, 0)
        self.identity: Callable[[str], UUID] = identities(self.id)
        for call, taken in self.adopted.items():
            self.alive[taken.request], action = call, taken.call.action
            self.attempts[call] = CallAttempt(0, taken.request, action, taken.intended, taken.accepted, begun=taken.begun)
            if taken.resources:
                self.claims.keep(call, self.claims.claim(taken.request, taken.resources))

    # --- what the marking says ------------------------------------------------------------------

    @property
    def has_reached_goal(self) -> bool:
        """Whether P_g ∩ m ≠ ∅."""
        return self._marks(self.machine.goal_places)

    @property
    def is_over(self) -> bool:
        """Whether it has reached its goal or failed."""
        return self.has_reached_goal or self._marks([self.machine.failed_place])

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

    def delta(self, symbol: Symbol, now: float) -> Answer:
        """Take a symbol in: note what it says, fire what it opens, and settle."""
        self.firings, self.commands, self.now = [], [], max(self.now, now)
        match symbol:
            case Accepted() | Ended():
                (self._report if self.has_begun else self.early.append)(symbol)
            case events.Begin():
                self.has_begun, self.origin = True, self.now if self.origin is None else self.origin
                self._mark([place for place in self.net.places if self.marking[place]], self.now)
            case events.KnowledgeChanged():
                self._ask_about_knowledge()
            case events.ResourcesChanged():
                self.queue += self.claims.served()
            case events.Tick():
                due = sorted(moment for moment in self.moments if moment[0] <= self.now)
                self.moments, self.wake = self.moments.difference(due), NEVER
                self.queue += [self.net.places[position] for _, position in due]
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
            case events.SingleStep():
                self.pause, self.is_stepping = self.pause and events.Pause(), self.pause is not None
                self.queue += self.undecided
                self._settle()
                self.is_stepping = False
                self.queue += self.undecided
            case events.Settled(request):  # a person says how it ends: it is cancelled, and its end is reported so
                self.commands += [events.Cancel(request)] if request in self.alive else []
            case Postponed(request):  # its server has not come to it yet: the limit for its acceptance begins anew
                for transition in self._opened_by(self.alive.get(request), None):
                    self.marked_at |= dict.fromkeys(self.net.inputs[transition], self.now)
            case Feedback():
                pass
            case _:
                assert_never(symbol)
        self._settle()
        while self.early and self.has_begun:
            self._report(self.early.pop(0))
            self._settle()
        return Answer(tuple(self.firings), tuple(self.commands))

    def _report(self, report: Accepted | Ended) -> None:
        """Fire the transition that a report opens, if its request is alive."""
        call = self.alive.get(report.request)
        if call is None:
            if isinstance(report, Ended):  # of a request that was given up: now its resources are free
                self.claims.resources.confirm(report.request)
                self.queue += self.claims.served()
        elif isinstance(report, Accepted):
            self._fire_reported(call, None)
        else:
            kind = report.outcome.kind
            if self.attempts[call].accepted is None and kind not in BEFORE_ACCEPTANCE:
                self._fire_reported(call, None)  # a client may leave out what goes without saying
            del self.alive[report.request]
            if kind is OutcomeKind.SUCCEEDED:
                self._note_success(call, report.outcome)
            self._fire_reported(call, kind)

    def _fire_reported(self, call: int, kind: OutcomeKind | None) -> None:
        for transition in self._opened_by(call, kind)[:1]:
            self._fire(transition, None)

    def _opened_by(self, call: int | None, kind: OutcomeKind | None) -> list[str]:
        """Return the transitions that may fire when the request of the call ends in this way; None stands for its acceptance."""

        def is_open(guard: guards.Guard) -> bool:
            match guard:
                case guards.Accepts(its):
                    return its == call and kind is None
                case guards.Ends(its, kinds):
                    return its == call and kind in kinds
                case _:
                    return False

        return [name for name, rule in self.rules.items() if is_open(rule.guard) and is_enabled(self.net, self.marking, name)]

    def _settle(self) -> None:
        """Fire transitions until none may; then ask to be woken at the next moment."""
        while self.queue or self.operated:
            if self.operated:  # first, so that no other call sees the operation done and its own call not
                self._report(self.operated.popleft())
            elif self.marking[place := self.queue.popleft()]:
                self._decide(place)
        if self.moments and not self.is_over and (moment := min(self.moments)[0]) < self.wake:
            self.wake = moment
            self.commands.append(events.Wake(moment))

    def _decide(self, place: str) -> None:
        """Fire the first transition that may fire at the place; if there is none, the place is undecided."""
        is_undecided, has_asked, moment = False, False, NEVER
        for transition in self._asked_at(place):
            rule, takes = self.rules[transition], self._takes_resources(transition)
            opener = rule.guard.opened_by
            if opener is Opener.REPORT or (opener is Opener.ENDING and not (self.is_ending or self.pause)):
                is_undecided = True  # a report, or the end of the run, is waited for
                continue
            # A transition that lacks nothing but resources is asked as well: its call has to stand in line for them.
            wanted = {
                one: weight for one, weight in self.net.inputs[transition].items() if not (takes and one in self.machine.resource_places)
            }
            if not self.marking.covers(wanted) or (has_asked and opener is not Opener.TIME):
                continue  # while an answer is awaited that may open an earlier transition, no later one fires but those of time
            try:
                if self._must_wait(rule, place, takes=takes):
                    is_undecided = True
                    break
                opens = self.opens(transition, place)
                if opens <= self.now and self.asks:
                    self._foresee(rule, place)
            except Unanswered as needed:
                self._ask(place, rule.call, needed.question)
                self._leave_line(place)  # an answer may take long
                is_undecided = has_asked = True
                continue
            if opens <= self.now:
                self._fire(transition, place)
                return
            is_undecided, moment = True, min(moment, opens)
            if takes:
                self._leave_line(place)
        if is_undecided:
            self.undecided.setdefault(place)
        self._ask_again(place, moment)

    def _must_wait(self, rule: Rule, place: str, *, takes: bool) -> bool:
        """Return whether a transition has to wait for the end of a pause, or for the resources of its call."""
        if self.pause and not self.is_stepping and (takes or rule.action is TransitionAction.SEND):
            self._leave_line(place)
            return True
        return takes and not self.claims.are_free(place, self._claim(rule, place))

    def _fire(self, transition: str, place: str | None) -> None:
        """Carry out the action of a transition and move the tokens. Its place is the one that it was asked at; a report has none."""
        rule, was_ending, marked_at = self.rules[transition], self.is_ending, self.now
        step, taken, given = rule.call, self.net.inputs[transition], self.net.outputs[transition]
        if step is not None and self._takes_resources(transition):
            self.claims.take(step, self._claim(rule, place))
        if step is not None and step < len(self.machine.plan.calls):
            if isinstance(rule.guard, guards.Adopted):
                marked_at = self.adopted[step].accepted  # its limits count from there
            self._act(rule, step, place)
        self.marking = fire(self.net, self.marking, transition)
        if step is not None and not given.keys().isdisjoint(self.machine.resource_places):
            if rule.gives_up:  # outside of the net the request keeps its resources until its server says that it is over
                self.claims.withhold(step, str(self.attempts[step].action))
            else:
                self.claims.give(step)
            self.queue += self.claims.served()
        for left in taken:
            self._leave(left)
        self._mark(given, marked_at)
        if self.is_ending and not was_ending:
            self.queue += self.undecided
        self.firings.append(transition)

    def _mark(self, places: Iterable[str], time: float) -> None:
        """Note that tokens have arrived. Nothing starts from counters and resources: they are looked at from other places."""
        for place in places:
            self.marked_at[place] = time
        self.queue += [place for place in places if place not in self.machine.record_places]

    def _leave(self, place: str) -> None:
        """Forget what was waited for at a place: the next token there is decided anew."""
        self.undecided.pop(place, None)
        self._leave_line(place)
        for transition in self._asked_at(place):
            self.since.pop(transition, None)
        self.commands += map(events.Withdraw, self.questions.left(place))

    # --- guards ---------------------------------------------------------------------------------

    def opens(self, transition: str, place: str) -> float:
        """Return the moment from which the guard is open; it is `NEVER` if nothing but a change can open it."""
        rule, guard = self.rules[transition], self.rules[transition].guard
        match guard:
            case guards.Always():
                return ALWAYS
            case guards.Ending():
                return _now_if(self.is_ending)
            case guards.Failing():
                return _now_if(self.is_failing)
            case guards.CancelAsked():
                stops = self.stop is not None and self.stop.cancel
                return _now_if(stops or (self.is_ending and self.machine.on_failure is OnFailure.CANCEL))
            case guards.PauseAsked():
                return _now_if(self.pause is not None and self.pause.at_once)
            case guards.ConditionTrue(condition):
                return _now_if(self._truth(condition, rule.call, place) is True)
            case guards.ConditionFalse(condition):
                # A condition that is not true may be about to be reported true.
                return self._after(
                    transition, self._truth(condition, rule.call, place) is not True, self.knowledge.world.lag(names(condition))
                )
            case guards.ConditionUnknown(condition):
                truth = self._truth(condition, rule.call, place)
                opens = self._after(transition, truth is not True, self.knowledge.world.lag(names(condition)))
                return opens if truth is UNKNOWN else NEVER
            case guards.InvariantFalse(condition):
                return self._breaks(condition, rule.call or 0, place)
            case guards.AlreadyTrue(call):
                context = self._context(call, place)
                return _now_if(already_true(ready(context.action, context), context))
            case guards.DataMissing(call):
                context = self._context(call, place)
                return _now_if(bool(goal(context.action, self.goal_fields, context)[1]))
            case guards.Withheld(call, seconds, action):
                _, needed = self._claiming(call, action, self._context(call, place))
                is_withheld = bool(self.claims.withheld_from(self.bindings.resources(needed)))
                return self._after(transition, is_withheld and not self.pause, seconds)
            case guards.EffectsSeen(call):
                return _now_if(not self._unseen(call, place))
            case guards.EffectsMissing(call):
                attempt = self.attempts[call]
                lag = lag_of_effects(attempt.intended.expected, attempt.action, self._context(call, place))
                return self._after(transition, bool(self._unseen(call, place)), lag)
            case guards.Adopted(call):
                return _now_if(call in self.adopted)
            case guards.Accepts() | guards.Ends():
                return NEVER
            case guards.After(seconds):
                return self.marked_at[place] + seconds
            case guards.Late(seconds):
                return self._after(transition, not self.pause, seconds)
            case guards.Due(seconds, since):
                return max([(self.origin or 0.0) + seconds, *(self.marked_at[earlier] + delay for earlier, delay in since)])
            case _:
                assert_never(guard)

    def _after(self, transition: str, is_so: bool, seconds: float) -> float:
        """Return when something has been so for that long; `NEVER` if it is not so now, and then the time begins anew."""
        if is_so:
            return self.since.setdefault(transition, self.now) + seconds
        self.since.pop(transition, None)
        return NEVER

    def _truth(self, condition: Condition, step: int | None, place: str) -> Truth:
        context = self._context(step, place)
        return evaluate(ground(condition, context.environment()), context)

    def _breaks(self, condition: Condition, call: int, place: str) -> float:
        """Return when an over-all condition counts as broken: after the lag of its report, or else just after it has become false."""
        attempt, context, opens = self.attempts[call], self._context(call, place), NEVER
        for part in conjuncts(ground(condition, context.environment())):
            if evaluate(part, context) is True:
                attempt.holds(part)
                continue
            is_late = may_be_late(part, attempt.action, context, has_held=attempt.held is None or part in attempt.held)
            since = attempt.broken.setdefault((part, is_late), self.now)
            lag = self.knowledge.world.lag(names(part)) if is_late else 0.0
            # Not at that very moment: the call may end then as well, and the order in which the two are heard says nothing.
            opens = min(opens, max(since + lag, nextafter(since, NEVER)))
        return opens

    def _unseen(self, call: int, place: str) -> tuple[Condition, ...]:
        """Return which effects of the call are not seen, and which conditions until its end were not so."""
        attempt = self.attempts[call]
        return (*(attempt.denied or ()), *unseen(attempt.intended.expected, attempt.action, self._context(call, place)))

    # --- actions --------------------------------------------------------------------------------

    def _act(self, rule: Rule, call: int, place: str | None) -> None:
        """Do what the firing of a transition means for its call: send, cancel, or write assumed effects."""
        attempt, world, has_changed = self.attempts.get(call), self.knowledge.world, False
        self.counts[call] = 0 if rule.outcome is CallOutcome.WAITING else self.counts.get(call, 0) + (rule.outcome is CallOutcome.RUNNING)
        if attempt and rule.gives_up:
            self.alive.pop(attempt.request, None)
        if attempt and isinstance(rule.guard, guards.InvariantFalse):  # whatever its server reports, the call has not succeeded
            attempt.denied = dict.fromkeys(unmet(attempt.action.invariant, self._context(call, None)), "")
        match rule.action:
            case None:
                return
            case TransitionAction.ADOPT:
                self.counts[call] = self.adopted.pop(call).result.attempts
                return
            case TransitionAction.SEND:
                has_changed = self._send(call, self._context(call, place))
            case _ if attempt is None:
                pass  # no request was sent
            case TransitionAction.CANCEL:
                attempt.accepted = None
                self.commands.append(events.Cancel(attempt.request))
            case TransitionAction.BEGIN:
                attempt.accepted, attempt.begun = self.now, values_before(attempt.intended.start, world)
                has_changed = self._write(attempt.intended.start)
            case TransitionAction.FINISH:
                attempt.ended = finished(attempt.action, attempt.intended, self._context(call, place))
                attempt.begun = values_before(attempt.ended, world) | (attempt.begun or {})
                has_changed = self._write(attempt.ended)
            case TransitionAction.UNDO:
                if attempt.begun is not None:
                    has_changed = self._write(undo(attempt.begun, attempt.intended.start | (attempt.ended or {}), world))
                    attempt.begun = attempt.ended = None
            case _:
                assert_never(rule.action)
        if has_changed or self.has_result:
            self.has_result = False
            self._ask_about_knowledge()

    def _send(self, call: int, context: EvaluationContext) -> bool:
        """Send a request of the call, or carry out its operation on knowledge; return whether that has changed knowledge."""
        request, action = self._claiming(call, TransitionAction.SEND, context)
        # What it intends is computed now: as soon as the robot moves, sensors report some of it.
        intended = intention(replace(self.machine.plan.calls[call], action=action), context)
        self.attempts[call] = CallAttempt(self._number(call), request, action, intended)
        self.alive[request], self.is_stepping = call, False
        if action.operation is not None:
            performed = carry_out(request, action.operation, context)
            self.commands += performed.commands
            self.operated += performed.reports
            return performed.changes_knowledge
        fields, _ = goal(context.action, self.goal_fields, context)
        self.commands.append(events.Send(Request(request, action, fields, self.counts[call])))
        return False

    def _write(self, changes: Changes) -> bool:
        """Write what no sensor reports; return whether that has changed anything."""
        return bool(self.knowledge.world.record(self.knowledge.world.assumed(changes)))

    def _note_success(self, call: int, outcome: Outcome) -> None:
        """Store the result of the call, and note which conditions until its end were not so."""
        attempt, now = self.attempts[call], self.now
        if values := variables_of(outcome, self.machine.plan.calls[call], self.bindings.of(attempt.action.name)):
            self.knowledge.local.store(values)
            self.has_result = True
        was_watched = attempt.accepted is not None and attempt.accepted < now  # then the guard has seen all that broke before

        def breaks_now(part: Condition) -> bool:
            return was_watched and attempt.broken.get((part, False), now) >= now

        attempt.denied = {**(attempt.denied or {}), **denied_at_end(attempt.action, self._context(call, None), breaks_now)}

    # --- what is asked outside, and again -------------------------------------------------------

    def _context(self, step: int | None, place: str | None) -> EvaluationContext:
        """Return what conditions of a step are evaluated from; what is not decided at a place asks no questions."""
        calls, answers, asks = self.machine.plan.calls, self.questions.answers_at(place) or {}, self.asks and place is not None
        if step is None or step >= len(calls):
            return EvaluationContext(self.knowledge, answers=answers, asks=asks)
        return EvaluationContext(self.knowledge, calls[step].action, self.bindings.of(calls[step].action.name), answers, asks)

    def _foresee(self, rule: Rule, place: str) -> None:
        """Compute what an action is going to change, only to find out on which questions that depends; raise `Unanswered` for one."""
        context = self._context(rule.call, place)
        if rule.call is not None and rule.action is TransitionAction.SEND:
            intention(replace(self.machine.plan.calls[rule.call], action=ready(context.action, context)), context)
        elif rule.call is not None and rule.action is TransitionAction.FINISH:
            finished(self.attempts[rule.call].action, self.attempts[rule.call].intended, context)

    def _ask(self, place: str, step: int | None, question: Question) -> None:
        need = self.questions.need(place, subject_of(self.machine.plan, step), question, self.now, self.identity)
        self.commands += need.commands
        if need.until is None:  # it is answered, if only with nothing
            self.queue.append(place)
        else:
            self._ask_again(place, need.until)

    def _ask_again(self, place: str, moment: float) -> None:
        if moment < NEVER:
            self.moments.add((moment, self.net.places.index(place)))

    def _ask_about_knowledge(self) -> None:
        """Have all undecided places asked again at which a guard reads knowledge."""
        self.queue += [one for one in self.undecided if any(self.rules[t].guard.opened_by is Opener.KNOWLEDGE for t in self._asked_at(one))]

    def _asked_at(self, place: str) -> list[str]:
        """Return the transitions that take from a place, in the order of the net."""
        return [transition for transition, inputs in self.net.inputs.items() if place in inputs]

    # --- resources ------------------------------------------------------------------------------

    def _takes_resources(self, transition: str) -> bool:
        """Return whether the transition takes resources; what is adopted has them already."""
        is_adopted = self.rules[transition].action is TransitionAction.ADOPT
        return not is_adopted and not self.net.inputs[transition].keys().isdisjoint(self.machine.resource_places)

    def _claim(self, rule: Rule, place: str | None) -> Claim:
        request, action = self._claiming(rule.call or 0, rule.action, self._context(rule.call, place))
        return self.claims.claim(request, self.bindings.resources(action))

    def _claiming(self, call: int, action: TransitionAction | None, context: EvaluationContext) -> tuple[UUID, GroundAction]:
        """Return for which request, and with which parameters, a call claims resources: for the next request if one is being sent."""
        if action is TransitionAction.SEND:
            return self.identity(f"{call}/{self._number(call)}"), ready(context.action, context)
        return self.attempts[call].request, self.attempts[call].action

    def _number(self, call: int) -> int:
        """Return the number of the next request of the call."""
        return self.attempts[call].number + 1 if call in self.attempts else 1

    def _leave_line(self, place: str) -> None:
        """Wait for no resources at the place; others may have them now."""
        if self.claims.leave(place):
            self.queue += self.claims.served()


def _now_if(is_open: bool) -> float:
    return ALWAYS if is_open else NEVER
