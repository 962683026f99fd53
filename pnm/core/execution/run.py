"""One execution of one machine, without I/O: `Run.handle(event, now)` returns commands.

No clock, no threads, no waiting. Everything that moves a token is in this file. An event leads to at most one firing by itself (a
report opens one guard); then transitions fire one at a time until none is open, in a fixed order: places in the order in which they
were marked, at each place the first open rule. A place at which nothing is open yet is *undecided*; it is asked again when facts
change, when the run begins to end, or when its moment has come.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import assert_never
from uuid import UUID

from pnm.core.execution import events
from pnm.core.execution.call_results import Explanation, Hindered, Sent, own_arguments
from pnm.core.execution.guards import NEVER, OPENS
from pnm.core.execution.machine_index import Decision, Firing, Site
from pnm.core.execution.questions import subject_of
from pnm.core.execution.run_view import RunView
from pnm.core.logic.computed_values import Question, Unanswered
from pnm.core.machine.guards import After, EffectsMissing, InvariantFalse, Opener, Rule, Withheld
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import BEFORE_ACCEPTANCE, Accepted, CallOutcome, Ended, Feedback, OutcomeKind, Postponed, TransitionAction
from pnm.core.net.block_net import NumberedArcs

_SEND, _SUCCEEDED, _SUCCESS = TransitionAction.SEND, CallOutcome.SUCCEEDED, OutcomeKind.SUCCEEDED


class Run(RunView):
    """A machine, its marking and the requests of its calls.

    It is made as `RunView` says; its mutable state is what is set there.
    """

    def retire(self, kept: Collection[UUID] = ()) -> None:
        """Give back all resources but those of the requests kept: the run is not carried on. Open requests keep their resources."""
        self._claims.end(kept, {request: str(call.action) for request, call in self.open_calls.items()})

    def take_the_place_of(self, old: Run, now: float) -> frozenset[UUID]:
        """Go on where another run stands, whose requests this one was made with; return the questions that shall remain asked."""
        # Answers of people are known here as well, and what they are being asked is not asked again.
        subjects = (subject_of(self.machine.plan, call.index) for call in self.machine.plan.calls)
        questions = self._questions.inherit(old._questions, frozenset(subjects))
        self._state.settled.update(old._state.settled)
        self._calls.go_on_with(old._calls)
        old.retire(self.open_requests)  # now that this one has claimed what it adopts, which is therefore not free for a moment
        if old.pausing:  # before `Begin`, so that nothing starts during a pause of the old one
            self.handle(old.pausing, now)
        if old.hands:
            self.handle(events.InHands(old.hands), now)
        return questions

    def handle(self, event: events.Event, now: float) -> list[events.Command]:
        """Take one event in and return what is to be done about it."""
        state, self._fired, self._told = self._state, [], []
        if now > state.now:  # guards compare times with each other, so the run's clock never goes back
            state.now = now
        match event:
            case Accepted() | Ended():
                # a request taken over may end before the run has begun: its place is not marked yet
                (self._report if state.has_begun else self._early.append)(event)
            case events.Begin():
                self._agenda.places.extend(state.begin())
            case events.Restarted():
                self._agenda.ask_for_timer_anew()
                for sent in self._calls.open.values():  # the answer to a dead process is not heard: the limit for the next one begins anew
                    self._guards.postpone(sent)
                self._commands += (*self._questions.again(), *self._calls.again(), *map(events.Cancel, state.settled))
                self._agenda.ask_undecided()
            case events.KnowledgeChanged():
                self._agenda.ask_about_knowledge(state.now)
            case events.ResourcesChanged():
                self._agenda.places.extend(self._claims.served())
            case events.Tick():
                self._agenda.ask_due(state.now)
            case events.SingleStep():
                state.follow(event)
                self._agenda.ask_undecided()
                self._settle()
                state.is_stepping = False
                self._agenda.ask_undecided()  # those that could not begin leave the lines for resources
            case events.Stop() | events.Pause() | events.Resume() | events.InHands():
                state.follow(event)
                if isinstance(event, events.Stop) and event.cancel:  # nothing is asked any more, so that no answer holds up the end
                    self._commands += self._questions.close("the run was stopped")
                self._agenda.ask_undecided()  # guards that were put off report no change by themselves
            case events.Answered(identity, value, message):
                place = self._questions.answered(identity, value, message)
                self._agenda.places.extend([] if place is None else [place])
            case events.Settled(request) if request in self._calls.open:
                state.settled[request] = event
                self._commands.append(events.Cancel(request))
            case events.Settled():  # it has ended meanwhile
                pass
            case Postponed(request):
                self._guards.postpone(self._calls.open.get(request))
            case Feedback():  # it moves no token
                if call := self._calls.note_feedback(event):
                    self.observer.progressed(call, event.text, state.now)
            case _:
                assert_never(event)
        self._settle()
        while self._early and state.has_begun:  # one at a time, each with all that follows from it, as if it had come only now
            self._report(self._early.pop(0))
            self._settle()
        # compared at the end of the event, so that waiting for a moment in between is not reported
        if (self._waits or self._questions.asked) and self._waits != self.awaits_answers:
            self._waits = not self._waits
            self.observer.waiting(self._waits, now)
        commands, self._commands = self._commands, []
        return commands

    def _report(self, report: Accepted | Ended) -> None:
        call = self._calls.open.get(report.request)
        if call is None:
            self.observer.orphaned(report, self._state.now)
            if isinstance(report, Ended):
                self.resources.confirm(report.request)
                self._agenda.places.extend(self._claims.served())
            return
        kind = None
        if isinstance(report, Ended):
            outcome, kind, now = report.outcome, report.outcome.kind, self._state.now
            if self._state.settled:
                self._state.settled.pop(report.request, None)
            if self._calls.attempts[call].accepted is None and kind not in BEFORE_ACCEPTANCE:
                self._take(call, None)  # a client may leave out what goes without saying
            del self._calls.open[report.request]  # before the firing, so that observers and guards see the request as over
            if kind is _SUCCESS and self._calls.succeeded(call, outcome, now):
                self._has_changed_knowledge = True  # stored before the firing: effects and checks after it may read results
            self._results.answered(call, outcome)  # before the firing as well: the explanation of a failure quotes the message
            if self.observer is not events.SILENT:
                self.observer.ended(self._calls.as_sent(call), outcome, now)
        if not self._take(call, kind):
            self.observer.orphaned(report, self._state.now)

    def _take(self, call: int, kind: OutcomeKind | None) -> bool:
        """Fire the transition of the call that the end of its request in this way opens, or its acceptance, if there is one."""
        site, tokens = self._index.of_calls[call], self._tokens
        for firing in site.shape.opened[kind]:
            if tokens[site.place + firing.inputs[0]] and not self._engine.missing[site.transition + firing.number]:
                self._fire(site, firing, None)  # one at most: the request is waited for at one place at a time
                return True
        return False

    def _settle(self) -> None:
        """Fire open transitions until there is none, then ask to be woken at the next moment."""
        places, reports, tokens, missing = self._places, self._reports, self._tokens, self._engine.missing
        sites, codes = self._index.sites, self._index.codes
        while places or reports:
            # ends of operations on knowledge first: no other call sees the operation done and its own call not
            if reports:
                self._report(reports.popleft())
            elif tokens[place := places.popleft()]:  # otherwise the token has gone since it was put on the agenda
                site = sites[place]
                decision = site.shape.decisions[codes[place]]
                if (passage := decision.passage) is None:
                    self._decide(place, site, decision)
                elif not missing[site.transition + passage.number]:
                    self._fire(site, passage, place)
        if (time := self._agenda.next_timer()) is not None and not self._state.over:
            self._commands.append(events.Wake(time))

    def _decide(self, place: int, site: Site, decision: Decision) -> None:
        """Fire the first open transition that takes from the place; if there is none, note when to ask again."""
        state = self._state
        now, again, asking = state.now, NEVER, False
        if state.ending or state.pause or state.hands:
            firings, waiting = decision.firings, decision.awaits
        elif (limit := decision.limit) is not None and (until := self._guards.waits_until(site, limit, place)) > now:  # as below, at once
            self._agenda.wait_until(place, until)
            return
        else:
            firings, waiting = decision.staying, decision.stays
        missing, guards, asks, first = self._engine.missing, self._guards, self._calls.asks, site.transition
        for firing in firings:
            # a transition that lacks nothing but resources is asked all the same: its call has to stand in line for them
            if firing.counts and missing[first + firing.number] and not (firing.takes and guards.lacks_resources(first + firing.number)):
                continue
            if asking and firing.rule.guard.opened_by is not Opener.TIME:
                continue
            try:
                if (firing.takes or state.pause or state.hands) and self._is_put_off(site, firing, place):
                    waiting = True
                    break  # the rules after this one are asked when it may be asked itself
                opens = OPENS[firing.guarded](guards, site, firing, place)
                # what effects depend on is asked before the firing, which cannot wait for answers
                if asks and opens <= now and (call := site.step_of(firing)) is not None:
                    self._calls.compute_intention(firing.action, call, guards.context(call, place))
            except Unanswered as needed:
                # an earlier rule goes first as soon as its question is answered, so no later one may fire meanwhile but timers, which
                # no question stops; and nothing is claimed during that time, for answers of people may take long
                self._ask(place, site.step_of(firing), needed.question)
                self._leave_line(place)
                waiting = asking = True
                continue
            if opens <= now:
                self._fire(site, firing, place)
                return
            waiting = True
            if opens < again:
                again = opens
            if firing.takes:  # it is not open, so it must not keep others from the resources while it waits for something else
                self._leave_line(place)
        if waiting:  # a place where nothing was even enabled is asked again when a token arrives, which puts it on the agenda anyway
            self._agenda.wait(place, listens=decision.listens)
        if again < NEVER:
            self._agenda.set_timer(place, again)

    def _ask(self, place: int, call: int | None, question: Question) -> None:
        needed = self._questions.need(place, subject_of(self.machine.plan, call), question, self._state.now, self._calls.identity)
        self._commands += needed.commands
        if needed.until is None:  # it is answered, if only with nothing
            self._agenda.places.append(place)
        else:
            self._agenda.set_timer(place, needed.until)

    def _is_put_off(self, site: Site, firing: Firing, place: int) -> bool:
        """Return whether the transition must wait: for the end of a pause, for a person, or for the resources of its call."""
        state, begins = self._state, firing.takes or firing.action is TransitionAction.SEND
        is_paused = state.pause is not None and not state.is_stepping
        if not begins or not (is_paused or self._guards.in_hands(site, firing, place)):  # what is sent goes on; in a pause nobody is asked
            return firing.takes and not self._guards.has_resources(site, firing, place)
        self._leave_line(place)
        return True

    def _leave_line(self, place: int) -> None:
        """No longer wait for resources at the place; calls behind it in line may have them now."""
        if self._claims.leave(place):
            self._agenda.places.extend(self._claims.served())

    def _fire(self, site: Site, firing: Firing, place: int | None) -> None:
        """Fire a transition that was decided on at the place, or opened by a report.

        The order within matters. Before the tokens move: what explains the firing is looked at in the state that led to it, and
        resources are claimed and requests made for where the call then is. After: resources are given back, and failures noted,
        which change whether the run is ending; then the places marked are put on the agenda, and the undecided ones if it is.
        """
        now, number = self._state.now, site.transition + firing.number
        if firing.matters:
            self._fire_apart(site, firing, place)
        else:
            if (call := firing.call if site.call is None else site.call) is not None:
                if (outcome := firing.outcome) is not None:
                    self._turn(outcome, call, now)
                if (action := firing.action) is not None:
                    self._perform(action, call, place, now)
            # a counted place of the block itself keeps a transition from being a move; behind a port it is another matter for each block
            if (move := firing.move) is None or (move[1] < 0 and self._counted[site.ports[~move[1]][0]]):
                taken, given = site.arcs_of(firing)
                self._engine.move(taken, given)
                self._leave_and_mark(taken, given, site.all_at(firing.decided), now)
            else:
                code, its_code = move
                left = site.place + code if code >= 0 else site.ports[~code][0]
                marked = site.place + its_code if its_code >= 0 else site.ports[~its_code][0]
                self._tokens[left] -= 1
                self._tokens[marked] += 1
                if left in self._undecided or left in self._noted:
                    self._leave(left)
                self._marked_at[marked] = now
                if firing.decided:
                    self._places.append(marked)
        self._fired.append(number)
        if self.observer is not events.SILENT:
            self.observer.fired(fired := events.Fired(self._index.blocks, number, firing.rule), now)
            if firing.action is TransitionAction.CANCEL:
                match fired.rule:
                    case Rule(guard=After(limit), call=int(call), cause=None):
                        self.observer.late(self._calls.as_sent(call), limit, now)

    def _fire_apart(self, site: Site, firing: Firing, place: int | None) -> None:
        """Fire a transition that matters to more than its call."""
        number, state, marked_at = site.transition + firing.number, self._state, self._state.now
        taken, given = site.arcs_of(firing)
        rule = self._index.rules[number] if firing.tells or firing.fails else firing.rule
        call, step = firing.call if site.call is None else site.call, site.step_of(firing)
        check = None if rule.cause is None else self._guards.explain_check(rule, place)
        if firing.takes and step is not None:
            self._claims.take(step, self._guards.claim(site, firing, place))
        if call is not None:
            if (outcome := firing.outcome) is not None:
                self._turn(outcome, call, state.now)
            if firing.tells:
                self._tell(rule, call, place, None if firing.fails else check)
            if firing.guarded is InvariantFalse:
                self._calls.attempts[call].interrupt(self._guards.context(call, None))
            if firing.action is not None:
                self._perform(firing.action, call, place, state.now, is_turn=bool(firing.turns))
        if check is not None:
            self._results.last_check = check
        if firing.action is TransitionAction.ADOPT and call is not None:
            marked_at = state.adopted.pop(call).accepted  # its limits count from there
        self._engine.move(taken, given)
        # After the firing: only now are the tokens of the resources back on their places, for other calls to take.
        if firing.gives and step is not None:
            if rule.gives_up:  # the request keeps its resources
                names = self._claims.withhold(step, str(self._calls.action(step)))
                self.observer.withheld(self._calls.as_sent(step), names, state.now)
            else:
                self._claims.give(step)
            self._places.extend(self._claims.served())  # of this run: the listener on the executor only notices with the next event
        guard, lacking = rule.guard, tuple[str, ...]()
        if firing.fails and isinstance(guard, Withheld):
            lacking = tuple(self._guards.withheld(guard.call, guard, place))
        failing = [self._index.failures[place] for place in site.all_at(firing.fails)]
        failures = [self._results.failed(one, state.now, check, rule, lacking) for one in failing]
        begins_to_end = firing.turns and state.turn()
        for failure in failures:
            if self._tells:
                cause = Explanation(failure.cause, failure.expected, failure.observed)
                own = own_arguments(failure.call, self.machine.plan) if isinstance(failure.call, ActionCall) else None
                self._told.append(Hindered(failure.call.index, cause, is_failure=True, arguments=own))
            self.observer.failed(failure, state.now)
        self._leave_and_mark(taken, given, site.all_at(firing.decided), marked_at)
        if begins_to_end:  # everything that waits has an exit for that, which has just opened
            self._agenda.ask_undecided()

    def _turn(self, outcome: CallOutcome, call: int, now: float) -> None:
        """Note an outcome of a call, and tell which of its declared ones it is, if its action has several."""
        if outcome is not _SUCCEEDED:
            self._results.turned(outcome, call, now)
            return
        declared = self._calls.declared(call)
        self._results.turned(outcome, call, now, self._calls.is_assumed(call), declared)
        if declared:
            self.observer.turned_out(self._calls.as_sent(call), declared, now)

    def _leave_and_mark(self, taken: NumberedArcs, given: NumberedArcs, decided: list[int], marked_at: float) -> None:
        """Wait for nothing more at the places that tokens have left; put those that they have reached on the agenda."""
        undecided, noted, at = self._undecided, self._noted, self._marked_at
        for left, _ in taken:
            if left in undecided or left in noted:
                self._leave(left)
        for marked, _ in given:
            at[marked] = marked_at
        self._places.extend(decided)

    def _leave(self, place: int) -> None:
        """Wait for nothing more at a place that a token has left."""
        self._agenda.leave(place)
        if self._claims.waiting:
            self._leave_line(place)
        if place in self._noted:
            self._commands.extend(map(events.Withdraw, self._guards.forget(place)))

    def _tell(self, rule: Rule, call: int, place: int | None, check: Explanation | None) -> None:
        """Note a hindrance of the call, or that it is not needed or given up, and tell the observer."""
        sent, now = self._calls.as_sent(call), self._state.now
        unseen = self._calls.explain_unseen(call, self._guards.context(call, place)) if isinstance(rule.guard, EffectsMissing) else None
        if cause := self._results.hindered(rule, call, check, unseen):
            if self._tells:
                self._told.append(Hindered(call, cause, arguments=own_arguments(sent, self.machine.plan)))
            self.observer.hindered(sent, cause, now)
        if rule.outcome is CallOutcome.ALREADY_TRUE:
            self.observer.spared(sent, now)
        if rule.gives_up:
            self._calls.open.pop(self._calls.attempts[call].request, None)

    def _perform(self, action: TransitionAction, call: int, place: int | None, now: float, *, is_turn: bool = False) -> None:
        """Carry out the action of a transition; `is_turn` if the run may begin to end with it."""
        calls = self._calls
        if action is _SEND:
            count = self._results.current(call).attempts
            commands, reports, changes_knowledge = calls.send(call, count, self._questions.answers_at(place))
            if (sent := calls.as_sent(call)) is not self._results.current(call).call:
                self._results.sent(sent)
            self._state.is_stepping = False
            for command in commands:
                if isinstance(command, events.Send):
                    if self._tells:
                        own = own_arguments(sent, self.machine.plan)
                        self._told.append(Sent(command.request.id, call, command.request.attempt, own))
                    self.observer.sent(sent, command.request, now)
            self._reports += reports
        elif action is TransitionAction.ADOPT:  # the request is known since the run was made
            self._results.adopted(calls.as_sent(call), self._state.adopted[call].result)
            return
        else:
            commands, _, changes_knowledge = calls.perform(action, call, self._questions.answers_at(place), now)
        if commands:
            self._commands += commands
        # Results of the request may have been stored just before, even if the action itself writes nothing.
        if changes_knowledge or self._has_changed_knowledge:
            self._has_changed_knowledge = False
            self._agenda.ask_about_knowledge(now, of_all=is_turn)
