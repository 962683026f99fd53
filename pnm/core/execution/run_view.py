"""The parts of a run, and the view of others: nothing here changes it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from math import inf
from typing import Any, Final
from uuid import UUID

from pnm.core.execution.call_data import GoalFields
from pnm.core.execution.call_requests import Calls
from pnm.core.execution.call_results import CallResult, CallResults, RunResult, Told
from pnm.core.execution.events import SILENT, Command, Observer, Pause
from pnm.core.execution.guards import Guards
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.machine_index import index_of
from pnm.core.execution.questions import Questions
from pnm.core.execution.run_state import Agenda, RunState
from pnm.core.kept_state import KeptState
from pnm.core.knowledge_base import Layered
from pnm.core.logic.effects import Changes
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.bindings import Bindings, WhenLost
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Accepted, CallOutcome, Ended, Report, TransitionAction
from pnm.core.net.block_net import Engine
from pnm.core.net.net import Marking
from pnm.core.resources import Resources, RunClaims
from pnm.errors import RunError

_NONE: Final[Mapping[int, UnderWay]] = {}
_TO_COME: Final = frozenset({CallOutcome.WAITING, CallOutcome.SUSPENDED})


class RunView(KeptState):
    """A run as its caller sees it: its marking, what is under way, and how it ended; what moves its tokens is `pnm.core.execution.run`.

    Args:
        machine: what is executed.
        knowledge: what guards ask, and what effects and results are written to.
        id: the identities of all requests follow from it.
        bindings: where goal data comes from and where results go.
        goal_fields: returns which fields the goal of an action must have, as far as is known.
        asks: whether questions can be asked outside.
        observer: is notified of what happens.
        origin: the time from which releases count; the beginning of the run when not given.
        resources: what its calls share with other runs, for whose capacities the machine was generated; its own when not given.
        task: on whose behalf resources are claimed; its own when not given.
        priority: how its claims stand among those of others.
        adopted: for the number of every call that the plan marks as under way, the request that it takes over.
        tells: whether `told` is noted, for its journal.
        kept: the state with which it goes on, as its `values` have told it; what it claims is claimed already.

    The mutable state is what the constructor sets under "state".

    Raises:
        RunError: the machine was generated for other capacities, or does not fit the requests that it takes over.
    """

    KEPT = ("_early", "_waits", "_has_changed_knowledge")

    def __init__(
        self,
        machine: PetriNetMachine,
        knowledge: Layered,
        *,
        id: UUID,
        bindings: Bindings | None = None,
        goal_fields: GoalFields = lambda _: None,
        asks: bool = False,
        observer: Observer | None = None,
        origin: float | None = None,
        resources: Resources | None = None,
        task: UUID | None = None,
        priority: int = 0,
        adopted: Mapping[int, UnderWay] = _NONE,
        tells: bool = False,
        kept: Mapping[str, Any] | None = None,
    ) -> None:
        self.machine, self.knowledge, self.id, self.bindings = machine, knowledge, id, bindings or Bindings()
        self.resources = Resources(machine.capacities) if resources is None else resources
        self.task = id if task is None else task
        self.observer = observer or SILENT
        self._index = index_of(machine)
        # state
        self._engine = Engine(machine.placed, machine.placed.initial)
        self._agenda = Agenda(self._index, knowledge)
        self._fired: list[int] = []
        self._told: list[Told] = []
        self._tells = tells
        self._commands: list[Command] = []
        self._reports: deque[Accepted | Ended] = deque()
        """Ends of requests that concerned knowledge alone."""
        self._early: list[Accepted | Ended] = []
        """Reports about requests taken over that came before the beginning."""
        self._has_changed_knowledge = False
        self._questions, self._waits = Questions[int](), False
        self._calls = Calls(id, machine, knowledge, self.bindings, goal_fields, asks=asks)
        self._results = CallResults(machine.plan)
        self._state = RunState(self._engine, self._index, self._results, origin, adopted=dict(adopted))
        self._claims = RunClaims[int](self.resources, self.task, priority)
        self._guards = Guards(self._state, self._calls, self._claims, self._questions)
        # parts of these, for what every firing looks at
        self._tokens, self._counted, self._marked_at = self._engine.tokens, machine.placed.counted, self._state.marked_at
        self._places, self._undecided, self._noted = self._agenda.places, self._agenda.undecided, self._questions.noted
        # last, because it may be refused; until then nothing of the shared resources is touched
        self.resources.check_capacities(machine.capacities)
        if kept is not None:
            self.restore(kept)
            return
        self._check_adopted(adopted)
        for call, request in adopted.items():
            self._calls.adopt(call, request)
            if request.resources:
                self._claims.keep(call, self._claims.claim(request.request, request.resources))

    @property
    def _parts(self) -> Mapping[str, KeptState]:
        return {
            "agenda": self._agenda,
            "questions": self._questions,
            "calls": self._calls,
            "results": self._results,
            "state": self._state,
            "claims": self._claims,
            "guards": self._guards,
        }

    def values(self) -> dict[str, Any]:
        """Return the state between two events: with it, a run of the same machine goes on as this one does."""
        initial, marked_at = self.machine.placed.initial, self._marked_at
        tokens = {place: count for place, count in enumerate(self._tokens) if count != initial.get(place, 0)}
        # the time of a place without a token is of no use: the next token has its own
        times = {place: marked_at[place] for place, count in enumerate(self._tokens) if count and marked_at[place] > -inf}
        parts = {name: part.values() for name, part in self._parts.items()}
        return {**super().values(), "tokens": tokens, "marked_at": times, **parts}

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back."""
        super().restore(values)
        self._engine.put(values["tokens"])
        for place, time in values["marked_at"].items():
            self._marked_at[place] = time
        for name, part in self._parts.items():
            part.restore(values[name])

    @property
    def asked_since(self) -> tuple[int, int]:
        """The number of changes of the world, and of its own knowledge, since which it may ask what has changed."""
        world, local = self._agenda.asked()
        return min(world, self._calls.asked_since(call for _, call in self._settling)), local

    def _check_adopted(self, adopted: Mapping[int, UnderWay]) -> None:
        """Refuse to take over other requests than those that the plan marks as under way, or more than there are resources for."""
        plan, capacities = self.machine.plan, self.machine.capacities
        expected = {call.index for call in plan.calls if call.under_way}
        if expected != adopted.keys():
            raise RunError(f"the calls {sorted(expected)} of the plan are under way; requests are taken over for {sorted(adopted)}")
        # The resources of adopted requests are not claimed but kept: nothing else checks that there are enough of them.
        for name, count in Counter(name for taken in adopted.values() for name in taken.resources).items():
            if count > capacities.get(name, 1):
                raise RunError(f"{count} requests that are taken over have {name}")
        for call, taken in adopted.items():
            if taken.resources != self._calls.bindings.resources(plan.calls[call].action):
                raise RunError(f"{taken.call} has {', '.join(taken.resources) or 'nothing'} for itself; the plan says otherwise")

    @property
    def marking(self) -> Marking:
        """The current marking."""
        return self._engine.marking()

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return self._state.over

    @property
    def begun(self) -> bool:
        """Whether the run has begun."""
        return self._state.has_begun

    @property
    def origin(self) -> float | None:
        """The time from which releases count; the beginning of the run unless it was given another one."""
        return self._state.origin

    @property
    def ending(self) -> bool:
        """Whether nothing more is started: a failure or restart place is marked, or the run was stopped."""
        return self._state.ending

    @property
    def stopped(self) -> bool:
        """Whether the run was stopped."""
        return self._state.stop is not None

    @property
    def pausing(self) -> Pause | None:
        """The request to pause, until the run is resumed."""
        return self._state.pause

    @property
    def paused(self) -> bool:
        """Whether the run is paused: nothing starts, and nothing is under way any more."""
        return self._state.pause is not None and self._state.idle

    @property
    def hands(self) -> tuple[str, ...]:
        """The robots, and other objects and resources, that people have in their hands."""
        return self._state.hands

    @property
    def needs_from_people(self) -> tuple[str, ...]:
        """What calls need that are to begin, or to begin anew, and people have in their hands."""
        if not self.hands or self.over:
            return ()
        to_come = [call.index for call in self.machine.plan.calls if self._results.current(call.index).kind in _TO_COME]
        needed = (self._calls.named(one, TransitionAction.SEND, self._calls.context_of(one, None), self.hands) for one in to_come)
        return tuple(dict.fromkeys(filter(None, needed)))

    @property
    def listens(self) -> bool:
        """Whether a decision is pending that may be another one when facts have changed."""
        return self._agenda.listens

    def when_it_listens(self, hear: Callable[[], object]) -> None:
        """Call this when it begins to listen; and now, if it does."""
        self._agenda.begins_to_listen = hear
        if self.listens:
            hear()

    def forget_listeners(self) -> None:
        """Call nobody any more when it begins to listen."""
        self._agenda.begins_to_listen = lambda: None

    def hears_of(self, changed: Collection[Fluent]) -> bool:
        """Return whether a decision is pending that may be another one when these facts have changed; without any, variables have."""
        return self._agenda.hears_of(changed)

    @property
    def awaits(self) -> bool:
        """Whether something is to come that may move it: the end of a request, an answer, a resource, or a time."""
        is_to_come = bool(self._calls.open or self._questions.asked or self._claims.waiting or self._agenda.awaits_time)
        return is_to_come or bool(self.needs_from_people)

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._questions.wait_for_people and self._state.idle and not self._claims.waiting

    @property
    def fired(self) -> tuple[int, ...]:
        """The transitions that the last event has had fire, by number."""
        return tuple(self._fired)

    @property
    def told(self) -> tuple[Told, ...]:
        """The requests and hindrances of the last event, in order."""
        return tuple(self._told)

    @property
    def open_requests(self) -> tuple[UUID, ...]:
        """The requests that are not over, as far as is known."""
        return tuple(self._calls.open)

    @property
    def open_calls(self) -> dict[UUID, ActionCall]:
        """The calls whose requests are not over, as far as is known, as they were sent."""
        return {request: self._calls.as_sent(call) for request, call in self._calls.open.items()}

    @property
    def feedback(self) -> dict[UUID, str]:
        """The last feedback of servers about the requests that are not over; empty for none."""
        return {request: self._calls.attempts[call].feedback for request, call in self._calls.open.items()}

    def arguments(self, call: ActionCall) -> tuple[str, ...]:
        """Return the arguments that a call would be sent with now; parameters without a value by their names."""
        return self._calls.arguments(call.index)

    def when_lost(self, request: UUID) -> WhenLost:
        """Return the treatment of a request whose end nobody knows."""
        call = self._calls.open.get(request)
        return WhenLost.REPLAN if call is None else self._calls.binding(call).when_lost

    def as_settled(self, report: Report) -> Report:
        """Return the end of a request as a person has said that it ends; anything else as it is."""
        settled = self._state.settled.get(report.request)
        return settled.end(report) if settled is not None and isinstance(report, Ended) else report

    def limit(self, call: ActionCall) -> float:
        """Return the seconds of a call from its acceptance; 0 for an operation on knowledge."""
        return self._calls.limit(call.index)

    def result(self) -> RunResult:
        """Return the end of the run."""
        if not self.over:
            raise RunError(f"the run is not over: {self.marking}")
        goal = bool(self._engine.tokens[self._index.goal])
        if goal:
            reason = "the goal holds"
        elif self._state.stop:
            reason = self._state.stop.reason
        elif self._results.failures:
            reason = str(self._results.failures[0])
        else:
            cause, expected, seen = self._results.last_check or ("", "", "")
            why = "every call is done but the goal does not hold" if cause is Cause.GOAL_FALSE else cause
            reason = f"{why}: expected {expected}; observed {seen}"
        return RunResult(goal, reason, self._results.calls(), tuple(self._results.failures), self.stopped, self._results.earlier)

    @property
    def results(self) -> tuple[CallResult, ...]:
        """The results of its calls so far, every time they were reached."""
        return self._results.calls()

    def result_of(self, call: int) -> CallResult:
        """Return the result of a call so far, the last time that it was reached."""
        return self._results.current(call)

    def under_way(self) -> tuple[UnderWay, ...]:
        """Return the requests that were accepted and are not being cancelled: a successor can take them over."""
        return self._calls.under_way(self._results.current)

    @property
    def unsettled(self) -> tuple[ActionCall, ...]:
        """The calls that are under way, and those whose effects are being looked for: all of them come to their ends by themselves.

        A call that has ended and waits for others before that is not among them: what it does has been done, and a pause holds it up.
        """
        sought = (self._calls.as_sent(call) for place, call in self._settling if place in self._undecided)
        return (*self.open_calls.values(), *sought)

    @property
    def settling(self) -> tuple[ActionCall, ...]:
        """The calls that have succeeded, and whose effects are still to be looked for: no other run can take them over."""
        return tuple(self._calls.as_sent(call) for _, call in self._settling)

    @property
    def unreported(self) -> Changes:
        """The changes of running calls at their start that sensors report, but have not reported since."""
        calls = (*self._calls.open.values(), *(call for _, call in self._settling))
        return {fluent: value for call in calls for fluent, value in self._calls.unreported(call).items()}

    @property
    def looks_for_effects(self) -> bool:
        """Whether effects of calls are looked for, or what that depends on is asked: it ends by itself, unlike a wait for other calls."""
        return any(place in self._undecided for place, _ in self._settling)

    @property
    def _settling(self) -> list[tuple[int, int]]:
        """The marked places at which effects are still to be looked for, and their calls."""
        return [(place, call) for place, call in self._index.settling.items() if self._engine.tokens[place]]

    def check_successor(self, new: RunView) -> None:
        """Raise a `RunError` for a successor that loses a request under way, or has one that cannot be taken over."""
        if self.over or self.stopped:
            raise RunError("a run that is over, or was told to stop, is not succeeded by another")
        if self.id == new.id:
            raise RunError("the run that succeeds another has an id of its own")
        if self.settling:  # this run looks for effects that it computed when the call was sent; they are not handed over
            raise RunError(f"the effects of {', '.join(map(str, self.settling))} are still to be looked for")
        # A request that nobody takes over would go on unobserved, with its resources free for others.
        left = [str(call) for request, call in self.open_calls.items() if request not in new.open_requests]
        if left:
            raise RunError(f"the other run does not take over {', '.join(left)}")
        there = {running.request for running in self.under_way()}
        # The other way round, the new run would wait for an end that has already been reported, or is about to be.
        gone = [str(call) for request, call in new.open_calls.items() if request not in there]
        if gone:
            raise RunError(f"{', '.join(gone)} cannot be taken over: it is over, or being cancelled")

    def interim_result(self) -> RunResult:
        """Return the progress of the run, for one that may be succeeded by another."""
        handed = {running.call.index for running in self.under_way()}
        calls, failures = self._results.calls(handed), tuple(self._results.failures)
        return RunResult(False, "another run goes on", calls, failures, self.stopped, self._results.earlier)

    def result_so_far(self) -> RunResult:
        """Return the end of the run, or its progress."""
        return self.result() if self.over else self.interim_result()

    def __repr__(self) -> str:
        state = "over" if self.over else "ending" if self.ending else "going on"
        return f"<Run {self.machine!r}, {len(self._calls.open)} requests open, {state}>"
