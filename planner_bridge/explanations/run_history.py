"""The history of a run as its journal tells it: the state it began in, what was sent when, what went wrong, who had its resources.

The replay of a journal executes runs again; here is noted on the way what the state after it does not say any more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from uuid import UUID

from planner_bridge.explanations.needed_call import Course
from planner_bridge.model.plan_simulation import snapshot
from planner_bridge.tasks.replanning import Decision
from planner_bridge.tasks.result import TASKS, GoalNote
from pnm.core.execution.call_results import CallResult, Explanation, Failure
from pnm.core.execution.events import Observer
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.plan_graph import ActionCall, Moment, PlanEvent
from pnm.core.machine.requests import Request
from pnm.files.database.place import Place
from pnm.journal.records import MachineSource, RunMade, SharedBegan, TaskAccepted, TaskNoted, TaskOver
from pnm.journal.replay import Replay, ReplayedRun, Step
from pnm.journal.resume import replay_steps
from pnm.tasks import TaskEnding


@dataclass(frozen=True, slots=True)
class Trouble:
    """What a call was hindered by, or what it has failed with, and when."""

    call: int
    cause: Explanation
    time: float
    attempt: int
    failure: Failure | None = None
    """None if it was not given up: it is tried again, or recovers."""


@dataclass(frozen=True, slots=True)
class HeldResources:
    """Resources that a request had for itself, from when until when; None while it has them."""

    action: str
    names: tuple[str, ...]
    since: float
    until: float | None = None


@dataclass
class RunHistory:
    """What is known of a run. The mutable state is what has a default.

    Args:
        replayed: the run.
        source: what its machine was made from.
        state: the facts when it was made.
        time: when that was.
    """

    replayed: ReplayedRun
    source: MachineSource
    state: KnowledgeBase
    time: float
    sent: dict[int, list[float]] = field(default_factory=dict)
    """When the requests of each call were sent."""
    troubles: list[Trouble] = field(default_factory=list)
    decision: Decision | None = None
    """Why another run follows."""

    @property
    def results(self) -> Mapping[int, CallResult]:
        """What has become of its calls, by number; of those reached several times, the last time."""
        results = self.replayed.result.calls if self.replayed.result else self.replayed.run.results
        return {result.call.index: result for result in (*map(CallResult, self.source.plan.calls), *results)}

    @property
    def is_over(self) -> bool:
        """Whether nothing more comes of it."""
        return self.replayed.is_over or self.replayed.run.over

    @property
    def is_planned(self) -> bool:
        """Whether its plan has calls alone, as planners make them."""
        return all(isinstance(step, ActionCall) for step in self.source.plan.steps)

    def time_of(self, event: PlanEvent) -> float | None:
        """Return when a call began or ended; None before."""
        result = self.results.get(event.call)
        return None if result is None else result.started if event.moment is Moment.START else result.ended

    def course(self) -> Course:
        """Return the course of its plan from the state it began in."""
        plan = self.source.plan
        begun = frozenset(call.index for call in plan.calls if call.under_way)
        events = tuple(event for event in plan.order if event.call not in begun or event.moment is Moment.END)
        return Course(plan.calls, events, self.state, plan.goal, begun)


@dataclass
class TaskHistory:
    """What is known of a task. The mutable state is what has a default."""

    accepted: TaskAccepted
    runs: list[RunHistory] = field(default_factory=list)
    ending: TaskEnding | None = None

    @property
    def name(self) -> str:
        """What the task is about."""
        return self.accepted.wanted.text or "the goal of the problem"


class JournalHistory:
    """The histories of the tasks of a journal. Everything in it is mutable state; `read` is how it comes about."""

    def __init__(self) -> None:
        self.replay = Replay()
        self.tasks: dict[UUID, TaskHistory] = {}
        self.runs: dict[UUID, RunHistory] = {}
        self.held: dict[UUID, HeldResources] = {}
        """What requests had for themselves."""
        self.time = 0.0

    @staticmethod
    def read(place: Place, last: int | None = None) -> JournalHistory:
        """Read a journal, up to and with a record if one is given; raises as `replay_steps` does."""
        history = JournalHistory()
        for step in replay_steps(place, TASKS, history.replay):
            history.note(step)
            if step.number == last:
                break
        return history

    def note(self, step: Step) -> None:
        """Note what a record tells that was replayed."""
        self.time = max(self.time, step.time)
        match step.record:
            case SharedBegan():
                self.replay.forget()
                self.runs, self.held = {}, {}
            case RunMade(run, task):
                replayed = self.replay.runs[run]
                made = RunHistory(replayed, self.replay.source_of(step.record), snapshot(self.replay.world), step.time)
                self.runs[run], replayed.run.observer = made, _Noting(self, made)
                if task in self.tasks:
                    self.tasks[task].runs = [*(one for one in self.tasks[task].runs if one.replayed.run.begun), made]
            case TaskAccepted(wanted) if not (wanted.id in self.tasks and self.tasks[wanted.id].accepted == step.record):  # said again
                runs = [run for run in self.runs.values() if run.replayed.made.task == wanted.id]
                self.tasks[wanted.id] = TaskHistory(step.record, runs)
            case TaskNoted(task, GoalNote(decision=decision)) if decision is not None and task in self.tasks:
                self._note_decision(self.tasks[task], decision)
            case TaskOver(task, ending) if task in self.tasks:
                self.tasks[task].ending = ending
            case _:
                pass
        self._note_resources()

    def _note_decision(self, task: TaskHistory, decision: Decision) -> None:
        """Note why another run follows: one that succeeds a run that goes on is made before that is kept."""
        succeeds = len(task.runs) > 1 and not task.runs[-1].is_over and task.runs[-2].decision is None
        if task.runs:
            task.runs[-2 if succeeds else -1].decision = decision

    def _note_resources(self) -> None:
        now = {claim.request: claim for claim in self.replay.resources.held}
        for request, held in self.held.items():
            if request not in now and held.until is None:
                self.held[request] = HeldResources(held.action, held.names, held.since, self.time)
        for request, claim in now.items():
            if request not in self.held and request in self.replay.requests:
                self.held[request] = HeldResources(str(self.replay.requests[request].action), claim.names, self.time)


class _Noting(Observer):
    """What a run that is replayed tells its history."""

    def __init__(self, history: JournalHistory, run: RunHistory) -> None:
        self._history = history
        self._run = run

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self._run.sent.setdefault(call.index, []).append(now)

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        self._run.troubles.append(Trouble(call.index, cause, now, len(self._run.sent.get(call.index, ()))))

    def failed(self, failure: Failure, now: float) -> None:
        cause = Explanation(failure.cause, failure.expected, failure.observed)
        number = failure.call.index
        self._run.troubles.append(Trouble(number, cause, now, len(self._run.sent.get(number, ())), failure))
