"""One task among others: what is wanted, how it is doing, and what has happened to it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeAlias, assert_never
from uuid import UUID

from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.ordering.interference import Footprint
from planner_bridge.tasks.replanning import PlanAgain, Resume
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import Failure, RunResult
from pnm.core.execution.run import Run
from pnm.core.machine.machine import CallOutcome, PetriNetMachine, Rule
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Outcome, Request
from pnm.core.machine.verification.verify import Proof
from pnm.core.net.net import Marking
from pnm.tasks import Code, Moment, Status, Step, StepState, TaskEnding, TaskListener, TaskState, Wanted

TRACE: Final = 200
"""The events of a task that are kept, the last ones."""


def step_state(outcome: CallOutcome) -> StepState:
    """Return how far a call with this outcome has come."""
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


class Doing(Protocol):
    """Whoever does what a task is about."""

    @property
    def run(self) -> Run | None:
        """The run that goes on, or that went on last."""

    @property
    def footprint(self) -> Footprint | None:
        """What is still needed and changed; None when that is not known yet."""

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""

    @property
    def running(self) -> tuple[str, ...]:
        """The calls that are under way."""

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""

    def stop(self, code: Code, reason: str) -> None:
        """End it."""

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way."""

    def resume(self) -> None:
        """Go on."""


Begins: TypeAlias = Callable[[], tuple[Doing, Coroutine[None, None, TaskEnding]]]
"""Returns who does a task, and what is to be awaited until it is over."""


@dataclass(eq=False)
class Task(TaskObserver):
    """A task, which listens to whoever does it. The mutable state is what has a default.

    Args:
        wanted: what it is about.
        order: tasks are numbered as they come in.
        listener: is told what happens.
        clock: tells the time.
    """

    wanted: Wanted
    order: int
    listener: TaskListener
    clock: Callable[[], float]
    meant: str = ""
    """The goal in PDDL, when its text does not say it."""
    begins: Begins | None = None
    """Begins to do it."""
    doing: Doing | None = None
    state: TaskState = TaskState.QUEUED
    why: str = ""
    is_held: bool = False
    """Whether somebody has paused it."""
    preempted_by: set[UUID] = field(default_factory=set)
    """The tasks of higher priority that it makes way for."""
    ended_calls: int = 0
    replans: int = 0
    restarts: int = 0
    plans: int = 0
    nets: int = 0
    ending: TaskEnding | None = None
    trace: deque[Moment] = field(default_factory=lambda: deque(maxlen=TRACE))
    deadline: asyncio.TimerHandle | None = None
    over: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def rank(self) -> tuple[int, int]:
        """Its place among others: higher priorities first, then who came first."""
        return -self.wanted.priority, self.order

    @property
    def id(self) -> UUID:
        """The id of the task."""
        return self.wanted.id

    @property
    def name(self) -> str:
        """What people know it by."""
        return f"{self.wanted.text or 'the goal of the problem'} ({self.id.hex[:8]})"

    @property
    def is_active(self) -> bool:
        """Whether it is being done, and not paused."""
        return self.doing is not None and self.ending is None and not self.doing.is_paused

    @property
    def goes_on(self) -> bool:
        """Whether it is active and does not only wait for answers."""
        return self.is_active and self.doing is not None and not self.doing.awaits_answers

    @property
    def status(self) -> Status:
        """How it is doing."""
        running = self.doing.running if self.doing and self.ending is None else ()
        counts, wanted = (self.ended_calls, self.replans, self.restarts), self.wanted
        return Status(self.id, wanted.text or self.meant, wanted.priority, self.state, self.why, running, *counts, wanted.parameters)

    @property
    def steps(self) -> tuple[Step, ...]:
        """The calls of its plan, and how far they have come."""
        run = self.doing.run if self.doing else None
        if run is None:
            return ()
        graph = run.machine.plan
        before: dict[int, list[int]] = {}
        for ordering in graph.orderings:
            if ordering.before.call < len(graph.calls) and ordering.after.call < len(graph.calls):
                before.setdefault(ordering.after.call, []).append(ordering.before.call)
        told = {one.call.index: one for one in run.interim_result().calls}
        states = {index: step_state(one.kind) for index, one in told.items()}
        begun = {index: one.call.action.arguments for index, one in told.items() if one.started is not None}
        return tuple(
            Step(
                call.action.name,
                begun[call.index] if call.index in begun else run.arguments(call),
                call.planned,
                call.action.duration or 0.0,
                states.get(call.index, StepState.WAITING),
                tuple(dict.fromkeys(before.get(call.index, ()))),
            )
            for call in graph.calls
        )

    @property
    def net(self) -> tuple[int, PetriNetMachine, Marking] | None:
        """How many nets it has had before, the net it has now, and where its tokens are."""
        run = self.doing.run if self.doing else None
        return None if run is None else (self.nets - 1, run.machine, run.marking)

    # --- pausing --------------------------------------------------------------------------------

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way, which for a task that is being cancelled is its end."""
        if self.doing is not None:
            await self.doing.pause(reason, at_once=at_once)
        else:
            self.enter(TaskState.PAUSED, reason)
        if self.state is TaskState.CANCELLING:
            await self.over.wait()

    def go_on(self) -> None:
        """Be paused no longer."""
        if self.doing is not None:
            self.doing.resume()
        elif self.state is TaskState.PAUSED:
            self.enter(TaskState.QUEUED)

    # --- what happens ---------------------------------------------------------------------------

    def enter(self, state: TaskState, why: str = "") -> None:
        """Be in another state from now on, unless it is over: it may have come to its end while it was told to pause."""
        if self.ending is not None:
            return
        self.state, self.why = state, why
        self.note("state", "", f"{state.name.lower()}{f': {why}' if why else ''}")
        self.listener.changed(self.id)

    def note(self, kind: str, subject: str = "", text: str = "") -> None:
        """Write down what has happened."""
        moment = Moment(self.id, self.clock(), kind, subject, text)
        self.trace.append(moment)
        self.listener.happened(moment)

    def end(self, ending: TaskEnding) -> None:
        """Be over."""
        self.state, self.why = TaskState.OVER, ending.message
        self.note("state", "", f"over: {ending.code.word}: {ending.message}")
        self.ending = TaskEnding(ending.code, ending.message, self.replans, tuple(self.trace), ending.results, ending.cause)
        if self.deadline:
            self.deadline.cancel()
        self.listener.ended(self.id, self.ending)
        self.over.set()

    def entered(self, state: TaskState, why: str) -> None:
        """Be in the state of whoever does it."""
        if state is not TaskState.OVER:  # which it is when its result is known
            self.enter(state, why)

    def planned(self, plan: Plan) -> None:
        """Note that a plan was found."""
        self.plans += 1
        self.note("planned", "", f"{len(plan.steps)} calls: {', '.join(map(str, plan.steps[:5]))}{', …' if len(plan.steps) > 5 else ''}")

    def unplanned(self, result: PlanningResult) -> None:
        """Note that no plan was found."""
        self.note("unplanned", "", result.reason)

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Note that there is another net."""
        self.nets += 1
        self.listener.planned(self.id)

    def replanning(self, decision: Resume | PlanAgain, result: RunResult) -> None:
        """Note that the plan is replaced."""
        self.replans += 1
        self.note("replanned", "", "the rest of the plan still works" if isinstance(decision, Resume) else decision.why)
        self.listener.changed(self.id)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Note that a call is being sent."""
        self.note("sent", str(call.action))
        self.listener.changed(self.id)

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Note that a call is over."""
        self.ended_calls += 1
        self.note("ended", str(call.action), f"{outcome.kind.value}{f': {outcome.message}' if outcome.message else ''}")
        self.listener.changed(self.id)

    def failed(self, failure: Failure, now: float) -> None:
        """Note that something has failed."""
        self.note("failed", str(failure.call), str(failure))

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        """Note that a request was given up, and what it keeps."""
        kept = f", and keeps {', '.join(names)} until its server says that it is over" if names else ""
        self.note("withheld", str(call.action), f"has not confirmed that it is over{kept}")

    def waiting(self, is_so: bool, now: float) -> None:
        """Note that nothing goes on before a person has answered, or that this is over."""
        self.listener.changed(self.id)

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        """Tell that a transition has fired; too much for the trace of the task."""
        if rule.restarts:
            self.restarts += 1
            self.listener.changed(self.id)
        self.listener.happened(Moment(self.id, now, "fired", transition))
        self.listener.moved(self.id)
