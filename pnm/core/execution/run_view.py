"""Read-only view of a run: nothing here changes it."""

from __future__ import annotations

from uuid import UUID

from pnm.core.execution.call_requests import Calls
from pnm.core.execution.call_results import CallResult, CallResults, RunResult
from pnm.core.execution.events import Pause
from pnm.core.execution.guards import Guards
from pnm.core.execution.handover import Handover, UnderWay
from pnm.core.execution.machine_index import MachineIndex
from pnm.core.execution.questions import Questions
from pnm.core.execution.run_state import Agenda, RunState
from pnm.core.machine.bindings import WhenLost
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.net.firing_engine import Engine
from pnm.core.net.net import Marking
from pnm.core.resources import RunClaims
from pnm.errors import RunError


class RunView:
    """A run as its caller sees it: its marking, what is under way, and how it ended."""

    id: UUID
    machine: PetriNetMachine
    _engine: Engine
    _index: MachineIndex
    _agenda: Agenda
    _fired: list[int]
    _state: RunState
    _calls: Calls
    _results: CallResults
    _claims: RunClaims
    _questions: Questions
    _guards: Guards

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
    def awaits_knowledge(self) -> bool:
        """Whether a decision is pending that may be another one when facts change."""
        return self._agenda.hears_of_facts

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._questions.wait_for_people and self._state.idle and not self._claims.waiting

    @property
    def fired(self) -> tuple[int, ...]:
        """The transitions that the last event has had fire, by number."""
        return tuple(self._fired)

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
        """What servers have said last about the requests that are not over; empty where they have said nothing."""
        return {request: self._calls.feedback(call) for request, call in self._calls.open.items()}

    def arguments(self, call: ActionCall) -> tuple[str, ...]:
        """Return the arguments that a call would be sent with now; parameters without a value by their names."""
        return self._calls.arguments(call.index)

    def when_lost(self, request: UUID) -> WhenLost:
        """Return what to do if nobody knows how a request has ended."""
        call = self._calls.open.get(request)
        return WhenLost.REPLAN if call is None else self._calls.binding(call).when_lost

    def limit(self, call: ActionCall) -> float:
        """Return how many seconds a call may take from its acceptance; 0 for an operation on knowledge."""
        return self._calls.limit(call.index)

    def result(self) -> RunResult:
        """Return how the run ended."""
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
            _, expected, seen = self._results.last_check or ("", "", "")
            reason = f"every call is done but the goal does not hold: expected {expected}; observed {seen}"
        return RunResult(goal, reason, self._results.calls(), tuple(self._results.failures), self.stopped)

    @property
    def results(self) -> tuple[CallResult, ...]:
        """What has become of its calls so far, every time they were reached."""
        return self._results.calls()

    def under_way(self) -> tuple[UnderWay, ...]:
        """Return the requests that were accepted and are not being cancelled: a successor can take them over."""
        return self._calls.under_way(self._results.current)

    @property
    def unsettled(self) -> tuple[ActionCall, ...]:
        """The calls that are under way, and those whose effects are still being looked for."""
        return (*self.open_calls.values(), *self.settling)

    @property
    def settling(self) -> tuple[ActionCall, ...]:
        """The calls that have succeeded, and whose effects are still to be looked for: no other run can take them over."""
        return tuple(self._calls.as_sent(call) for place, call in self._index.settling.items() if self._engine.tokens[place])

    @property
    def handover(self) -> Handover:
        """Its state as far as it matters when one run succeeds another."""
        return Handover(self.id, self.over or self.stopped, self.settling, self.open_calls, self.under_way())

    def interim_result(self) -> RunResult:
        """Return how far the run has come, for one that may be succeeded by another."""
        handed = {running.call.index for running in self.under_way()}
        calls, failures = self._results.calls(handed), tuple(self._results.failures)
        return RunResult(False, "another run goes on", calls, failures, self.stopped)

    def __repr__(self) -> str:
        state = "over" if self.over else "ending" if self.ending else "going on"
        return f"<Run {self.machine!r}, {len(self._calls.open)} requests open, {state}>"
