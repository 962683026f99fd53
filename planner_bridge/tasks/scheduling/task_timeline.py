"""Timelines of tasks, as a journal tells them: its runs are executed again, and what they send and hear is noted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias
from uuid import UUID

from planner_bridge.tasks.replanning import Decision, decision_words
from planner_bridge.tasks.result import TASKS, GoalNote
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Observer
from pnm.core.machine.machine import CallOutcome
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Ended, Outcome, Request
from pnm.core.pictures.timeline import Attempt, TimedCall, TimedPlan, Timeline, replan
from pnm.files.database.place import Place, place_of
from pnm.journal.records import Happened, MachineSource, RunMade, TaskAccepted, TaskNoted, TaskOver
from pnm.journal.replay import Replay, ReplayedRun, ReplayedTask
from pnm.journal.resume import replay_steps

Ends: TypeAlias = Mapping[UUID, tuple[float, Outcome]]
"""When and how requests ended: one may do so under another run than that which has sent it."""


def timelines(journal: Place | str) -> tuple[Timeline, ...]:
    """Return the timelines of the tasks in a journal, in the order in which they were accepted.

    Raises:
        JournalError: it is no journal, or one of another version.
        ReplayDiffers: its runs do something else in this version.
        Undecodable: this version does not know what its records are made of.
    """
    replay = Replay()
    tasks: dict[UUID, _TaskTimes] = {}
    runs: dict[UUID, _RunTimes] = {}
    ends: dict[UUID, tuple[float, Outcome]] = {}
    for step in replay_steps(place_of(journal) if isinstance(journal, str) else journal, TASKS, replay):
        match step.record:
            case RunMade(run):
                runs[run] = _RunTimes(replay.runs[run], replay.source_of(step.record), step.time)
            case Happened(event=Ended(request, outcome)):
                ends.setdefault(request, (step.time, outcome))
            case TaskAccepted(wanted) if not (wanted.id in tasks and tasks[wanted.id].replayed.accepted == step.record):  # said again
                tasks[wanted.id] = _TaskTimes(replay.tasks[wanted.id], step.time)
            case TaskNoted(id, GoalNote(decision=decision)) if decision is not None:
                tasks[id].decisions.append(decision)
            case TaskOver(id) if tasks[id].ended is None:
                tasks[id].ended = step.time
            case _:
                pass
    return tuple(task.timeline(runs, ends, replay.now) for task in tasks.values())


@dataclass
class _RunTimes(Observer):
    """When the requests of a run were sent, which is mutable state."""

    replayed: ReplayedRun
    source: MachineSource
    made: float
    sent_by: dict[int, list[tuple[UUID, float]]] = field(default_factory=dict)
    """By call."""

    def __post_init__(self) -> None:
        self.replayed.run.observer = self

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self.sent_by.setdefault(call.index, []).append((request.id, now))

    def plan(self, began: float, ends: Ends) -> TimedPlan:
        """Return the plan of the run in a task that has begun then."""
        run = self.replayed.run
        result = self.replayed.result or (run.result() if run.over else run.interim_result())
        became = {one.call.index: one for one in result.calls}
        origin = self.made if run.origin is None else run.origin
        calls = tuple(self._call(call, became.get(call.index, CallResult(call)), began, origin, ends) for call in self.source.plan.calls)
        return TimedPlan(self.made - began, calls, failures=tuple(map(str, result.failures)))

    def _call(self, call: ActionCall, became: CallResult, began: float, origin: float, ends: Ends) -> TimedCall:
        attempts: list[Attempt] = []
        for request, sent in self.sent_by.get(call.index, ()):
            ended, outcome = ends.get(request, (None, None))
            if ended is None or outcome is None:
                attempts.append(Attempt(sent - began))
            else:
                attempts.append(Attempt(sent - began, ended - began, outcome.kind, outcome.message))
        planned, name = origin + call.planned - began, str(became.call.action)
        lane = self._lane(call.action)
        has_failed, lasts = became.kind is CallOutcome.FAILED, call.action.duration
        return TimedCall(call.index, name, lane, planned, lasts, tuple(attempts), became.outcome, became.is_done, has_failed)

    def _lane(self, action: GroundAction) -> str:
        """Return whose an action is: of whom it has something for itself, else its first argument, who acts."""
        resources = self.source.bindings.resources(action)
        first = resources[0].strip("/").partition("/")[0] if resources else action.arguments[0] if action.arguments else action.name
        return action.name if first.startswith("?") else first


@dataclass
class _TaskTimes:
    """What is noted of a task, which is mutable state."""

    replayed: ReplayedTask
    accepted: float
    decisions: list[Decision] = field(default_factory=list)
    """What followed its runs, in their order."""
    ended: float | None = None

    def timeline(self, runs: Mapping[UUID, _RunTimes], ends: Ends, now: float) -> Timeline:
        """Return the timeline of the task."""
        mine = [runs[replayed.made.run] for replayed in self.replayed.runs if replayed.run.begun]
        began = min((self.accepted, *(run.made for run in mine)))
        plans: list[TimedPlan] = []
        before: TimedPlan | None = None
        decisions = iter(self.decisions)
        for run in mine:
            plan = run.plan(began, ends)
            if run.replayed.made.caller is None:
                if before is not None:
                    plan = replace(plan, replan=replan(decision_words(next(decisions, None)), before.calls, plan.calls))
                before = plan
            plans.append(plan)
        ending = self.replayed.ending
        words = f"{ending.code.word}: {ending.message}" if ending else ""
        end = now if self.ended is None else self.ended
        return Timeline(self.replayed.accepted.wanted.text or "the goal of the problem", tuple(plans), end - began, words)
