"""The story that the page tells: the history of a journal, with facts, open questions, and its last records in words; and its views.

It reaches back to the beginning of the segment before the last one: a segment may begin as soon as a task has ended, and people still
want to see it then.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import isfinite
from typing import Final, TypeVar, cast
from uuid import UUID

from planner_bridge.explanations.history import Attempt, JournalHistory, RunHistory, TaskHistory, Trouble
from planner_bridge.tasks.replanning import decision_words
from planner_bridge.view import shown
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.execution.events import Answered, Ask, Restarted, Withdraw
from pnm.core.logic.computed_values import Layer
from pnm.core.logic.expressions import Fluent, Unknown, Value, fluent_text, text_of
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome, Ended, OutcomeKind
from pnm.core.pictures import timeline
from pnm.core.pictures.timeline import TimedCall, TimedPlan, Timeline
from pnm.files.database.place import Place, place_of
from pnm.journal import records
from pnm.journal import replay as replaying
from pnm.journal.replay import words
from pnm.tasks import TaskState

EVENTS: Final = 200
"""Records that are shown in words, besides those that are marked."""
_SEGMENTS: Final = 2
"""The number of records that it reaches back to."""

T = TypeVar("T", bound=shown.Shown)


class Story(JournalHistory):
    """The story of a journal so far. Everything in it is mutable state; `apply` is the only thing that changes it.

    Args:
        source: returns the source of the machine of a key.
    """

    def __init__(self, source: Callable[[str], records.MachineSource] | None = None) -> None:
        super().__init__(source, _SEGMENTS)
        self.facts: Mapping[str, shown.FactShown] = {}
        """A new mapping whenever one of them changes."""
        self.events: dict[int, shown.EventShown] = {}
        self.clock: float | None = None
        """The time of day when the clock of the records was 0, as long as one process writes them."""
        self._questions: dict[str, shown.QuestionShown] = {}
        """Those of runs."""
        self._shown: dict[str, tuple[object, shown.Shown]] = {}
        """The last view and its sources: most parts have not changed since."""

    @property
    def questions(self) -> dict[str, shown.QuestionShown]:
        """The questions that are open: those of runs, and those to a person about tasks."""
        about_tasks = {
            help.asked.question.hex: shown.QuestionShown("a person", help.asked.text, task.name, help.since, help.asked.choices)
            for task in self.tasks.values()
            for help in task.helps.values()
        }
        return self._questions | about_tasks

    def apply(self, number: int, time: float, record: records.Record) -> replaying.ReplayStep:
        """Note and execute a record, because the page shows the wishes of the runs; raises as `Replay.apply` does."""
        super().apply(number, time, record)
        replay, step = self.execute(), self.step
        assert step is not None, "this record was executed"
        self._tell(step)
        task, mark = self.task_of(record), self._mark(record)
        self.events[number] = shown.EventShown(self.time, task.hex if task else "", words(step, replay), mark)
        if (old := self.events.get(number - EVENTS)) and not old.mark:
            del self.events[number - EVENTS]
        return step

    def once(self, key: str, made_of: object, show: Callable[[], T]) -> T:
        """Return the view of a thing: the last one, if its sources are the same."""
        if (known := self._shown.get(key)) is None or known[0] != made_of:
            known = self._shown[key] = made_of, show()
        return cast("T", known[1])

    def _mark(self, record: records.Record) -> str:
        """Return the mark of a record for going through them."""
        match record:
            case records.TaskOver():  # also when it is said again, or what is shown would depend on what was read before
                return "end"
            case records.RunMade(run) if self.runs[run].replan is not None:
                return "replan"
            case records.Happened(event=Ended(outcome=outcome)) if outcome.kind is not OutcomeKind.SUCCEEDED:
                return "failure"
            case records.Happened(run) if any(trouble.record == self.number and trouble.is_failure for trouble in self.runs[run].latest):
                return "failure"
            case _:
                return ""

    def _tell(self, step: replaying.ReplayStep) -> None:
        match step.record:
            case records.SharedBegan():
                self.events = {number: event for number, event in self.events.items() if number >= self.first}
                self._questions, self._shown = {}, {}
            case records.KnowledgeBegan(base, facts) if base == records.WORLD:
                self.facts = {fluent_text(fluent): self._fact(fluent, value, is_initial=True) for fluent, value in facts.items()}
            case records.KnowledgeDelta():
                self._tell_facts(step.record)
            case records.TaskAccepted(wall=wall):
                self.clock = wall - self.time
            case records.Happened(run, event, deltas=deltas):
                for delta in deltas:
                    self._tell_facts(delta)
                self._tell_questions(run, event, step)
            case _:
                pass

    def _tell_questions(self, run: UUID, event: object, step: replaying.ReplayStep) -> None:
        match event:
            case Restarted():
                self.clock = None
            case Answered(id):
                self._questions.pop(id.hex, None)
            case _:
                pass
        name = self.runs[run].made.name
        for command in step.commands:
            match command:
                case Ask(id, question) if question.layer is Layer.PERSON:
                    text = f"{question.name}: {_said(question.meta)}" if _said(question.meta) else question.name
                    self._questions[id.hex] = shown.QuestionShown("a person", text, name, self.time)
                case Ask(id, question):
                    self._questions[id.hex] = shown.QuestionShown("a source of knowledge", str(question), name, self.time)
                case Withdraw(id):
                    self._questions.pop(id.hex, None)
                case _:
                    pass

    def _tell_facts(self, delta: records.KnowledgeDelta) -> None:
        if delta.base != records.WORLD:
            return
        facts = dict(self.facts)
        if delta.sensed:
            sensed = {fluent_text(fluent): self.world.is_sensed(fluent) for fluent in self.world.facts()}
            facts = {name: replace(fact, source=_source(is_sensed=sensed.get(name, False))) for name, fact in facts.items()}
        self.facts = facts | {fluent_text(fluent): self._fact(fluent, value) for fluent, value in delta.facts.items()}

    def _fact(self, fluent: Fluent, value: Value | Unknown, *, is_initial: bool = False) -> shown.FactShown:
        before = self.facts.get(fluent_text(fluent))
        was = "" if before is None or not isinstance(value, Unknown) else before.was or before.value
        return shown.FactShown(value_words(value), _source(is_sensed=self.world.is_sensed(fluent)), self.time, is_initial, was)


def value_words(value: Value | Unknown) -> str:
    """Return a fact in words."""
    match value:
        case bool():
            return "true" if value else "false"
        case Unknown():
            return "unknown"
        case _:
            return text_of(value)


def _source(*, is_sensed: bool) -> str:
    return "sensed" if is_sensed else "assumed"


def _said(meta: str) -> str:
    """Return the words of a question."""
    said = json.loads(meta) if meta else None
    return said if isinstance(said, str) else "" if said is None else json.dumps(said, ensure_ascii=False)


# --- the view of a story --------------------------------------------------------------------------
# The view of a story: what is shown after its last record. A pure function, which changes nothing that can be seen.


def view_of(story: Story) -> shown.View:
    """Return the view of a story; the same story gives the same view."""
    return shown.View(
        story.number,
        story.time,
        story.began,
        story.first,
        "",
        story.clock,
        {id.hex: _task(story, task) for id, task in story.tasks.items()},
        {id.hex: _run(run) for id, run in story.runs.items()},
        {f"{call.run}/{call.index}": call for run in story.runs.values() for call in _calls(story, run)},
        {id.hex: _request(story, id.hex, attempt) for id, attempt in story.attempts.items()},
        story.facts,
        _servers(story),
        story.questions,
        {key: _trouble(story, run, key, trouble) for run in story.runs.values() for key, trouble in run.troubles.items()},
        {str(number): event for number, event in story.events.items()},
    )


def _task(story: Story, task: TaskHistory) -> shown.TaskShown:
    wanted, used = task.accepted.wanted, task.used
    limit = used.limit if used and isfinite(used.limit) else None
    return shown.TaskShown(
        task.name,
        task.state.word,
        _reason(task),
        wanted.priority,
        task.accepted.wall,
        None if wanted.deadline is None else task.accepted.wall + wanted.deadline,
        round(task.seconds(story.time), 6),
        limit,
        task.ending.code.word if task.ending else "",
        tuple(run.id.hex for run in task.runs),
        task.accepted.order,
        str(task.counts) if task.runs else "",
    )


def _reason(task: TaskHistory) -> str:
    """Return why a task is as it is; if nobody has said that, what it does."""
    if task.reason or task.ending:
        return task.reason
    if task.helps:
        return "a person is asked for a decision"
    if not task.runs:
        return "it has no plan yet: a planner looks for one, or it waits for other tasks" if task.state is TaskState.PLANNING else ""
    run = task.runs[-1]
    if task.decision:  # about what follows the last run
        return decision_words(task.decision)
    if run.failures:
        failed = f"{_step(run.failures[-1])} has failed: {run.failures[-1].cause.cause}"
        return f"{failed}; running calls come to their ends" if task.state is TaskState.RUNNING else failed
    going_on = [str(call.action) for call in run.executed().run.open_calls.values()]
    return f"{', '.join(going_on)} {'run' if len(going_on) > 1 else 'runs'}" if going_on else ""


def _run(run: RunHistory) -> shown.RunShown:
    made, origin = run.made, run.origin
    return shown.RunShown(made.task.hex, made.name, run.record, run.time, origin, run.is_over, run.replan)


def _calls(story: Story, run: RunHistory) -> Iterator[shown.CallShown]:
    """Yield the calls of a run as they were reached last."""
    for index, result in run.last_results.items():
        yield story.once(f"{run.id.hex}/{index}", result, lambda result=result: _call(run, result))  # type: ignore[misc]


def _call(run: RunHistory, result: CallResult) -> shown.CallShown:
    call, action = result.call, result.call.action
    return shown.CallShown(
        run.id.hex,
        call.index,
        str(action),
        run.lane(action),
        result.kind.name.lower(),
        result.outcome if result.kind is not CallOutcome.ALREADY_TRUE else "not needed: its effects held",
        result.attempts,
        result.started,
        result.ended,
        call.planned,
        action.duration,
        result.assumed,
    )


def _request(story: Story, id: str, attempt: Attempt) -> shown.RequestShown:
    def show() -> shown.RequestShown:
        run, outcome = story.runs[attempt.sender], attempt.outcome
        return shown.RequestShown(
            attempt.run.hex,
            attempt.call,
            str(attempt.action),
            run.lane(attempt.action),
            run.server(attempt.action),
            attempt.number,
            attempt.record,
            attempt.sent,
            attempt.accepted,
            attempt.ended,
            outcome.kind.value if outcome else "",
            outcome.message if outcome else "",
            attempt.feedback,
        )

    return story.once(id, attempt, show)


def _trouble(story: Story, run: RunHistory, key: str, trouble: Trouble) -> shown.TroubleShown:
    def show() -> shown.TroubleShown:
        cause, expected, observed = trouble.cause
        is_failure, time = trouble.is_failure, trouble.time
        return shown.TroubleShown(
            run.id.hex, trouble.step.index, _step(trouble), is_failure, cause.value, expected, observed, time, trouble.followed
        )

    return story.once(key, trouble, show)


def _step(trouble: Trouble) -> str:
    return str(trouble.step.action if isinstance(trouble.step, ActionCall) else trouble.step)


def _servers(story: Story) -> dict[str, shown.ServerShown]:
    """Return the servers that calls are bound to."""
    actions: dict[str, dict[str, None]] = {}
    busy: dict[str, list[str]] = {}
    failed = Counter[str]()
    for run in story.runs.values():
        for server, names in run.servers.items():
            actions.setdefault(server, {}).update(dict.fromkeys(names))
    for attempt in story.attempts.values():
        server = story.runs[attempt.sender].server(attempt.action)
        actions.setdefault(server, {})[attempt.action.name] = None
        if attempt.outcome is None and story.runs[attempt.run].results is None:
            busy.setdefault(server, []).append(str(attempt.action))
        failed[server] += attempt.outcome is not None and attempt.outcome.kind is not OutcomeKind.SUCCEEDED
    found = sorted(name for name in actions if name)
    return {name: shown.ServerShown(tuple(actions[name]), tuple(busy.get(name, ())), failed[name]) for name in found}


# --- timelines ------------------------------------------------------------------------------------
# Timelines of tasks, as the history of a journal tells them.


def timelines(journal: Place | str) -> tuple[Timeline, ...]:
    """Return the timelines of the tasks in a journal, in the order in which they were accepted.

    Raises:
        JournalError: it is no journal, or one of another version.
        ReplayDiffers: its runs do something else in this version.
        Undecodable: this version does not know what its records are made of.
    """
    history = JournalHistory.read(place_of(journal) if isinstance(journal, str) else journal)
    return tuple(_timeline(history, task) for task in history.tasks.values())


def timelines_svg(journal: Place, *, only_last: bool = False) -> str:
    """Return the picture of the timelines of the tasks in a journal, or of that of the last one alone."""
    told = timelines(journal)
    return timeline.timeline_svg(*told[-1:] if only_last else told)


def _timeline(history: JournalHistory, task: TaskHistory) -> Timeline:
    began = min((task.time, *(run.time for run in task.runs)))
    words = f"{task.ending.code.word}: {task.ending.message}" if task.ending else ""
    end = history.time if task.ended is None else task.ended
    return Timeline(task.name, tuple(_timed_plan(history, run, began) for run in task.runs), end - began, words)


def _timed_plan(history: JournalHistory, run: RunHistory, began: float) -> TimedPlan:
    """Return the plan of a run in a task that has begun then."""
    results, origin = run.last_results, (run.time if run.origin is None else run.origin) - began
    calls = tuple(_timed_call(history, run, call, results[call.index], origin, began) for call in run.source.plan.calls)
    failures = tuple(str(Failure(trouble.step, *trouble.cause)) for trouble in run.failures)
    return TimedPlan(run.time - began, calls, run.replan, failures)


def _timed_call(history: JournalHistory, run: RunHistory, call: ActionCall, became: CallResult, origin: float, began: float) -> TimedCall:
    attempts = tuple(_timed_attempt(attempt, began) for attempt in history.sent(run, call.index))
    name, lane, planned = str(became.call.action), run.lane(call.action), origin + call.planned
    has_failed, lasts = became.kind is CallOutcome.FAILED, call.action.duration
    return TimedCall(call.index, name, lane, planned, lasts, attempts, became.outcome, became.is_done, has_failed)


def _timed_attempt(attempt: Attempt, began: float) -> timeline.TimedAttempt:
    if attempt.ended is None or attempt.outcome is None:
        return timeline.TimedAttempt(attempt.sent - began)
    return timeline.TimedAttempt(attempt.sent - began, attempt.ended - began, attempt.outcome.kind, attempt.outcome.message)
