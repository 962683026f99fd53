"""The spans of a journal: task, plan, call and attempt, with their times of day; and how they get to a collector, by OTLP over HTTP.

They show the history of a journal, as a process of its own reads it: nobody who drives robots knows of it. Their ids follow from those
of the journal. So what goes on after the death of a process is one trace, and what is exported twice is the same twice.
"""

from __future__ import annotations

import logging
import socket
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from hashlib import blake2b
from math import inf
from time import sleep
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, TypeAlias
from urllib.parse import urlsplit
from uuid import UUID

from planner_bridge.explanations.history import Attempt, RunHistory, TaskHistory, Trouble
from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.tasks.replanning import PlanAgain
from planner_bridge.tasks.result import TASKS, GoalNote
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import Story, value_words
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Answered
from pnm.core.machine.plan_graph import step_words
from pnm.core.machine.requests import CallOutcome, OutcomeKind
from pnm.errors import InputError, PnmError, counted, not_installed, printable
from pnm.files.database.place import Place
from pnm.journal import records
from pnm.journal.replay import ReplayStep
from pnm.journal.store import KeptJournal
from pnm.knowledge.people import HelpEnded
from pnm.tasks import Code

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import ReadableSpan

LONG: Final = 1000
"""Characters of a text that goes elsewhere."""

Attributes: TypeAlias = Mapping[str, str | int | float | bool]


class SpanEvent(NamedTuple):
    """Something that happened in a span, at a time on the clock of the journal."""

    name: str
    time: float
    attributes: Attributes


@dataclass(frozen=True, slots=True)
class Span:
    """A span, in seconds of the day.

    Args:
        kind: ``task``, ``plan``, ``call`` or ``attempt``.
        trace: the id of its task.
        parent: the id of the span around it; None for a task.
        ended: None while it goes on.
        failed: why it has failed; empty if it has not.
    """

    kind: str
    trace: UUID
    id: int
    parent: int | None
    name: str
    began: float
    ended: float | None
    attributes: Attributes
    events: tuple[SpanEvent, ...] = ()
    failed: str = ""


def _id(of: UUID, *within: int) -> int:
    """Return the id of a span: the same whenever the journal is read."""
    return int.from_bytes(blake2b(of.bytes + repr(within).encode(), digest_size=8).digest())


def _short(text: object) -> str:
    return printable(str(text))[:LONG]


class Spans(Story):
    """The story of a journal from its first record on, as spans. `apply` and `ended` are the only things that change it."""

    def __init__(self, kept: KeptJournal, known: KnownRobots = NOTHING_KNOWN) -> None:
        super().__init__(lambda key: TASKS.value(kept.part(key)), known)
        self._kept = kept
        self._epoch = 0
        self._clocks: list[tuple[float, float]] = []
        """For each process that has written it the time from which it counted, and the time of day when its clock was 0."""
        self._is_exact = False
        """Whether the last of these is known exactly: by a task that it has accepted."""
        self._notes: dict[UUID, list[SpanEvent]] = {}
        """By task and by run, what has happened there and is no trouble."""
        self._given: set[int] = set()
        self._ended: list[Span] = []

    @classmethod
    def of(cls, kept: KeptJournal, number: float, known: KnownRobots = NOTHING_KNOWN) -> Self:
        """Return the story of a journal before its first record."""
        return cls(kept, known)

    def apply(self, number: int, time: float, record: records.Record) -> ReplayStep:
        """Note and execute a record; raises as `Replay.apply` does."""
        if isinstance(record, records.SharedBegan):
            self._gather()  # of what is forgotten then
        if (epoch := self._kept.seen.epoch) != self._epoch:
            began = self._kept.epoch_began(epoch)
            self._epoch, self._is_exact = epoch, False
            self._clocks.append((self.time, began - self.time) if self._clocks else (-inf, began - time))
        is_again = self._repetition.left > 0
        match record:
            case records.TaskAccepted(wall=wall) if not (is_again or self._is_exact):
                self._clocks[-1], self._is_exact = (self._clocks[-1][0], wall - time), True
            case records.TaskEntered(task, state, reason) if not is_again:
                self._note(task, "state", time, state=state.word, reason=reason)
            case records.TaskNoted(task, HelpEnded(why)) if not is_again:
                self._note(task, "answer", time, answer=why)
            case records.TaskNoted(task, GoalNote(decision=PlanAgain(forbidden=calls))) if calls and not is_again:
                self._note(task, "forbidden", time, calls=", ".join(sorted(map(str, calls))))
            case records.Happened(run, Answered(id, value, message)):
                asked = self._questions.get(id.hex)
                said = message or (value_words(value) if isinstance(value, bool | int | float) else str(value))
                self._note(run, "answer", time, question=asked["text"] if asked else "", answer=said)
            case _:
                pass
        return super().apply(number, time, record)

    def ended(self) -> list[Span]:
        """Return the spans that have ended since this was asked last."""
        self._gather()
        found, self._ended = self._ended, []
        return found

    def every(self) -> list[Span]:
        """Return the spans that have ended since that was asked last, and the others as if they ended with the journal."""
        now, goes_on = self.wall(self.time) or 0.0, [span for span in self.spans() if span.ended is None]
        so_far = (replace(span, ended=max(span.began, now), attributes={**span.attributes, "pnm.goes_on": True}) for span in goes_on)
        return [*self.ended(), *so_far]

    def last(self) -> int:
        """Return the number of the last record that is there."""
        return self._kept.last()

    def spans(self) -> Iterator[Span]:
        """Yield the spans of the tasks that it reaches back to, whether they have ended or not."""
        for task in self.tasks.values():
            if not task.is_told:
                continue
            wanted, ending = task.accepted.wanted, task.ending
            told = {"id": str(wanted.id), "goal": task.name, "state": task.state.word, "priority": wanted.priority}
            told |= {"code": ending.code.word, "reason": ending.message} if ending else {}
            events = list(self._notes.get(wanted.id, ()))
            for run in task.own_runs:
                if (new := run.replan) is not None:
                    counts = {"pnm.kept": len(new.kept), "pnm.dropped": len(new.dropped), "pnm.added": len(new.added)}
                    events.append(SpanEvent("replan", run.time, {"pnm.why": _short(new.why), **counts}))
            failed = f"{ending.code.word}: {ending.message}" if ending and ending.code is not Code.GOAL_REACHED else ""
            yield self._span("task", task, _id(wanted.id), None, task.name, task.accepted.wall, self.wall(task.ended), told, events, failed)
            for number, run in enumerate(task.runs, 1):
                yield from self.plan_spans(task, run, number)

    def plan_spans(self, task: TaskHistory, run: RunHistory, number: int) -> Iterator[Span]:
        """Yield the span of a run, whose number in its task is given, and those of its calls."""
        above = _id(task.accepted.wanted.id) if run.made.caller is None else _id(run.made.caller)
        elsewhere = [trouble for trouble in run.troubles.values() if trouble.step.index not in run.sent]
        events = [*self._notes.get(run.id, ()), *map(self._trouble, elsewhere)]
        failed = next((f"{step_words(one.step)}: {one.cause.cause}" for one in run.failures), "")
        follows = "first" if run.replan is None else "better" if run.is_foreseen else "replan"
        told = {"run": str(run.id), "plan": number, "calls": len(run.source.plan.calls), "follows": follows}
        began, ended = self.wall(run.time), self.wall(run.ended)
        yield self._span("plan", task, _id(run.id), above, f"plan {number} of {run.made.name}", began or 0.0, ended, told, events, failed)
        for index in run.sent:
            rounds: list[list[tuple[UUID, Attempt]]] = []
            for request in run.sent[index]:
                if (attempt := self.attempts[request]).number == 1 or not rounds:
                    rounds.append([])
                rounds[-1].append((request, attempt))
            for number, attempts in enumerate(rounds):
                yield from self.call_spans(task, run, index, number, attempts, is_last=number + 1 == len(rounds))

    def call_spans(
        self, task: TaskHistory, run: RunHistory, index: int, number: int, attempts: Sequence[tuple[UUID, Attempt]], *, is_last: bool
    ) -> Iterator[Span]:
        """Yield the span of a call, and of its attempts, in one of the rounds of a loop."""
        (_, first), (_, last) = attempts[0], attempts[-1]
        result, ended = CallResult(run.source.plan.calls[index]), last.ended
        if is_last:  # of others no more is known than how their attempts ended
            result = run.last_results.get(index, result)
            ended = run.ended if result.is_under_way or result.ended is None else result.ended
        mine = [one for one in run.troubles.values() if one.step.index == index and one.time >= first.sent]
        mine = [one for one in mine if is_last or (last.ended is not None and one.time <= last.ended)]
        id, action = _id(run.id, index, number), last.action
        told = {"action": action.name, "robot": run.lane(action), "server": run.server(action), "attempts": len(attempts)}
        told |= {"outcome": result.outcome} if is_last else {}
        failed = result.outcome if result.kind in (CallOutcome.FAILED, CallOutcome.CANCELED) else ""
        yield self._span(
            "call",
            task,
            id,
            _id(run.id),
            str(action),
            self.wall(first.sent) or 0.0,
            self.wall(ended),
            told,
            list(map(self._trouble, mine)),
            failed,
        )
        for request, attempt in attempts:
            over, outcome = self.runs.get(attempt.run, run), attempt.outcome
            kind = outcome.kind.value if outcome else ""
            told = {"action": attempt.action.name, "robot": run.lane(attempt.action), "server": run.server(attempt.action)}
            told |= {"request": str(request), "attempt": attempt.number, "end": kind}
            events = [] if attempt.accepted is None else [SpanEvent("accepted", attempt.accepted, {})]
            events += [] if not attempt.feedback else [SpanEvent("feedback", attempt.ended or self.time, {"pnm.text": attempt.feedback})]
            failed = f"{kind}: {outcome.message}" if outcome and outcome.kind is not OutcomeKind.SUCCEEDED else ""
            began, ended = self.wall(attempt.sent) or 0.0, self.wall(over.ended if attempt.ended is None else attempt.ended)
            name = f"{attempt.action}, attempt {attempt.number}"
            yield self._span("attempt", task, _id(request), id, name, began, ended, told, events, failed)

    def _span(
        self,
        kind: str,
        task: TaskHistory,
        id: int,
        parent: int | None,
        name: str,
        began: float,
        ended: float | None,
        told: Mapping[str, Any],
        events: Sequence[SpanEvent],
        failed: str,
    ) -> Span:
        attributes = {f"pnm.{key}": _short(value) if isinstance(value, str) else value for key, value in told.items()}
        walls = tuple(one._replace(time=self.wall(one.time) or began) for one in sorted(events, key=lambda one: one.time))
        end = None if ended is None else max(began, ended)
        return Span(kind, task.accepted.wanted.id, id, parent, _short(name), began, end, attributes, walls, _short(failed))

    def wall(self, time: float | None) -> float | None:
        """Return the time of day of a time on the clock of the journal: at the moment of a take-over that before it."""
        return None if time is None else time + self._clocks[max(0, bisect_left(self._clocks, (time,)) - 1)][1]

    def _note(self, of: UUID, name: str, time: float, **told: str) -> None:
        attributes = {f"pnm.{key}": _short(text) for key, text in told.items() if text}
        self._notes.setdefault(of, []).append(SpanEvent(name, max(self.time, time), attributes))

    def _trouble(self, trouble: Trouble) -> SpanEvent:
        told = {"cause": trouble.cause.cause.value, "expected": trouble.cause.expected, "observed": trouble.cause.observed}
        told |= {"step": step_words(trouble.step), "followed": trouble.followed}
        name = "failure" if trouble.is_failure else "hindrance"
        return SpanEvent(name, trouble.time, {f"pnm.{key}": _short(text) for key, text in told.items() if text})

    def _gather(self) -> None:
        """Take in the spans that have ended."""
        known = set()
        for span in self.spans():
            if span.ended is not None:
                known.add(span.id)
                if span.id not in self._given:
                    self._ended.append(span)
        self._given = known
        alive = self.tasks.keys() | self.runs.keys()
        self._notes = {of: notes for of, notes in self._notes.items() if of in alive}


# --- OTLP -----------------------------------------------------------------------------------------
# To a collector. The SDK of OpenTelemetry says what spans look like there; its exporter tries each request again for some seconds.

_BATCH: Final = 512
"""Spans of a request."""
_TRIES: Final = 5
"""Requests in a row that may fail before it is given up."""
_PERIOD: Final = 1.0
"""Seconds between two looks into a journal that is followed, and between two tries."""
_TIMEOUT: Final = 5.0
"""Seconds of a request."""
_NANO: Final = 1e9

Send: TypeAlias = "Callable[[Sequence[ReadableSpan]], str]"
"""Sends spans, and returns why they were not taken; empty if they were."""


def collector(url: str) -> Send:
    """Return what sends spans to a collector of traces by OTLP over HTTP.

    Raises an `InputError` if the URL is none, or an extra is not installed.
    """
    try:
        parts = urlsplit(url)
        port = parts.port or (443 if parts.scheme == "https" else 80)
    except ValueError as error:  # an address or a port that is none
        raise InputError(f"expected the URL of a collector, such as http://localhost:4318: {error}") from error
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError("expected the URL of a collector, such as http://localhost:4318")
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.trace.export import SpanExportResult
    except ModuleNotFoundError as error:
        raise not_installed("this", error, "telemetry") from error
    path = parts.path if parts.path.strip("/") else "/v1/traces"
    exporter = OTLPSpanExporter(parts._replace(path=path).geturl(), timeout=_TIMEOUT)
    said: list[str] = []

    class Heard(logging.Handler):
        """Keeps what the exporter logs: it says by that alone why it has failed."""

        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    log = logging.getLogger("opentelemetry")
    log.addHandler(Heard())
    log.propagate = False

    def send(spans: Sequence[ReadableSpan]) -> str:
        said.clear()
        try:  # which says why there is no way to it; the exporter does not
            socket.create_connection((str(parts.hostname), port), _TIMEOUT).close()
        except OSError as error:
            return f"{parts.hostname}, port {port}: {error.strerror or error}"
        return "" if exporter.export(spans) is SpanExportResult.SUCCESS else _short(said[-1] if said else "it was not said why")

    return send


def export(place: Place, send: Send, *, follows: bool, pause: Callable[[float], object] = sleep) -> int:
    """Send the spans of a journal, also those that go on, as far as they have come; return how many.

    With `follows`, send those that have ended, and each of the others when it ends, until somebody interrupts that.

    Raises:
        PnmError: the journal is not read, or what was to be sent was not taken, several times in a row.
    """
    count, waiting = 0, list[Span]()
    with closing(Reader(place, tells=Spans)) as reader:
        while True:
            waiting += reader.now(Spans.ended if follows else Spans.every)
            while waiting:
                spans = list(map(readable, waiting[:_BATCH]))
                for tried in range(1, _TRIES + 1):
                    if not (why := send(spans)):
                        break
                    if tried == _TRIES:
                        raise PnmError(f"{counted(len(waiting), 'span')} not sent: {why}")
                    pause(_PERIOD)
                del waiting[:_BATCH]
                count += len(spans)
            if not follows:
                return count
            pause(_PERIOD)


def readable(span: Span) -> ReadableSpan:
    """Return a span as the SDK of OpenTelemetry has it."""
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import Event, ReadableSpan
    from opentelemetry.trace import SpanContext, SpanKind, Status, StatusCode, TraceFlags

    def context(id: int) -> SpanContext:
        return SpanContext(span.trace.int, id, is_remote=False, trace_flags=TraceFlags(TraceFlags.SAMPLED))

    return ReadableSpan(
        span.name,
        context(span.id),
        None if span.parent is None else context(span.parent),
        Resource({"service.name": "pnm"}),
        {"pnm.kind": span.kind, **span.attributes},
        [Event(one.name, one.attributes, int(one.time * _NANO)) for one in span.events],
        kind=SpanKind.CLIENT if span.kind == "attempt" else SpanKind.INTERNAL,
        status=Status(StatusCode.ERROR, span.failed) if span.failed else Status(StatusCode.UNSET if span.ended is None else StatusCode.OK),
        start_time=int(span.began * _NANO),
        end_time=None if span.ended is None else int(span.ended * _NANO),
    )
