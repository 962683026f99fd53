"""The story that a journal tells: its replay, and what a state alone does not say, such as when things happened and in which words.

It reaches back to the beginning of the segment before the last one: a segment may begin as soon as a task has ended, and people still
want to see it then. So what is shown after a record depends on these two segments alone, whoever has read how much before.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final
from uuid import UUID

from planner_bridge.tasks.replanning import Decision, decision_words
from planner_bridge.tasks.result import GoalNote
from planner_bridge.view.shown import CallShown, Cut, EventShown, FactShown, QuestionShown, RequestShown, TroubleShown
from pnm.clock import TimeUsed
from pnm.core.execution.call_results import CallResult, Explanation, Failure
from pnm.core.execution.events import Answered, Ask, Observer, Restarted, Withdraw
from pnm.core.logic.computed_values import Layer
from pnm.core.logic.expressions import Fluent, Unknown, Value, fluent_text, text_of
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Step
from pnm.core.machine.requests import Accepted, Ended, Feedback, OutcomeKind, Request
from pnm.journal import replay as replaying
from pnm.journal.records import (
    WORLD,
    Happened,
    KnowledgeBegan,
    KnowledgeDelta,
    MachineSource,
    Record,
    RunMade,
    RunSucceeded,
    SharedBegan,
    TaskAccepted,
    TaskHeld,
    TaskNoted,
    TaskOver,
    TimeCounted,
)
from pnm.journal.text import words
from pnm.knowledge.sources.help import HelpAsked, HelpEnded
from pnm.tasks import TaskEnding

EVENTS: Final = 200
"""Records that are shown in words, besides those that are marked."""


@dataclass
class RunStory:
    """The story of one run. Mutable state is what has a default.

    Args:
        record: with which it was made.
        time: when that was.
        replayed: the run.
        source: what its machine was made from.
        cut: how it differs from the run before.
    """

    record: int
    time: float
    replayed: replaying.ReplayedRun
    source: MachineSource
    cut: Cut | None
    requests: dict[str, RequestShown] = field(default_factory=dict)
    troubles: dict[str, TroubleShown] = field(default_factory=dict)
    shown: dict[int, tuple[CallResult, CallShown]] = field(default_factory=dict)
    """What was shown of calls last, and of what it was made: of most calls nothing has changed since."""

    @cached_property
    def unreached(self) -> Mapping[int, CallResult]:
        """The results of calls that were never reached."""
        return {call.index: CallResult(call) for call in self.source.plan.calls}

    @cached_property
    def servers(self) -> Mapping[str, tuple[str, ...]]:
        """The servers of its calls, as far as their names are known before they start, and the names of their actions."""
        found: dict[str, dict[str, None]] = {}
        for call in self.source.plan.calls:
            if call.action.operation is None and self.source.bindings.names_server(call.action):
                found.setdefault(self.source.bindings.server(call.action), {})[call.action.name] = None
        return {server: tuple(names) for server, names in found.items()}

    @property
    def results(self) -> tuple[CallResult, ...]:
        """What has become of its calls."""
        return self.replayed.result.calls if self.replayed.result else self.replayed.run.results

    @property
    def is_over(self) -> bool:
        """Whether nothing more comes of it."""
        return self.replayed.is_over or self.replayed.run.over

    def follow_troubles(self, what: str) -> None:
        """Note what has followed the troubles that nothing has followed yet."""
        for key, trouble in self.troubles.items():
            self.troubles[key] = trouble if trouble.followed else replace(trouble, followed=what)

    def lane(self, action: GroundAction) -> str:
        """Return whose an action is on a timeline: of whom it has something for itself, else of its first argument."""
        resources = self.source.bindings.resources(action)
        first = resources[0].strip("/").partition("/")[0] if resources else action.arguments[0] if action.arguments else action.name
        return action.name if first.startswith("?") else first


@dataclass
class TaskStory:
    """The story of one task. Mutable state is what has a default."""

    accepted: TaskAccepted
    is_held: bool
    runs: list[RunStory] = field(default_factory=list)
    decision: Decision | None = None
    """What was decided after the last run; None while it goes on."""
    used: TimeUsed | None = None
    ending: TaskEnding | None = None
    ended: float | None = None
    """When it was over."""
    helps: dict[UUID | None, str] = field(default_factory=dict)
    """The questions to a person that it has open, by the lost request that they are about, None for one how to go on."""


class Story:
    """The story of a journal so far. Everything in it is mutable state; `apply` is the only thing that changes it.

    Args:
        replay: of the journal, from the beginning of a segment.
    """

    def __init__(self, replay: replaying.Replay) -> None:
        self.replay = replay
        self.number = 0
        self.time = 0.0
        self.tasks: dict[UUID, TaskStory] = {}
        self.runs: dict[UUID, RunStory] = {}
        self.facts: Mapping[str, FactShown] = {}
        """A new mapping whenever one of them changes."""
        self.questions: dict[str, QuestionShown] = {}
        self.events: dict[int, EventShown] = {}
        self.clock: float | None = None
        """The time of day when the clock of the records was 0, as long as one process writes them."""
        self.segments: list[tuple[int, float]] = []
        """The first record, and the time, of the segments that it reaches back to: two at most."""
        self._mark = ""
        self._observed = 0
        """How many troubles the record that is being replayed has brought."""

    @property
    def first(self) -> int:
        """The first record that it reaches back to."""
        return self.segments[0][0] if self.segments else 0

    @property
    def began(self) -> float:
        """When that was."""
        return self.segments[0][1] if self.segments else 0.0

    def apply(self, number: int, time: float, record: Record) -> replaying.Step:
        """Replay a record, and note what it tells; raises as `Replay.apply` does."""
        self.number, self.time, self._mark, self._observed = number, max(self.time, time), "", 0
        step = self.replay.apply(number, time, record)
        self._note(step)
        task = self._task_of(record)
        self.events[number] = EventShown(self.time, task.hex if task else "", words(step, self.replay), self._mark)
        if (old := self.events.get(number - EVENTS)) and not old.mark:
            del self.events[number - EVENTS]
        return step

    def _task_of(self, record: Record) -> UUID | None:
        match record:
            case Happened(run) if run in self.runs:
                return self.runs[run].replayed.made.task
            case RunMade(_, task) | TaskNoted(task) | TaskOver(task):
                return task
            case TaskAccepted(wanted):
                return wanted.id
            case _:
                return None

    def _note(self, step: replaying.Step) -> None:
        match step.record:
            case SharedBegan():
                self._begin_segment()
            case KnowledgeBegan(base, facts) if base == WORLD:
                self.facts = {fluent_text(fluent): self._fact(fluent, value, is_initial=True) for fluent, value in facts.items()}
            case KnowledgeDelta():
                self._note_facts(step.record)
            case RunMade():
                self._note_run(step.record)
            case RunSucceeded(run, successor) if run in self.runs:
                self._hand_over(self.runs[run], self.runs[successor])
            case Happened():
                self._note_event(step.record, step)
            case TaskAccepted(wanted, _, wall):
                self.clock = wall - self.time
                if wanted.id not in self.tasks:
                    runs = [run for run in self.runs.values() if run.replayed.made.task == wanted.id]
                    self.tasks[wanted.id] = TaskStory(step.record, self.replay.is_held, runs)
            case TaskHeld(chosen, is_held):
                for id in (chosen,) if chosen else tuple(self.tasks):
                    if id in self.tasks:
                        self.tasks[id].is_held = is_held
            case TaskNoted(id, GoalNote(decision=decision)) if id in self.tasks and decision is not None:
                self._note_decision(self.tasks[id], decision)
            case TaskNoted(id, HelpAsked() | HelpEnded() as note) if id in self.tasks:
                self._note_help(self.tasks[id], note)
            case TaskOver(id, ending):
                self._end(self.tasks[id], ending)
            case TimeCounted(of, used) if of in self.tasks:
                self.tasks[of].used = used
            case _:
                pass

    def _begin_segment(self) -> None:
        """Forget what was before the last segment; what was in it stays, for its tasks have just ended."""
        self.segments = [*self.segments[-1:], (self.number, self.time)]
        self.replay.forget()
        self.runs = {id: run for id, run in self.runs.items() if run.record >= self.first}
        for task in self.tasks.values():
            task.runs = [run for run in task.runs if run.record >= self.first]
        self.tasks = {id: task for id, task in self.tasks.items() if task.runs}
        self.events = {number: event for number, event in self.events.items() if number >= self.first}
        self.questions = {}

    def _end(self, task: TaskStory, ending: TaskEnding) -> None:
        """Note that a task is over: its time stops, and that is what has followed its last troubles. A segment says so again."""
        if task.ending is None:
            task.ending, task.ended, self._mark = ending, self.time, "end"
            for run in task.runs:
                run.follow_troubles(f"its task is over: {ending.code.word}")

    # --- runs -------------------------------------------------------------------------------------

    def _note_run(self, made: RunMade) -> None:
        task, replayed = self.tasks.get(made.task), self.replay.runs[made.run]
        source = self.replay.source_of(made)
        cut = None
        if task:
            task.runs = [one for one in task.runs if one.replayed.run.begun]
        if task and task.runs:
            cut, self._mark = _cut(task.runs[-1], source.plan.calls, task.decision), "replan"
            task.runs[-1].follow_troubles(cut.why)
        story = self.runs[made.run] = RunStory(self.number, self.time, replayed, source, cut)
        replayed.run.observer = _Hearing(self, story)
        if task:
            task.runs.append(story)
            task.decision = None

    def _hand_over(self, old: RunStory, new: RunStory) -> None:
        """Note that a run goes on with requests of another one."""
        run = new.replayed.run
        for request, call in run.open_calls.items():
            if sent := old.requests.pop(request.hex, None):
                new.requests[request.hex] = replace(sent, run=run.id.hex, call=call.index)

    def _note_decision(self, task: TaskStory, decision: Decision) -> None:
        """Note why another run follows; one that succeeds another is there before that is kept."""
        last = task.runs[-1] if task.runs else None
        if last and last.cut and not last.is_over:
            last.cut = replace(last.cut, why=decision_words(decision))
        else:
            task.decision = decision

    def _note_help(self, task: TaskStory, note: HelpAsked | HelpEnded) -> None:
        self.questions.pop(task.helps.pop(note.request, ""), None)
        if isinstance(note, HelpAsked):
            wanted = task.accepted.wanted
            name = task.helps[note.request] = note.question.hex
            self.questions[name] = QuestionShown("a person", note.text, wanted.text or "the goal of the problem", self.time, note.choices)

    def note_sent(self, run: RunStory, call: ActionCall, request: Request) -> None:
        """Note that a request is sent."""
        action = request.action
        server = "" if action.operation is not None else run.source.bindings.server(action)
        run.requests[request.id.hex] = RequestShown(
            run.replayed.run.id.hex, call.index, str(action), run.lane(action), server, request.attempt, self.number, self.time
        )
        for key, trouble in run.troubles.items():
            if trouble.call == call.index and not trouble.followed:
                run.troubles[key] = replace(trouble, followed=f"tried again, attempt {request.attempt}")

    def note_trouble(self, run: RunStory, step: Step, cause: Explanation, *, is_failure: bool) -> None:
        """Note what a step was hindered by, or has failed with. A failure takes the place of the hindrance that led to it."""
        key = f"{self.number}.{self._observed}"
        if is_failure:
            self._mark = "failure"
            same = [key for key, known in run.troubles.items() if known.call == step.index and not known.followed and not known.is_failure]
            key = same[-1] if same else key
        self._observed += 1
        text = str(step.action if isinstance(step, ActionCall) else step)
        run.troubles[key] = TroubleShown(
            run.replayed.run.id.hex, step.index, text, is_failure, cause.cause.value, cause.expected, cause.observed, self.time
        )

    def _note_event(self, record: Happened, step: replaying.Step) -> None:
        for delta in record.deltas:
            self._note_facts(delta)
        run = self.runs[record.run]
        match record.event:
            case Accepted(id) if id.hex in run.requests:
                run.requests[id.hex] = replace(run.requests[id.hex], accepted=self.time)
            case Ended(id, outcome) if id.hex in run.requests:
                ended = replace(run.requests[id.hex], ended=self.time, outcome=outcome.kind.value, message=outcome.message)
                run.requests[id.hex] = ended
                if outcome.kind is not OutcomeKind.SUCCEEDED:
                    self._mark = self._mark or "failure"
            case Restarted():
                self.clock = None
            case Feedback(id, text) if id.hex in run.requests:
                run.requests[id.hex] = replace(run.requests[id.hex], feedback=text)
            case Answered(id):
                self.questions.pop(id.hex, None)
            case _:
                pass
        for command in step.commands:
            match command:
                case Ask(id, question) if question.layer is Layer.PERSON:
                    text = f"{question.name}: {_said(question.meta)}" if _said(question.meta) else question.name
                    self.questions[id.hex] = QuestionShown("a person", text, run.replayed.made.name, self.time)
                case Ask(id, question):
                    self.questions[id.hex] = QuestionShown("a source of knowledge", str(question), run.replayed.made.name, self.time)
                case Withdraw(id):
                    self.questions.pop(id.hex, None)
                case _:
                    pass

    # --- knowledge --------------------------------------------------------------------------------

    def _note_facts(self, delta: KnowledgeDelta) -> None:
        if delta.base != WORLD:
            return
        facts = dict(self.facts)
        if delta.sensed:
            sensed = {fluent_text(fluent): self.replay.world.is_sensed(fluent) for fluent in self.replay.world.facts()}
            facts = {name: replace(fact, source=_source(is_sensed=sensed.get(name, False))) for name, fact in facts.items()}
        self.facts = facts | {fluent_text(fluent): self._fact(fluent, value) for fluent, value in delta.facts.items()}

    def _fact(self, fluent: Fluent, value: Value | Unknown, *, is_initial: bool = False) -> FactShown:
        before = self.facts.get(fluent_text(fluent))
        was = "" if before is None or not isinstance(value, Unknown) else before.was or before.value
        return FactShown(value_words(value), _source(is_sensed=self.replay.world.is_sensed(fluent)), self.time, is_initial, was)


class _Hearing(Observer):
    """What a run that is replayed tells its story."""

    def __init__(self, story: Story, run: RunStory) -> None:
        self._story = story
        self._run = run

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self._story.note_sent(self._run, call, request)

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        self._story.note_trouble(self._run, call, cause, is_failure=False)

    def failed(self, failure: Failure, now: float) -> None:
        cause = Explanation(failure.cause, failure.expected, failure.observed)
        self._story.note_trouble(self._run, failure.call, cause, is_failure=True)


def _cut(before: RunStory, calls: tuple[ActionCall, ...], decision: Decision | None) -> Cut:
    """Return how a run with these calls follows another one."""
    last = {result.call.index: result for result in before.results}
    left = Counter(str(result.call.action) for result in last.values() if not result.is_done)
    new = Counter(str(call.action) for call in calls)
    kept, dropped, added = left & new, left - new, new - left
    return Cut(decision_words(decision), *(tuple(part.elements()) for part in (kept, dropped, added)))


def value_words(value: Value | Unknown) -> str:
    """Return what a fact is, in words."""
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
