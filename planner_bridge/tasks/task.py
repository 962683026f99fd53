"""A task among others: what is wanted, its control, and the record of what has happened to it."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Final, TypeAlias, assert_never
from uuid import UUID

from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.tasks.control import STILL, TaskControl, Watchdog
from planner_bridge.tasks.replanning import Foreseen, PlanAgain, ResumePlan, decision_words
from planner_bridge.tasks.result import GoalNote, Stopwatch, TaskResult, notes_of
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import CallResult, Failure, RunResult
from pnm.core.execution.events import Fired, broadcast
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome, Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import Proof
from pnm.core.net.net import Marking
from pnm.errors import counted
from pnm.journal.journal import Journal
from pnm.journal.replay import ReplayedTask
from pnm.knowledge.sources import OpenQuestion
from pnm.tasks import (
    EVENTS,
    Code,
    StepState,
    TaskEnding,
    TaskListener,
    TaskOdds,
    TaskState,
    TaskStatus,
    TaskStep,
    TraceEvent,
    TraceKind,
    Wanted,
)

TRACE: Final = 200
"""The events of a task that are kept, the last ones."""


def step_state(outcome: CallOutcome) -> StepState:
    """Return the progress of a call with this outcome."""
    match outcome:
        case CallOutcome.WAITING | CallOutcome.SUSPENDED:
            return StepState.WAITING
        case CallOutcome.RUNNING | CallOutcome.HANDED_OVER:
            return StepState.RUNNING
        case CallOutcome.SUCCEEDED | CallOutcome.ALREADY_TRUE:
            return StepState.DONE
        case CallOutcome.SKIPPED | CallOutcome.CANCELED:
            return StepState.SKIPPED
        case CallOutcome.UNCONFIRMED | CallOutcome.PASSED_OVER | CallOutcome.FAILED:
            return StepState.FAILED
        case _:
            assert_never(outcome)


StartTask: TypeAlias = Callable[[], Coroutine[None, None, TaskResult]]
"""Carries out a task and returns its result."""


@dataclass(eq=False)
class Task(TaskObserver):
    """A task among others; it notes what happens to it: in its trace, in a line for each event in `pnm.tasks.EVENTS`, and for listeners.

    Its states are in the journal besides, whose readers tell the same. The mutable state is what has a default.

    Args:
        order: tasks are numbered as they come in.
        listener: listens to all tasks.
        observers: listen to this task besides.
    """

    wanted: Wanted
    order: int
    listener: TaskListener
    clock: Callable[[], float]
    journal: Journal
    observers: tuple[TaskObserver, ...] = ()
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    goal: str = ""
    """The goal in PDDL; empty for a task that is a plan."""
    start: StartTask | None = None
    id: UUID = field(init=False)
    rank: tuple[int, int] = field(init=False)
    """Its place among others: higher priorities first, then the one that came first."""
    observer: TaskObserver = field(init=False)
    """The task, and all who listen to it besides."""
    control: TaskControl = field(init=False)
    is_held: bool = False
    """Whether an operator has paused it."""
    preempted_by: set[Task] = field(default_factory=set, repr=False)
    """The tasks of higher priority for which it is preempted."""
    preempts: set[Task] = field(default_factory=set, repr=False)
    """The tasks that are preempted for it."""
    ended_calls: int = 0
    restarts: int = 0
    plans: int = 0
    nets: int = 0
    foreseen: int = 0
    """The number of nets that are no replans: with a better rest of a plan, or after a declared outcome."""
    ending: TaskEnding | None = None
    result: TaskResult | None = None
    error: Exception | None = None
    """The mistake, if there is no result."""
    trace: deque[TraceEvent] = field(default_factory=lambda: deque(maxlen=TRACE))
    deadline: asyncio.TimerHandle | None = None
    watchdog: Watchdog | None = None
    came_in: float = field(init=False)
    """The time of its arrival."""
    replanned: str = ""
    """The time and the reason of the last new plan."""
    odds: tuple[TaskOdds, float] | None = None
    """Those of what is left of its plan, and the time at which they were so."""
    questions: tuple[OpenQuestion, ...] = ()
    """What people are asked for it now."""
    is_abandoned: bool = False
    """Whether it was left alone because it could not be ended in order."""

    def __post_init__(self) -> None:
        self.id = self.wanted.id  # not looked up each time: everything that happens to the task names it
        self.rank = -self.wanted.priority, self.order  # as all that wait are compared whenever one may plan
        self.observer = broadcast(TaskObserver, (self, *self.observers)) if self.observers else self
        self.control = TaskControl(self.observer)
        self.came_in = self.clock()

    @property
    def replans(self) -> int:
        """The number of nets after the first; those that were foreseen do not count."""
        return max(0, self.nets - 1 - self.foreseen)

    @property
    def name(self) -> str:
        """The name of the task for people."""
        return f"{self.wanted.words} ({self.id.hex[:8]})"

    @property
    def is_active(self) -> bool:
        """Whether the task has begun, and is neither paused nor over."""
        return self.control.has_begun and self.ending is None and not self.control.is_paused

    def yields_to(self, other: Task) -> bool:
        """Return whether it can be preempted for another one, and ranks lower."""
        return self.wanted.priority < other.wanted.priority and self.is_active

    @property
    def wants_to_go_on(self) -> bool:
        """Whether the task has something to do: it has begun, no operator has paused it, and it does not only wait for answers."""
        has_work = self.control.has_begun and self.ending is None and not self.is_held and not self.control.awaits_help
        return has_work and not self.control.awaits_answers

    @property
    def why_still(self) -> str:
        """Why it is ended when it stands still: that, and how it stands."""
        control, run = self.control, self.control.run
        state = f"{control.state.word}{f', {control.reason}' if control.reason else ''}"
        unfinished = [result for result in run.results if result.kind in (CallOutcome.RUNNING, CallOutcome.SUSPENDED)] if run else []
        calls = "".join(f"; {result.call.action}: {result.kind}" for result in unfinished)
        still = f"for {STILL:g} s nothing has happened to it, although it waits for nothing and nobody has paused it"
        return f"it stands still: {still} ({state}{calls}); that is a mistake of pnm, and its journal says how it came about"

    @property
    def status(self) -> TaskStatus:
        """The status of the task now."""
        control, wanted = self.control, self.wanted
        under_way = control.execution.executor.running if control.execution else ()
        return TaskStatus(
            self.id,
            wanted.text or self.goal,
            wanted.priority,
            control.state,
            control.reason or self._asks or (self.replanned if control.state is TaskState.RUNNING else ""),
            tuple(call for call, _ in under_way),
            self.ended_calls,
            self.replans,
            self.restarts,
            wanted.parameters,
            tuple(feedback for _, feedback in under_way),
            self.ending.code if self.ending else None,
            self.odds[0].after(self.clock() - self.odds[1]) if self.odds and self.ending is None else None,
        )

    @property
    def steps(self) -> tuple[TaskStep, ...]:
        """The calls of its plan, and how far they have come."""
        run = self.control.run
        if run is None:
            return ()
        graph = run.machine.plan
        results = {result.call.index: result for result in run.interim_result().calls}
        arguments = {index: result.call.action.arguments for index, result in results.items() if result.started is not None}

        def step(call: ActionCall) -> TaskStep:
            result = results.get(call.index, CallResult(call))
            return TaskStep(
                call.action.name,
                arguments[call.index] if call.index in arguments else run.arguments(call),
                call.planned,
                call.action.duration or 0.0,
                step_state(result.kind),
                graph.waits_for[call.index],
                result.started,
                result.ended,
                result.attempts,
                run.limit(call),
                result.cause,
            )

        return tuple(map(step, graph.calls))

    @property
    def net(self) -> tuple[int, PetriNetMachine, Marking] | None:
        """The number of nets it has had before, the net it has now, and its marking."""
        run = self.control.run
        return None if run is None else (self.nets - 1, run.machine, run.marking)

    # --- what happens ---------------------------------------------------------------------------

    def entered(self, state: TaskState, why: str) -> None:
        """Note that the task is in another state."""
        if state is not TaskState.OVER:  # which is noted with the result
            self.journal.entered(self.id, state, why)  # before others hear of it, who may have it enter the next one
            self.note(TraceKind.STATE, "", f"{state.name.lower()}{f': {why}' if why else ''}")
            self.listener.changed(self.id)

    def note(self, kind: TraceKind, subject: str = "", text: str = "", level: int = logging.INFO) -> None:
        """Note an event of the task."""
        event = TraceEvent(self.id, self.clock(), kind, subject, text, level)
        if self.watchdog:
            self.watchdog.heard()
        self.trace.append(event)
        if EVENTS.isEnabledFor(level):
            EVENTS.log(level, "%s %s", self.id.hex[:8], ": ".join(filter(None, (kind.word, subject, text))))
        self.listener.happened(event)

    def asking(self, questions: tuple[OpenQuestion, ...]) -> None:
        """Note what people are asked for it from now on; a task that asks for help is in a state with these words already."""
        if questions != self.questions:
            self.questions = questions
            if self.ending is None and not self.control.reason:
                self.note(TraceKind.STATE, "", ": ".join(filter(None, (self.control.state.word, self._asks))))
            self.listener.changed(self.id)

    @property
    def _asks(self) -> str:
        return f"asks: {'; '.join(map(str, self.questions))}" if self.questions else ""

    def restore(self, kept: ReplayedTask) -> None:
        """Note the progress of the task in another process: its plans, the calls that have ended, and its ending if it is over."""
        begun = sum(replayed.run.begun and replayed.made.caller is None for replayed in kept.runs)
        self.nets = begun - self.wanted.is_plan if kept.ending is None else kept.ending.replans + 1  # a plan is said again to be there
        notes = notes_of(kept, GoalNote)
        decided = [note.decision for note in notes if note.decision]
        self.foreseen = sum(isinstance(decision, Foreseen) for decision in decided) if kept.ending is None else 0
        self.replanned = f"replanned in another process: {decision_words(decided[-1])}" if decided else ""
        self.plans = max((note.plans for note in notes), default=0)
        results = [replayed.result or replayed.run.interim_result() for replayed in kept.runs]
        self.ended_calls = sum(call.attempts - call.is_under_way for result in results for call in result.calls)
        self.ended_calls += sum(result.earlier.attempts for result in results)
        if kept.ending is not None:
            self.ending = kept.ending
            self.control.conclude(kept.ending.message)

    def end(self, ending: TaskEnding) -> None:
        """End the task."""
        self.control.enter(TaskState.OVER, ending.message)
        level = {Code.GOAL_REACHED: logging.INFO, Code.CANCELLED: logging.WARNING}.get(ending.code, logging.ERROR)
        self.note(TraceKind.STATE, "", f"over: {ending.code.word}: {ending.message}", level)
        self.ending = TaskEnding(ending.code, ending.message, self.replans, tuple(self.trace), ending.results, ending.cause)
        if self.deadline:
            self.deadline.cancel()
        if self.watchdog:
            self.watchdog.close()
        self.listener.ended(self.id, self.ending)
        self.control.end()
        self.observer, self.start = TaskObserver(), None  # these refer to the task

    def planned(self, plan: Plan) -> None:
        """Note that a plan was found."""
        self.plans += 1
        first = f"{', '.join(map(str, plan.steps[:5]))}{', …' if len(plan.steps) > 5 else ''}"
        self.note(TraceKind.PLANNED, "", f"{counted(len(plan.steps), 'call')}: {first}")

    def unplanned(self, result: PlanningResult) -> None:
        """Note that no plan was found."""
        self.note(TraceKind.UNPLANNED, "", result.reason, logging.WARNING)

    def blocked(self, reason: str) -> None:
        """Note that the task waits for facts to change."""
        self.note(TraceKind.BLOCKED, "", reason, logging.WARNING)

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Note that there is another net."""
        self.nets += 1
        self.listener.planned(self.id)
        self.listener.changed(self.id)

    def resigned(self, reason: str) -> None:
        """Note that a hand-written plan has failed, and that a planner looks for another way."""
        self.note(TraceKind.REPLANNED, "", f"a planner looks for another way: {reason}", logging.WARNING)
        self.listener.changed(self.id)

    def replanning(self, decision: ResumePlan | PlanAgain | Foreseen, result: RunResult) -> None:
        """Note that the plan is to be replaced."""
        words, is_foreseen = decision_words(decision), isinstance(decision, Foreseen)
        self.foreseen += is_foreseen
        self.replanned = f"replanned {self.clock() - self.came_in:.2f} s after it came in: {words}"
        self.note(TraceKind.REPLANNED, "", words, logging.INFO if is_foreseen else logging.WARNING)
        self.listener.changed(self.id)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Note that a call is being sent."""
        self.note(TraceKind.SENT, str(call.action), f"attempt {request.attempt}" if request.attempt > 1 else "")
        self.listener.changed(self.id)

    def progressed(self, call: ActionCall, feedback: str, now: float) -> None:
        """Tell the feedback of a call's server; too much for the trace of the task."""
        self.listener.happened(TraceEvent(self.id, now, TraceKind.FEEDBACK, str(call.action), feedback))

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Note that a call is over."""
        self.ended_calls += 1
        level = logging.INFO if outcome.kind is OutcomeKind.SUCCEEDED else logging.WARNING
        self.note(TraceKind.ENDED, str(call.action), f"{outcome.kind.value}{f': {outcome.message}' if outcome.message else ''}", level)
        self.listener.changed(self.id)

    def late(self, call: ActionCall, limit: float, now: float) -> None:
        """Note that a call has passed its limit."""
        self.note(TraceKind.SENT, "", f"a request to cancel {call.action}: it has not ended within {limit:g} s", logging.WARNING)

    def failed(self, failure: Failure, now: float) -> None:
        """Note that something has failed."""
        self.note(TraceKind.FAILED, str(failure.call), failure.why, logging.ERROR)

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        """Note that a request was given up, and what it keeps."""
        kept = f", and keeps {', '.join(names)} until its server reports the end" if names else ""
        self.note(TraceKind.WITHHELD, str(call.action), f"has not confirmed that it is over{kept}", logging.WARNING)

    def waiting(self, is_so: bool, now: float) -> None:
        """Note that nothing goes on before a person has answered, or that this is over."""
        self.listener.changed(self.id)

    def fired(self, fired: Fired, now: float) -> None:
        """Tell that a transition has fired; too much for the trace of the task."""
        if fired.kind.restarts:
            self.restarts += 1
            self.listener.changed(self.id)
        self.listener.moved(self.id, lambda: TraceEvent(self.id, now, TraceKind.FIRED, fired.name))
