"""The history of a journal: what its records tell of tasks, of their runs and of what was sent. It is the only place that adds them up.

What happened, when, in which words, and what followed: the records say that, and whoever asks for no more waits for nothing else.
How things are now, in the middle of a run, they do not say. For that a replay executes the runs again, once somebody asks; it
compares what they do with what the records say of it. The page, `pnm why` and timelines show parts of this history, so that all tell
one story.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple, assert_never
from uuid import UUID

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.progression import snapshot
from planner_bridge.tasks.replanning import Decision, Foreseen, decision_words
from planner_bridge.tasks.result import TASKS, GoalNote, PolicyNote, TaskCounts
from pnm.clock import TimeUsed
from pnm.core.execution.call_results import Became, CallResult, Explanation, Hindered, Sent, action_with, sent_with
from pnm.core.execution.events import Begin
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, Step
from pnm.core.machine.requests import Accepted, Ended, Feedback, Outcome
from pnm.core.net.no_collection import no_collection
from pnm.core.pictures.timeline import Replan, replan
from pnm.errors import PnmError
from pnm.files.database.place import Place
from pnm.journal import records
from pnm.journal.replay import Replay, ReplayedRun, ReplayStep
from pnm.journal.resume import damage, steps_after
from pnm.journal.store import KeptJournal
from pnm.knowledge.people import HelpAsked, HelpEnded
from pnm.tasks import TaskEnding, TaskState

if TYPE_CHECKING:
    from planner_bridge.planning.policies.policy import Policy

_FREES: Final = (records.Happened, records.EndConfirmed, records.RunRetired, records.RunSucceeded, records.ClaimsBegan)
"""Records with which resources are given, or given back."""


class Attempt(NamedTuple):
    """A request: one attempt at a call.

    Args:
        run: the run that has it: it may have passed from one to the next.
        call: the number of the call there.
        sender: the run that has sent it.
        accepted: when its server took it on.
        feedback: what its server has said last while it was at work.
    """

    run: UUID
    call: int
    sender: UUID
    action: GroundAction
    number: int
    record: int
    sent: float
    accepted: float | None = None
    ended: float | None = None
    outcome: Outcome | None = None
    feedback: str = ""


@dataclass(frozen=True, slots=True)
class Trouble:
    """A hindrance or a failure of a step.

    Args:
        cause: with what was expected and what was observed.
        attempt: how often its call had been sent by then.
        is_failure: whether the step was given up; else it is tried again, or recovers.
        hindrance: what has led to a failure, and was trouble of its own before.
        followed: what came of it, in words; empty as long as nothing did.
    """

    step: Step
    cause: Explanation
    record: int
    time: float
    attempt: int
    is_failure: bool
    hindrance: Trouble | None = None
    followed: str = ""


@dataclass(frozen=True, slots=True)
class HeldResources:
    """Resources that a request had for itself, from when until when; None while it has them."""

    action: str
    names: tuple[str, ...]
    since: float
    until: float | None = None


@dataclass(frozen=True, slots=True)
class Help:
    """A question to a person how a task goes on, and since when it is open."""

    asked: HelpAsked
    since: float


@dataclass
class RunHistory:
    """The history of a run. The history of its journal alone changes it.

    Args:
        record: with which it was made; 0 if that is not known any more.
        state: the facts when it was made.
        executed: executes what has not been executed yet, and returns the run.
    """

    record: int
    time: float
    made: records.RunMade
    source: records.MachineSource
    state: KnowledgeBase
    executed: Callable[[], ReplayedRun]
    policy: PolicyNote | None = None
    """What its plan is the beginning of, if actions have several outcomes."""
    replan: Replan | None = None
    """Why it followed the run before it, and how its plan differs; None for the first one, and for a plan that a call is."""
    begun: bool = False
    """Whether it has begun."""
    origin: float | None = None
    """The time from which releases count; its beginning unless it was given another one."""
    results: Mapping[int, CallResult] | None = None
    """The results of the calls that it has reached, by number, once it is not carried on any more."""
    ended: float | None = None
    """The time from which it is not."""
    sent: dict[int, list[UUID]] = field(default_factory=dict)
    """The requests that it has sent, by call."""
    requests: int = 0
    """The number of calls for action servers."""
    troubles: dict[str, Trouble] = field(default_factory=dict)
    """By record, and their number in it."""
    open: dict[str, None] = field(default_factory=dict)
    """The troubles that nothing has followed yet, in their order."""
    is_decided: bool = False
    """Whether it is known which decision it has followed."""
    is_foreseen: bool = False
    """Whether it is no replan: with a better rest of the plan, or after a declared outcome."""

    @property
    def id(self) -> UUID:
        """Its identity."""
        return self.made.run

    @property
    def last_results(self) -> Mapping[int, CallResult]:
        """The results of its calls, by number; the last result of repeated calls."""
        if self.results is None:
            run = self.executed().run
            return {call.index: run.result_of(call.index) for call in self.source.plan.calls}
        return {**self.unreached, **self.results}

    @cached_property
    def steps(self) -> Mapping[int, Step]:
        """The steps of its plan, by number."""
        return {step.index: step for step in self.source.plan.every_step}

    @cached_property
    def unreached(self) -> Mapping[int, CallResult]:
        """The results of calls that were never reached."""
        return {call.index: CallResult(call) for call in self.source.plan.calls}

    @property
    def is_over(self) -> bool:
        """Whether nothing more comes of it."""
        return self.results is not None or self.executed().run.over

    @cached_property
    def followed(self) -> Policy | None:
        """The policy that it is the beginning of, for the state in which it began; None if none is known."""
        note = self.policy
        return note.policy(problem_now(note.problem, self.state)) if note and note.problem else None

    @property
    def is_own(self) -> bool:
        """Whether it is one of its task itself, and not of a plan that a call of it is."""
        return self.made.caller is None

    @property
    def failures(self) -> tuple[Trouble, ...]:
        """Its failures."""
        return tuple(trouble for trouble in self.troubles.values() if trouble.is_failure)

    @property
    def hindrances(self) -> tuple[Trouble, ...]:
        """Its hindrances, also those that have led to failures."""
        found = (trouble.hindrance if trouble.is_failure else trouble for trouble in self.troubles.values())
        return tuple(trouble for trouble in found if trouble is not None)

    @property
    def latest(self) -> tuple[Trouble, ...]:
        """The troubles that nothing has followed yet."""
        return tuple(self.troubles[key] for key in self.open)

    def time_of(self, event: PlanEvent) -> float | None:
        """Return when a call began or ended; None before."""
        result = self.last_results.get(event.call)
        return None if result is None else result.started if event.moment is Moment.START else result.ended

    def lane(self, action: GroundAction) -> str:
        """Return whose an action is: of whom it has something for itself, else its first argument, who acts."""
        resources = self.source.bindings.resources(action)
        first = resources[0].strip("/").partition("/")[0] if resources else action.arguments[0] if action.arguments else action.name
        return action.name if first.startswith("?") else first

    def server(self, action: GroundAction) -> str:
        """Return who carries out an action; empty for an operation on knowledge, and while a name is not known."""
        bindings = self.source.bindings
        return "" if action.operation is not None or not bindings.names_server(action) else bindings.server(action)

    @cached_property
    def servers(self) -> Mapping[str, tuple[str, ...]]:
        """The servers of its calls, as far as their names are known before they start, and the names of their actions."""
        found: dict[str, dict[str, None]] = {}
        for call in self.source.plan.calls:
            if server := self.server(call.action):
                found.setdefault(server, {})[call.action.name] = None
        return {server: tuple(names) for server, names in found.items()}

    def follow(self, what: str, step: int | None = None) -> None:
        """Note the consequence of the open troubles, of one step or of all."""
        for key in [key for key in self.open if step in (None, self.troubles[key].step.index)]:
            self.troubles[key] = replace(self.troubles[key], followed=what)
            del self.open[key]


@dataclass
class TaskHistory:
    """The history of a task, its runs in the order in which they were made. The history of its journal alone changes it."""

    accepted: records.TaskAccepted
    time: float
    runs: list[RunHistory]
    record: int
    """With which it was accepted; 0 if that is not known any more."""
    is_told: bool = True
    """Whether the records are there that tell how it went; else only how it has ended."""
    state: TaskState = TaskState.QUEUED
    reason: str = ""
    """Why it is in this state, if that was said."""
    decision: Decision | None = None
    """The decision after the last run; None while it goes on."""
    policy: PolicyNote | None = None
    """What the last plan is the beginning of, if actions have several outcomes."""
    plans: int = 0
    """The number of plans that a planner has found."""
    helps: dict[UUID | None, Help] = field(default_factory=dict)
    """The questions to a person that are open, by the lost request that they are about; None for one how it goes on."""
    used: TimeUsed | None = None
    """The used part of its limit."""
    ending: TaskEnding | None = None
    ended: float | None = None
    """The time of its end."""

    @property
    def name(self) -> str:
        """Its subject."""
        return self.accepted.wanted.words

    @property
    def own_runs(self) -> tuple[RunHistory, ...]:
        """Its runs without those of plans that calls of it are."""
        return tuple(run for run in self.runs if run.is_own)

    def seconds(self, now: float) -> float:
        """Return the seconds of its limit that are used, which stop with its end."""
        return self.used.until(now if self.ended is None else self.ended) if self.used else 0.0

    @property
    def counts(self) -> TaskCounts:
        """Counts of events."""
        own, callers = self.own_runs, {run.made.caller for run in self.runs if not run.is_own}
        requests, failures = sum(run.requests for run in self.runs) - len(callers), sum(len(run.failures) for run in own)
        replans = sum(not run.is_foreseen for run in own[1:])
        return TaskCounts(self.plans, replans, requests, failures, has_run=bool(own))


def beginning(kept: KeptJournal, number: float, reach: int = 1) -> int:
    """Return the record behind which one has to begin to know all from the segment of a record on; raises as `KeptJournal.rows` does.

    What went on when that segment began has begun behind it as well, and so for as many segments before as `reach` says.
    """
    segments, since = kept.segments(), 0
    if not segments:
        return 0
    first = segments[max(0, bisect_right(segments, number) - reach)]
    with suppress(PnmError):  # which whoever replays it raises with its place
        began = next((TASKS.value(row.text) for _, row in kept.rows(first - 1)), None)
        since = began.since if isinstance(began, records.SharedBegan) else 0
    return (since or first) - 1


class SegmentStart(NamedTuple):
    """The beginning of a segment: its first record, its time, and where the oldest began of what goes on then."""

    number: int
    time: float
    since: int


class JournalHistory:
    """The history of a journal so far. Everything in it is mutable state; `apply` is the only thing that changes it.

    Args:
        source: returns the source of the machine of a key.
        reach: the last segments that it reaches back to, None for all. What is told of them depends on them alone, whoever has
            read how much before.
    """

    def __init__(self, source: Callable[[str], records.MachineSource] | None = None, reach: int | None = None) -> None:
        self._source = source
        self._sources: dict[str, records.MachineSource] = {}
        self._replay = Replay(self._sources.__getitem__)
        self._pending: deque[tuple[int, float, records.Record]] = deque()
        """The records that the replay has not executed yet."""
        self._step: ReplayStep | None = None
        """The record that was executed last."""
        self._executed: dict[UUID, ReplayedRun] = {}
        self.world = KnowledgeBase()
        """The knowledge that all runs share."""
        self.world_began = 0.0
        """The beginning of the world, which may be in an earlier segment."""
        self.number = 0
        self.time = 0.0
        self.segments: list[SegmentStart] = []
        """The beginnings of the segments that it reaches back to."""
        self._repetition = records.Repetition()
        self._known: frozenset[UUID] = frozenset()
        """The tasks of which it is known already."""
        self.tasks: dict[UUID, TaskHistory] = {}
        self.runs: dict[UUID, RunHistory] = {}
        self.attempts: dict[UUID, Attempt] = {}
        self._held: dict[UUID, HeldResources] = {}
        self._reach = reach
        self._observed = 0
        """The number of troubles in the record that is being replayed."""
        self._holding: set[UUID] = set()
        """The requests that have something."""
        self._begins = False
        """Whether a segment has begun, and no record has come since but those that say again what was before."""

    @staticmethod
    def read(place: Place, last: int | None = None) -> JournalHistory:
        """Read a journal, up to and with a record if one is given; raises as `steps_after` does."""
        with closing(KeptJournal(place)) as kept, no_collection():
            history = JournalHistory(lambda key: TASKS.value(kept.part(key)))
            for step in steps_after(kept, TASKS, history.apply, 0):
                if step.number == last:
                    break
        return history

    @property
    def first(self) -> int:
        """The first record that it reaches back to."""
        return self.segments[0].number if self.segments else 0

    @property
    def began(self) -> float:
        """Its time."""
        return self.segments[0].time if self.segments else 0.0

    def execute(self) -> ReplayStep | None:
        """Execute the runs as far as that is not done, and return the last record as it was executed; raises as `steps_after` does."""
        with no_collection():
            while self._pending:
                number, time, record = self._pending[0]  # which stays if it cannot be executed: there is no state after it
                try:
                    self._step = self._replay.apply(number, time, record)
                    if isinstance(record, records.SharedBegan):
                        self._replay.forget()
                        self._held = {id: self._held[id] for id in self._holding} if record.again else {}
                        self._holding &= self._held.keys()
                    elif isinstance(record, records.RunMade | records.RunStands):
                        made = record if isinstance(record, records.RunMade) else record.made
                        self._executed[made.run] = self._replay.runs[made.run]
                    elif isinstance(record, _FREES):
                        now = {claim.request: claim for claim in self._replay.resources.held}
                        for request in self._holding - now.keys():
                            self._held[request] = replace(self._held[request], until=self._replay.now)
                        for request in (now.keys() - self._holding) & self._replay.requests.keys():
                            action = str(self._replay.requests[request].action)
                            self._held[request] = HeldResources(action, now[request].names, self._replay.now)
                        self._holding = self._held.keys() & now.keys()
                except PnmError:
                    raise
                except Exception as error:
                    raise damage("the journal", number - 1, error) from error
                self._pending.popleft()
        return self._step

    @property
    def replay(self) -> Replay:
        """The state after the last record; raises as `steps_after` does."""
        self.execute()
        return self._replay

    @property
    def held(self) -> Mapping[UUID, HeldResources]:
        """The resources of requests, now or earlier."""
        self.execute()
        return self._held

    def apply(self, number: int, time: float, record: records.Record) -> ReplayStep:
        """Note a record; it is executed once somebody asks for the state after it."""
        self.number, self.time, self._observed = number, max(self.time, time), 0
        self._pending.append((number, time, record))
        begins, self._begins = self._begins, False
        is_again = self._repetition.has(record)
        match record:
            case records.Happened():
                self._note_event(self.runs[record.run], time, record)
            case records.SharedBegan(began=began, since=since):
                self.world_began = began
                self._begin_segment(since or self.number)
            case records.RunStands(made, state, results):
                self._source_of(made)  # for who executes it
                if made.run not in self.runs:  # else it is said again
                    self._note_run(made, time)
                    run = self.runs[made.run]
                    run.record = 0  # which is too far back
                    run.begun, run.origin = state["state"]["has_begun"], state["state"]["origin"]
                    if results is not None:
                        self._note_results(run, results)
            case records.TaskEntered(id) | records.TaskNoted(id) | records.TimeCounted(id) if is_again and id in self._known:
                pass
            case records.KnowledgeBegan(base) if base == records.WORLD:
                self.world, self._begins = records.base_of(record), begins
            case records.KnowledgeDelta(base) if base == records.WORLD:
                records.change(self.world, record)
            case records.RunMade():
                self._note_run(record, self.time)
            case records.RunSucceeded(run, successor, results):
                self._note_results(self.runs[run], results)
                for call, taken in self.runs[successor].made.adopted.items():  # requests that pass to it
                    if taken.request in self.attempts:
                        self.attempts[taken.request] = self.attempts[taken.request]._replace(run=successor, call=call)
            case records.RunRetired(run, results):
                self._note_results(self.runs[run], results)
            case records.TaskAccepted(wanted):
                self._begins, known = begins, self.tasks.get(wanted.id)
                if known is None or known.accepted != record:  # else it is said again
                    since = self.segments[-1].number
                    runs = [run for run in self.runs.values() if run.made.task == wanted.id]  # of a plan, before it is accepted
                    runs = [run for run in runs if run.record >= since or run.results is None]
                    accepted = (time, 0) if is_again else (self.time, number)
                    self.tasks[wanted.id] = TaskHistory(record, accepted[0], runs, accepted[1])
            case records.TaskHeld():
                self._begins = begins
            case records.TaskEntered(id, state, reason) if id in self.tasks:
                self.tasks[id].state, self.tasks[id].reason = state, reason
            case records.TaskNoted(id, note) if id in self.tasks:
                self._note_task(self.tasks[id], note)
            case records.TimeCounted(of, used) if of in self.tasks:
                self.tasks[of].used = used
            case records.TaskOver(id, ending):
                self._begins, task = begins, self.tasks[id]
                if task.ended is None:  # else it is said again
                    task.is_told = not begins or self.segments[-1].number == 1
                    task.ending, task.ended, task.state, task.reason = ending, self.time, TaskState.OVER, ending.message
                    for own in task.runs:
                        own.follow(f"its task is over: {ending.code.word}")
            case _:
                pass
        return ReplayStep(number, time, record)

    def sent(self, run: RunHistory, call: int) -> list[Attempt]:
        """Return the requests that a run has sent for a call."""
        return [self.attempts[request] for request in run.sent.get(call, ())]

    def _begin_segment(self, since: int) -> None:
        """Forget what is too far back: what went on in the segments that it reaches back to is known from its beginning."""
        self.segments.append(SegmentStart(self.number, self.time, since))
        self._begins = True
        if self._reach is not None:
            first, before = self.segments[-self._reach :][0].since, self.tasks
            self.segments = [one for one in self.segments if one.number >= first]
            whole = ((id, task) for id, task in before.items() if task.record >= self.first)
            self.tasks = {id: task for id, task in whole if task.runs or task.ended is None}
            kept = self.tasks.keys() | {run.made.task for run in self.runs.values() if run.record >= self.first} - before.keys()
            self.runs = {id: run for id, run in self.runs.items() if run.made.task in kept}
            self.attempts = {id: attempt for id, attempt in self.attempts.items() if attempt.sender in self.runs}
            self._executed = {id: run for id, run in self._executed.items() if id in self.runs}
            self._sources.clear()
        self._known = frozenset(self.tasks)

    def _note_task(self, task: TaskHistory, note: object) -> None:
        match note:
            case GoalNote(plans=plans, decision=decision):
                task.plans = plans
                if decision is not None:  # a run that succeeds one that goes on is made before that is kept
                    last = task.own_runs[-1] if task.own_runs else None
                    if last and last.replan and not last.is_decided and last.results is None:
                        last.replan, last.is_decided = replace(last.replan, why=decision_words(decision)), True
                        last.is_foreseen = isinstance(decision, Foreseen)
                    else:
                        task.decision = decision
            case PolicyNote():
                task.policy = note
            case HelpAsked(request=request):
                task.helps[request] = Help(note, self.time)
            case HelpEnded(request=request):
                task.helps.pop(request, None)
            case _:
                pass

    def _source_of(self, made: records.RunMade) -> records.MachineSource:
        if (source := self._sources.get(made.machine)) is None:
            assert self._source is not None, "a history reads machines where it reads records"
            source = self._sources[made.machine] = self._source(made.machine)
        return source

    def _note_run(self, made: records.RunMade, time: float) -> None:
        source = self._source_of(made)

        def executed() -> ReplayedRun:
            self.execute()
            return self._executed[made.run]

        run = self.runs[made.run] = RunHistory(self.number, time, made, source, snapshot(self.world), executed, origin=made.origin)
        if (task := self.tasks.get(made.task)) is None:
            return
        task.runs = [one for one in task.runs if not one.made.gives_way(made, has_begun=one.begun)]
        task.runs.append(run)
        if run.is_own:
            run.policy = task.policy
            if len(task.own_runs) > 1:
                before = task.own_runs[-2]
                left = (str(result.call.action) for result in before.last_results.values() if not result.is_done)
                run.replan = replan(decision_words(task.decision), left, (str(call.action) for call in source.plan.calls))
                run.is_decided, run.is_foreseen = task.decision is not None, isinstance(task.decision, Foreseen)
                before.follow(run.replan.why)
            task.decision = None

    def _note_results(self, run: RunHistory, results: Iterable[Became]) -> None:
        run.results, run.ended = {one.call: one.of(run.source.plan) for one in results}, self.time

    def _note_event(self, run: RunHistory, time: float, record: records.Happened) -> None:
        for delta in record.deltas:
            if delta.base == records.WORLD:
                records.change(self.world, delta)
        for told in record.told:
            match told:
                case Sent(request, index, number, arguments):
                    action = action_with(run.source.plan.calls[index].action, arguments)
                    self.attempts[request] = Attempt(run.id, index, run.id, action, number, self.number, self.time)
                    run.sent.setdefault(index, []).append(request)
                    run.requests += action.operation is None
                    run.follow(f"tried again, attempt {number}", index)
                case Hindered(step=number, cause=cause, is_failure=is_failure):  # a failure replaces the hindrance that led to it
                    step = sent_with(it, told.arguments) if isinstance(it := run.steps[number], ActionCall) else it
                    known = [(key, run.troubles[key]) for key in run.open] if is_failure else []
                    led = [(key, trouble) for key, trouble in known if trouble.step.index == step.index and not trouble.is_failure]
                    key, hindrance = led[-1] if led else (f"{self.number}.{self._observed}", None)
                    self._observed += 1
                    sent = len(run.sent.get(step.index, ()))
                    run.troubles[key] = Trouble(step, cause, self.number, self.time, sent, is_failure, hindrance)
                    run.open[key] = None
                case _:
                    assert_never(told)
        match record.event:
            case Begin():
                run.begun, run.origin = True, time if run.origin is None else run.origin
            case Accepted(id) if id in self.attempts:
                self.attempts[id] = self.attempts[id]._replace(accepted=self.time)
            case Feedback(id, text) if id in self.attempts:
                self.attempts[id] = self.attempts[id]._replace(feedback=text)
            case Ended(id, outcome) if id in self.attempts and self.attempts[id].ended is None:
                self.attempts[id] = self.attempts[id]._replace(ended=self.time, outcome=outcome)
            case _:
                pass
