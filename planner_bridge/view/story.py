"""The story that the page tells: the history of a journal, with facts, open questions, and its last records in words.

It reaches back to the beginning of the segment before the last one: a segment may begin as soon as a task has ended, and people still
want to see it then.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final, TypeVar, cast
from uuid import UUID

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.view.shown import EventShown, FactShown, QuestionShown, Shown
from pnm.core.execution.events import Answered, Ask, Restarted, Withdraw
from pnm.core.logic.computed_values import Layer
from pnm.core.logic.expressions import Fluent, Unknown, Value, fluent_text, text_of
from pnm.core.machine.requests import Ended, OutcomeKind
from pnm.journal import replay as replaying
from pnm.journal.records import (
    WORLD,
    Happened,
    KnowledgeBegan,
    KnowledgeDelta,
    MachineSource,
    Record,
    RunMade,
    SharedBegan,
    TaskAccepted,
    TaskOver,
)
from pnm.journal.replay import words

EVENTS: Final = 200
"""Records that are shown in words, besides those that are marked."""
_SEGMENTS: Final = 2
"""How many it reaches back to."""

T = TypeVar("T", bound=Shown)


class Story(JournalHistory):
    """The story of a journal so far. Everything in it is mutable state; `apply` is the only thing that changes it.

    Args:
        source: returns the source of the machine of a key.
    """

    def __init__(self, source: Callable[[str], MachineSource] | None = None) -> None:
        super().__init__(source, _SEGMENTS)
        self.facts: Mapping[str, FactShown] = {}
        """A new mapping whenever one of them changes."""
        self.events: dict[int, EventShown] = {}
        self.clock: float | None = None
        """The time of day when the clock of the records was 0, as long as one process writes them."""
        self._questions: dict[str, QuestionShown] = {}
        """Those of runs."""
        self._shown: dict[str, tuple[object, Shown]] = {}
        """What was shown last, and of what it was made: of most things nothing has changed since."""

    @property
    def questions(self) -> dict[str, QuestionShown]:
        """The questions that are open: those of runs, and those to a person about tasks."""
        about_tasks = {
            help.asked.question.hex: QuestionShown("a person", help.asked.text, task.name, help.since, help.asked.choices)
            for task in self.tasks.values()
            for help in task.helps.values()
        }
        return self._questions | about_tasks

    def apply(self, number: int, time: float, record: Record) -> replaying.ReplayStep:
        """Note what a record tells, and execute it, for it is shown what the runs want; raises as `Replay.apply` does."""
        super().apply(number, time, record)
        replay, step = self.execute(), self.step
        assert step is not None, "this record was executed"
        self._tell(step)
        task, mark = self.task_of(record), self._mark(record)
        self.events[number] = EventShown(self.time, task.hex if task else "", words(step, replay), mark)
        if (old := self.events.get(number - EVENTS)) and not old.mark:
            del self.events[number - EVENTS]
        return step

    def once(self, key: str, made_of: object, show: Callable[[], T]) -> T:
        """Return how a thing is shown: as it was, if it is made of the same as then."""
        if (known := self._shown.get(key)) is None or known[0] != made_of:
            known = self._shown[key] = made_of, show()
        return cast("T", known[1])

    def _mark(self, record: Record) -> str:
        """Return how a record is marked on the way through them."""
        match record:
            case TaskOver():  # also when it is said again, or what is shown would depend on what was read before
                return "end"
            case RunMade(run) if self.runs[run].replan is not None:
                return "replan"
            case Happened(event=Ended(outcome=outcome)) if outcome.kind is not OutcomeKind.SUCCEEDED:
                return "failure"
            case Happened(run) if any(trouble.record == self.number and trouble.is_failure for trouble in self.runs[run].latest):
                return "failure"
            case _:
                return ""

    def _tell(self, step: replaying.ReplayStep) -> None:
        match step.record:
            case SharedBegan():
                self.events = {number: event for number, event in self.events.items() if number >= self.first}
                self._questions, self._shown = {}, {}
            case KnowledgeBegan(base, facts) if base == WORLD:
                self.facts = {fluent_text(fluent): self._fact(fluent, value, is_initial=True) for fluent, value in facts.items()}
            case KnowledgeDelta():
                self._tell_facts(step.record)
            case TaskAccepted(wall=wall):
                self.clock = wall - self.time
            case Happened(run, event, deltas=deltas):
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
                    self._questions[id.hex] = QuestionShown("a person", text, name, self.time)
                case Ask(id, question):
                    self._questions[id.hex] = QuestionShown("a source of knowledge", str(question), name, self.time)
                case Withdraw(id):
                    self._questions.pop(id.hex, None)
                case _:
                    pass

    def _tell_facts(self, delta: KnowledgeDelta) -> None:
        if delta.base != WORLD:
            return
        facts = dict(self.facts)
        if delta.sensed:
            sensed = {fluent_text(fluent): self.world.is_sensed(fluent) for fluent in self.world.facts()}
            facts = {name: replace(fact, source=_source(is_sensed=sensed.get(name, False))) for name, fact in facts.items()}
        self.facts = facts | {fluent_text(fluent): self._fact(fluent, value) for fluent, value in delta.facts.items()}

    def _fact(self, fluent: Fluent, value: Value | Unknown, *, is_initial: bool = False) -> FactShown:
        before = self.facts.get(fluent_text(fluent))
        was = "" if before is None or not isinstance(value, Unknown) else before.was or before.value
        return FactShown(value_words(value), _source(is_sensed=self.world.is_sensed(fluent)), self.time, is_initial, was)


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
