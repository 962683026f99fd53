"""One execution of one machine, without I/O: `Run.handle(event, now)` returns commands.

No clock, no threads, no waiting. Everything that moves a token is in this file. An event leads
to at most one firing by itself (a report opens one guard); then transitions fire one at a time
until none is open, in a fixed order: places in the order in which they were marked, at each
place the first open rule. A place at which nothing is open yet is *undecided*; it is asked
again when facts change, when the run begins to end, or when its moment has come.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from heapq import heappop, heappush
from typing import Final, assert_never
from uuid import UUID

from pnm.core.execution.call_requests import Calls, GoalFields, UnderWay
from pnm.core.execution.call_results import Explanation, Ledger, RunResult
from pnm.core.execution.effect_checks import is_assumed
from pnm.core.execution.events import (
    Answered,
    Ask,
    Begin,
    Command,
    Event,
    KnowledgeChanged,
    Observer,
    Pause,
    ResourcesChanged,
    Resume,
    Send,
    Stop,
    Tick,
    Wake,
    Withdraw,
)
from pnm.core.execution.guards import NEVER, Decision
from pnm.core.execution.handover import check_adoption
from pnm.core.execution.questions import Questions
from pnm.core.execution.resources import Claims, Resources
from pnm.core.execution.run_state import Roles, Situation
from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import Question, Unanswered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import Accepts, Ends, PetriNetMachine, Rule, TransitionAction, Withheld
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Report
from pnm.core.net.firing_engine import Engine
from pnm.core.net.net import Marking
from pnm.errors import RunError

_NONE: Final[Mapping[int, UnderWay]] = {}


def _unknown_fields(action: GroundAction) -> None:
    """Know nothing about the goal message of the action."""


class Run:
    """A machine, its marking and what its calls are doing.

    Args:
        machine: what is executed.
        knowledge: what guards ask, and what effects and results are written to.
        id: the identities of all requests follow from it.
        bindings: where goal data comes from and where results go.
        goal_fields: tells which fields the goal of an action must have, as far as is known.
        asks: whether there is anybody outside to be asked.
        observer: is told what happens.
        origin: the time from which releases count; the beginning of the run when not given.
        resources: what its calls share with other runs; what the plan says of them is its own when not given.
        task: on whose behalf resources are claimed; its own when not given.
        priority: how its claims stand among those of others.
        adopted: for the number of every call that the plan says is under way, the request that it takes over.

    The mutable state is what the constructor sets under "state".
    """

    def __init__(
        self,
        machine: PetriNetMachine,
        knowledge: Layered,
        *,
        id: UUID,
        bindings: Bindings | None = None,
        goal_fields: GoalFields = _unknown_fields,
        asks: bool = False,
        observer: Observer | None = None,
        origin: float | None = None,
        resources: Resources | None = None,
        task: UUID | None = None,
        priority: int = 0,
        adopted: Mapping[int, UnderWay] = _NONE,
    ) -> None:
        self.machine = machine
        self.knowledge = knowledge
        self.id = id
        self.resources = Resources(machine.capacities) if resources is None else resources
        _check_capacities(machine, self.resources)
        self.task = id if task is None else task
        self._observer = observer or Observer()
        self._roles = Roles(machine)
        # state
        self._engine = Engine(machine.compiled, machine.initial)
        self._began: float | None = None
        self._agenda: deque[int] = deque()
        self._undecided: dict[int, None] = {}
        self._timers: list[tuple[float, int]] = []
        self._scheduled: dict[int, float] = {}
        self._wake = NEVER
        self._commands: list[Command] = []
        self._questions = Questions()
        self._asked = 0
        self._waits = False
        self._calls = Calls(id, machine.plan, knowledge, bindings or Bindings(), goal_fields, asks=asks)
        self._ledger = Ledger(machine.plan)
        self._situation = Situation(self._engine, self._roles, self._ledger, origin)
        self._claims = Claims(self.resources, self.task, priority)
        self._decision = Decision(self._situation, self._calls, self._claims, self._questions, adopted)
        self._early: list[Report] = []
        """Reports about requests taken over that came before the beginning."""
        self._adopt(adopted)

    def _adopt(self, adopted: Mapping[int, UnderWay]) -> None:
        """Know of the requests that are taken over, and have what they have.

        Raises:
            RunError: they are not those that the plan speaks of, or have more than there is.
        """
        check_adoption(self.machine, adopted, self._calls.resources)
        for call, taken in adopted.items():
            self._calls.adopt(call, taken)
            if taken.resources:
                self._claims.keep(call, self._claims.claim(taken.request, taken.resources))

    # --- what a caller sees -------------------------------------------------------------------

    @property
    def marking(self) -> Marking:
        """The current marking."""
        return self._engine.marking()

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return self._situation.over

    @property
    def begun(self) -> bool:
        """Whether the run has begun."""
        return self._began is not None

    @property
    def ending(self) -> bool:
        """Whether nothing more is started: a failure or restart place is marked, or the run was told to stop."""
        return self._situation.ending

    @property
    def stopped(self) -> bool:
        """Whether the run was told to stop."""
        return self._situation.stop is not None

    @property
    def pausing(self) -> Pause | None:
        """What the run was told about a pause that has not ended."""
        return self._situation.pause

    @property
    def paused(self) -> bool:
        """Whether the run was told to pause, and nothing is under way any more."""
        return self._situation.pause is not None and self._situation.idle

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._questions.wait_for_people and self._situation.idle and not self._claims.is_waiting

    @property
    def open_requests(self) -> tuple[UUID, ...]:
        """The requests that are not over, as far as is known."""
        return tuple(self._calls.open)

    @property
    def open_calls(self) -> dict[UUID, ActionCall]:
        """The calls whose requests are not over, as far as is known, as they were sent."""
        return {request: self._calls.as_sent(call) for request, call in self._calls.open.items()}

    def arguments(self, call: ActionCall) -> tuple[str, ...]:
        """Return what the parameters of a call would have for values if it were sent now, as far as that is known; else their names."""
        return self._calls.arguments(call.index)

    def result(self) -> RunResult:
        """Return how the run ended."""
        if not self.over:
            raise RunError(f"the run is not over: {self.marking}")
        goal = bool(self._engine.tokens[self._roles.goal])
        return RunResult(goal, self._reason(goal), self._ledger.told(), tuple(self._ledger.failures), self._situation.stop is not None)

    def under_way(self) -> tuple[UnderWay, ...]:
        """Return the requests that were accepted and that nobody cancels: a successor can take them over."""
        return self._calls.under_way(self._ledger.results)

    @property
    def settling(self) -> tuple[ActionCall, ...]:
        """The calls that have succeeded, and whose effects are still to be looked for: nobody can take them over."""
        return tuple(self._calls.as_sent(call) for place, call in self._roles.settling.items() if self._engine.tokens[place])

    def retire(self, kept: Collection[UUID] = ()) -> None:
        """Give back all resources but what these requests have: the run is not carried on. What is not over keeps what it has."""
        self._claims.end(kept, {request: str(call.action) for request, call in self.open_calls.items()})

    def inherit(self, old: Run) -> frozenset[UUID]:
        """Know what people have answered the run that this one succeeds; return the questions that shall remain asked."""
        subjects = (_subject(self.machine.plan, call.index) for call in self.machine.plan.calls)
        return self._questions.inherit(old._questions, frozenset(subjects))

    def told(self) -> RunResult:
        """Return how far the run has come, for one that is succeeded by another."""
        handed = {one.call.index for one in self.under_way()}
        return RunResult(
            False, "another run goes on", self._ledger.told(handed), tuple(self._ledger.failures), self._situation.stop is not None
        )

    def _reason(self, goal: bool) -> str:
        if goal:
            return "the goal holds"
        if self._situation.stop:
            return self._situation.stop.reason
        if self._ledger.failures:
            return str(self._ledger.failures[0])
        expected, seen = self._decision.explain(self.machine.plan.goal, None)
        return f"every call is done but the goal does not hold: expected {expected}; observed {seen}"

    def __repr__(self) -> str:
        state = "over" if self.over else "ending" if self.ending else "going on"
        return f"<Run {self.machine!r}, {len(self._calls.open)} requests open, {state}>"

    # --- events -------------------------------------------------------------------------------

    def handle(self, event: Event, now: float) -> list[Command]:
        """Take one event in and return what is to be done about it."""
        self._situation.now = max(now, self._situation.now)
        match event:
            case Begin():
                self._begin()
            case KnowledgeChanged():
                self._agenda.extend(place for place in self._undecided if self._roles.listening[place])
            case ResourcesChanged():
                self._agenda.extend(self._claims.served())
            case Tick():
                self._wake = NEVER
                while self._timers and self._timers[0][0] <= self._situation.now:
                    self._agenda.append(heappop(self._timers)[1])
                    self._scheduled.pop(self._agenda[-1], None)
            case Stop():
                if self._situation.stop is None or event.cancel:
                    self._situation.stop = event
                self._agenda.extend(self._undecided)
            case Pause(at_once):
                self._situation.pause = Pause(at_once or (self._situation.pause is not None and self._situation.pause.at_once))
                self._agenda.extend(self._undecided)
            case Resume():
                self._situation.pause = None
                self._agenda.extend(self._undecided)
            case Answered(identity, value, message):
                place = self._questions.answered(identity, value, message)
                self._agenda.extend([] if place is None else [place])
            case Accepted() | Ended() if self._began is None:
                self._early.append(event)
            case Accepted() | Ended():
                self._report(event)
            case _:
                assert_never(event)
        self._settle()
        while self._began is not None and self._early:
            self._report(self._early.pop(0))
            self._settle()
        if self._waits != self.awaits_answers:
            self._waits = not self._waits
            self._observer.waiting(self._waits, now)
        commands, self._commands = self._commands, []
        return commands

    def _begin(self) -> None:
        if self._began is not None:
            raise RunError("the run has begun already")
        self._began = self._situation.now
        self._situation.origin = self._situation.now if self._situation.origin is None else self._situation.origin
        self._agenda.extend(place for place, tokens in enumerate(self._engine.tokens) if tokens and place not in self._roles.records)

    def _report(self, report: Report) -> None:
        call = self._calls.open.get(report.request)
        if call is None:
            self._observer.orphaned(report, self._situation.now)
            if isinstance(report, Ended):
                self.resources.confirm(report.request)
                self._agenda.extend(self._claims.served())
            return
        if isinstance(report, Ended):
            if report.outcome.kind not in _BEFORE_ACCEPTANCE:
                self._take(call, Accepted(report.request))  # a client may leave out what goes without saying
            del self._calls.open[report.request]
            self._note_outcome(call, report.outcome)
        if not self._take(call, report):
            self._observer.orphaned(report, self._situation.now)

    def _take(self, call: int, report: Report) -> bool:
        """Fire the transition of the call that the report opens, if there is one."""
        self._decision.place = None
        for transition in self._roles.reported[call]:
            if self._engine.is_enabled(transition) and _admits(self._roles.rules[transition], report):
                self._fire(transition)
                return True
        return False

    def _note_outcome(self, call: int, outcome: Outcome) -> None:
        if outcome.kind is OutcomeKind.SUCCEEDED:
            self._calls.store(call, outcome)
        self._ledger.answered(call, outcome)
        self._observer.ended(self._calls.as_sent(call), outcome, self._situation.now)

    # --- δ̂ ------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Fire open transitions until there is none, then ask to be woken at the next moment."""
        while self._agenda or self._calls.reports:
            if self._calls.reports:
                self._report(self._calls.reports.popleft())
            else:
                self._decide(self._agenda.popleft())
        self._commands += self._calls.commands
        self._calls.commands.clear()
        if self._timers and self._timers[0][0] < self._wake and not self.over:
            self._wake = self._timers[0][0]
            self._commands.append(Wake(self._wake))

    def _decide(self, place: int) -> None:
        """Fire the first open transition that takes from the place; if there is none, note when to ask again."""
        if not self._engine.tokens[place]:
            return
        self._decision.place = place
        again, waiting, takes = NEVER, False, self._roles.takes
        for transition, _ in self._engine.compiled.consumers[place]:
            if not self._engine.is_enabled(transition) and not (transition in takes and self._decision.lacks_resources(transition)):
                continue
            try:
                if (transition in takes or self._situation.pause) and self._is_put_off(transition, place):
                    waiting = True
                    break  # the rules after this one are asked when it may be asked itself
                opens = self._decision.opens(transition, place)
                if opens <= self._situation.now and (call := self._roles.rules[transition].call) is not None:
                    self._calls.foresee(self._roles.rules[transition].action, call, self._decision.consult(call))
            except Unanswered as needed:  # and so are all rules after this one
                self._ask(place, self._roles.rules[transition].call, needed.question)
                self._leave_line(place)
                waiting = True
                break
            if opens <= self._situation.now:
                self._fire(transition)
                return
            again, waiting = min(again, opens), True
            if transition in takes:
                self._leave_line(place)
        if waiting:
            self._undecided[place] = None
        if again < NEVER and self._scheduled.get(place) != again:
            self._scheduled[place] = again
            heappush(self._timers, (again, place))

    # --- resources ----------------------------------------------------------------------------

    def _is_put_off(self, transition: int, place: int) -> bool:
        """Tell whether the transition must wait: for the end of a pause, or for what the call needs for itself."""
        takes = transition in self._roles.takes
        if self._situation.pause and (takes or self._roles.rules[transition].action is TransitionAction.SEND):
            self._leave_line(place)
            return True
        return takes and not self._decision.has_resources(transition, place)

    def _leave_line(self, place: int) -> None:
        """No longer wait for resources at the place; whoever waits behind it may have them now."""
        if self._claims.leave(place):
            self._agenda.extend(self._claims.served())

    def _ask(self, place: int, call: int | None, question: Question) -> None:
        if self._questions.is_asked(place, question):
            return
        if self._questions.take_up(place, _subject(self.machine.plan, call), question):
            self._agenda.append(place)
            return
        self._asked += 1
        identity = self._calls.identity(f"question {self._asked}")
        self._questions.ask(identity, place, _subject(self.machine.plan, call), question)
        self._commands.append(Ask(identity, question))

    # --- firing -------------------------------------------------------------------------------

    def _fire(self, transition: int) -> None:
        compiled, rule = self._engine.compiled, self._roles.rules[transition]
        fails = [place for place, _ in compiled.outputs[transition] if place in self._roles.failures]
        check = self._decision.explain_check(rule)
        if transition in self._roles.takes and rule.call is not None:
            self._claims.take(rule.call, self._decision.claim(transition))
        if rule.call is not None and rule.call < len(self.machine.plan.calls):
            self._note(rule, rule.call, None if fails else check)
            if rule.action is not None:
                self._do(rule.action, rule.call)
                if self._calls.changed:
                    self._calls.changed = False
                    self._agenda.extend(place for place in self._undecided if self._roles.listening[place])
        was_ending, arrived = self._situation.ending, self._situation.now
        if rule.action is TransitionAction.ADOPT and rule.call is not None:
            arrived = self._decision.adopted.pop(rule.call).accepted
        self._engine.fire(transition)
        if transition in self._roles.gives and rule.call is not None:
            self._give(rule, rule.call)
        for place in fails:
            self._fail(self._roles.failures[place], rule, check)
        for place, _ in compiled.inputs[transition]:
            self._leave(place)
        for place, _ in compiled.outputs[transition]:
            self._decision.arrived[place] = arrived
            if place not in self._roles.records:
                self._agenda.append(place)
        if self._situation.ending and not was_ending:
            self._agenda.extend(self._undecided)
        self._observer.fired(compiled.transitions[transition], rule, self._situation.now)

    def _give(self, rule: Rule, call: int) -> None:
        """Give back what the call has; if its request was given up, that keeps it."""
        if rule.gives_up:
            names = self._claims.withhold(call, str(self._calls.action(call)))
            self._observer.withheld(self._calls.as_sent(call), names, self._situation.now)
        else:
            self._claims.give(call)
        self._agenda.extend(self._claims.served())

    def _do(self, deed: TransitionAction, call: int) -> None:
        self._calls.do(deed, call, self._ledger.results[call].attempts, self._decision.consult(call))
        if deed is TransitionAction.BEGIN:
            self._calls.accepted[call] = self._situation.now
        elif deed is TransitionAction.ADOPT:
            self._ledger.adopted(self._calls.as_sent(call), self._decision.adopted[call].result)
        elif deed is TransitionAction.SEND:
            sent = self._calls.as_sent(call)
            self._ledger.sent(sent)
            for command in self._calls.commands:
                if isinstance(command, Send):
                    self._observer.sent(sent, command.request, self._situation.now)
            self._commands += self._calls.commands
            self._calls.commands.clear()

    def _leave(self, place: int) -> None:
        """Forget what the decision at the place was made from."""
        self._undecided.pop(place, None)
        self._leave_line(place)
        self._commands.extend(map(Withdraw, self._decision.left(place)))

    def _note(self, rule: Rule, call: int, check: Explanation | None) -> None:
        assumed = rule.action is TransitionAction.FINISH and is_assumed(self._calls.action(call), self._decision.consult(call))
        self._ledger.fired(rule, call, self._situation.now, check, missing=self._decision.missing.get(call, ()), assumed=assumed)
        if rule.gives_up:
            self._calls.forget(call)

    def _fail(self, step: int, rule: Rule, check: Explanation | None) -> None:
        lacking = tuple(self._decision.withheld(rule.guard)) if isinstance(rule.guard, Withheld) else ()
        failure = self._ledger.failed(step, self._situation.now, check, rule, lacking)
        self._observer.failed(failure, self._situation.now)


def _check_capacities(machine: PetriNetMachine, resources: Resources) -> None:
    """Refuse a machine made for other capacities: what is free for a call must be free in its net."""
    for name, capacity in machine.capacities.items():
        if capacity != resources.capacity(name):
            raise RunError(f"the machine was generated for {capacity} calls with {name}; {resources.capacity(name)} may have it")


_BEFORE_ACCEPTANCE: Final = frozenset({OutcomeKind.REJECTED, OutcomeKind.UNAVAILABLE, OutcomeKind.LOST})
"""Ends that do not tell whether the goal was accepted before."""


def _subject(plan: PlanGraph, call: int | None) -> str:
    """Say what a question is asked for: the action as the plan has it."""
    return "" if call is None or call >= len(plan.calls) else str(plan.calls[call].action)


def _admits(rule: Rule, report: Report) -> bool:
    if isinstance(report, Accepted):
        return isinstance(rule.guard, Accepts)
    return isinstance(rule.guard, Ends) and report.outcome.kind in rule.guard.kinds
