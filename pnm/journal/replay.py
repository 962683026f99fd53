"""Replay of a journal: its runs are executed again, without any robot, from what had reached them.

Runs decide by events, knowledge and resources alone, so they do again what they did. What the journal says they did is compared: a
replay that would do something else is an error, for then its state is not the one that was.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, NoReturn, assert_never
from uuid import UUID

from pnm.clock import TimeUsed
from pnm.core.execution import events
from pnm.core.execution.call_data import GoalFields
from pnm.core.execution.call_results import Became, RunResult
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered, statement_text
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.requests import Accepted, Ended, Feedback, Postponed, Request
from pnm.core.resources import Hands, Resources
from pnm.errors import PnmError, counted
from pnm.journal import records
from pnm.tasks import REMEMBERED, TaskEnding

# --- ongoing --------------------------------------------------------------------------------------
# What goes on in a journal: the records that are said again where a segment begins, so that those before it are not needed.
#
# Of a run that is what it was made from, and how it stands now: its events are not said again.


class Ongoing:
    """The records of tasks that are not over, and of runs that go on. Everything is mutable state."""

    def __init__(self, segment: int = 0) -> None:
        self.segment = segment
        """The first record of the segment that goes on."""
        self._is_held = False
        """Whether an operator has paused all tasks."""
        self._hands: dict[str, tuple[float, records.HandPut]] = {}
        """What people have in their hands, with the times at which they took it."""
        self._recent: deque[tuple[records.Record, records.TaskOver]] = deque(maxlen=REMEMBERED)
        """The tasks that have ended last."""
        self._notes = count()
        self._said: dict[UUID, dict[object, tuple[float, Any]]] = {}
        """By task, what is to be said again, with the times at which it was said: the last of its kind, where that is enough."""
        self._since: dict[UUID, int] = {}
        """The first records of the segments in which tasks began."""
        self._task_of: dict[UUID, UUID] = {}
        """The tasks of runs."""
        self._left: dict[UUID, tuple[Became, ...]] = {}
        """The results of runs that are not carried on any more."""

    def in_another_world(self) -> Ongoing:
        """Return the same without anything that goes on."""
        other = Ongoing()
        other._is_held, other._hands, other._recent = self._is_held, self._hands, self._recent
        return other

    def __bool__(self) -> bool:
        return bool(self._said)

    @property
    def since(self) -> int:
        """The first record of the segment in which the oldest task began that goes on; of this one if none does."""
        return min(self._since.values(), default=self.segment)

    @property
    def runs(self) -> Mapping[UUID, UUID]:
        """The tasks of the runs that are said again, by run."""
        return self._task_of

    def note(self, time: float, record: records.Record, since: int | None = None) -> None:
        """Note a record of what goes on; `since` is the beginning of its task if that is not in this segment."""
        match record:
            case records.Happened():  # most are
                pass
            case records.TaskAccepted(wanted):
                self._keep(wanted.id, "accepted", time, record, since)
                self._keep(wanted.id, records.TaskHeld, time, records.TaskHeld(wanted.id, self._is_held), since)
            case records.RunMade(run, task) | records.RunStands(records.RunMade(run, task)):
                self._task_of[run] = task
                self._keep(task, run, time, record if isinstance(record, records.RunMade) else record.made, since)
                if isinstance(record, records.RunStands) and record.results is not None:
                    self._left[run] = record.results
            case records.RunSucceeded(run, _, results) | records.RunRetired(run, results) if run in self._task_of:
                self._left[run], said = results, self._said[task := self._task_of[run]]
                if said[run][1].caller is not None:  # the run that has called it knows what it has returned
                    del said[run], self._left[run], self._task_of[run]
                    said.pop((run, "time"), None)
                elif "accepted" not in said and all(one in self._left for one in said if isinstance(one, UUID)):
                    self.forget(task)
            case records.TaskNoted(task, note):
                self._keep(task, type(note) if getattr(note, "is_whole", False) else next(self._notes), time, record, since)
            case records.TaskHeld(None, is_held):
                self._is_held = is_held
            case records.HandPut(hand, is_taken):
                self._hands.pop(hand.name, None)
                if is_taken:
                    self._hands[hand.name] = time, record
            case records.TaskHeld(task) | records.TaskEntered(task) if task is not None:
                self._keep(task, type(record), time, record, since)
            case records.TimeCounted(of):
                self._keep(self._task_of.get(of, of), (of, "time"), time, record, since)
            case records.TaskOver(task) if task in self._said:
                self._recent.append((self._said[task]["accepted"][1], record))
                self.forget(task)
            case _:
                pass

    def again(
        self, now: float, bases: Mapping[int, KnowledgeBase], claims: records.ClaimsBegan, runs: Mapping[UUID, Run]
    ) -> Iterator[tuple[float, records.Record]]:
        """Yield the records that say what is so now, with their times: of what runs share, of tasks, and of runs as they stand."""
        for number, base in bases.items():  # the world first
            using = (run for run in runs.values() if base in (run.knowledge.world, run.knowledge.local))
            asked = min((run.asked_since[number != records.WORLD] for run in using), default=None)
            yield now, records.knowledge_now(number, base, asked)
            if number == records.WORLD and self._is_held:
                yield now, records.TaskHeld(None, is_held=True)
            if number == records.WORLD:
                yield from self._hands.values()
                yield from ((now, record) for ended in self._recent for record in ended)
        if claims.requests or claims.state["_held"] or claims.state["_line"]:
            yield now, claims
        for said in self._said.values():
            for time, record in said.values():
                if isinstance(record, records.RunMade):
                    record = records.RunStands(record, runs[record.run].values(), self._left.get(record.run))
                yield time, record

    def _keep(self, task: UUID, kind: object, time: float, record: records.Record, since: int | None) -> None:
        if task in self._said or isinstance(record, records.TaskAccepted | records.RunMade):
            self._since.setdefault(task, self.segment if since is None else since)
            self._said.setdefault(task, {})[kind] = time, record

    def forget(self, task: UUID) -> None:
        """Forget what was said of a task and its runs."""
        self._since.pop(task, None)
        for run in self._said.pop(task, {}):
            if isinstance(run, UUID):
                del self._task_of[run]
                self._left.pop(run, None)


# --- replay ---------------------------------------------------------------------------------------


class ReplayDiffers(PnmError):
    """A replay does something else than the journal says."""


@dataclass(frozen=True, slots=True)
class ReplayStep:
    """A record that was replayed, with the commands of its run, and what names the transitions of its machine."""

    number: int
    time: float
    record: records.Record
    transition_name: Callable[[int], str] = str
    commands: Sequence[events.Command] = ()

    @property
    def fired(self) -> tuple[str, ...]:
        """The transitions that fired, by name."""
        return tuple(map(self.transition_name, self.record.fired)) if isinstance(self.record, records.Happened) else ()


@dataclass
class ReplayedRun:
    """A run that was replayed. What it is connected to is exchanged when it goes on; everything else is as it was.

    When another run succeeds it, or it is retired, it has its result so far.
    """

    made: records.RunMade
    run: Run
    goal_fields: GoalFields
    replay: Replay = field(repr=False)
    result: RunResult | None = None
    is_over: bool = False
    used: TimeUsed | None = None
    """The used part of its limit, if it has one."""


@dataclass
class ReplayedTask:
    """A task as its records tell it, in their order."""

    accepted: records.TaskAccepted
    time: float
    """Its time."""
    replay: Replay = field(repr=False)
    is_held: bool = False
    runs: list[ReplayedRun] = field(default_factory=list)
    notes: list[object] = field(default_factory=list)
    ending: TaskEnding | None = None
    used: TimeUsed | None = None
    """The used part of its limit."""


@dataclass
class Replay:
    """Replays records, one after the other. Everything is mutable state."""

    source: Callable[[str], records.MachineSource] | None = None
    """Returns the source of the machine of a key."""
    shared: records.SharedBegan | None = None
    resources: Resources = field(default_factory=Resources)
    bases: dict[int, KnowledgeBase] = field(default_factory=dict)
    """Knowledge bases by their numbers."""
    runs: dict[UUID, ReplayedRun] = field(default_factory=dict)
    tasks: dict[UUID, ReplayedTask] = field(default_factory=dict)
    requests: dict[UUID, Request] = field(default_factory=dict)
    """All that were sent."""
    is_held: bool = False
    """Whether an operator has paused all tasks."""
    hands: Hands = field(default_factory=Hands)
    """What people have in their hands."""
    began: float = 0.0
    """The beginning of the world, on the clock of the event loop."""
    segment_began: float = 0.0
    """The beginning of the segment."""
    ongoing: Ongoing = field(default_factory=Ongoing)
    """What goes on, as it is said again where the next segment begins."""
    length: int = 0
    """The records of the segment."""
    now: float = 0.0
    """The time of the last record."""
    fields: dict[str, tuple[str, ...] | None] = field(default_factory=dict)
    """For actions by their text, the goal fields that their servers have."""
    _repetition: records.Repetition = field(default_factory=records.Repetition)
    _machines: dict[str, tuple[records.MachineSource, PetriNetMachine]] = field(default_factory=dict)
    """Machines and what they are made from, by key."""
    _machines_before: dict[str, tuple[records.MachineSource, PetriNetMachine]] = field(default_factory=dict)
    """Those of the segment before, which runs may go on with."""
    _deltas: list[records.KnowledgeDelta] | None = None
    """The changes by the run that handles an event."""

    @property
    def world(self) -> KnowledgeBase:
        """The knowledge that all runs share."""
        return self.bases[records.WORLD]

    @property
    def withheld(self) -> tuple[Request, ...]:
        """The requests that were given up, and whose servers have not confirmed their end."""
        return tuple(self.requests[request] for request in self.resources.given_up)

    @property
    def open_requests(self) -> frozenset[UUID]:
        """The requests that may be under way."""
        going_on = (replayed.run.open_requests for replayed in self.runs.values() if not replayed.is_over)
        return frozenset(self.resources.given_up).union(*going_on)

    @property
    def unfinished(self) -> tuple[ReplayedTask, ...]:
        """The tasks that have not ended."""
        return tuple(task for task in self.tasks.values() if task.ending is None)

    def forget(self) -> None:
        """Forget what was in segments before the one that has just begun."""
        self.runs, self.tasks, self.requests = {}, {}, {}
        self._machines, self._machines_before = {}, self._machines

    def apply(self, number: int, time: float, record: records.Record) -> ReplayStep:
        """Replay a record; raise `ReplayDiffers` if its run does something else than it did then."""
        self.now, self.length = max(self.now, time), self.length + 1
        is_again = self._repetition.has(record)
        self.ongoing.note(time, record, self.shared.since if self.shared and is_again else None)
        match record:
            case records.Happened():
                return self._happened(number, time, record)
            case records.TaskAccepted(wanted):
                made = [replayed for replayed in self.runs.values() if replayed.made.task == wanted.id]  # of a plan, before it is accepted
                self.tasks[wanted.id] = ReplayedTask(record, time, self, self.is_held, made)
            case records.TaskHeld(None, is_held):
                self.is_held = is_held
            case records.HandPut(hand, is_taken):
                self.hands.put(hand, is_taken=is_taken)
            case records.TaskHeld(task, is_held):
                if task in self.tasks:
                    self.tasks[task].is_held = is_held
            case records.TaskNoted(task, note):
                self.tasks[task].notes.append(note)
            case records.TaskOver(task, ending):
                self.tasks[task].ending = ending
            case records.SharedBegan(capacities, began=began):
                self.shared, self.resources, self.bases = record, Resources(capacities), {}
                self.began, self.segment_began, self.length = began, time, 1
                self.fields, self.ongoing, self.hands = {}, Ongoing(number), Hands()
                # what goes on is said again
                going_on = {task.accepted.wanted.id for task in self.unfinished}
                self.runs = {id: one for id, one in self.runs.items() if one.is_over and one.made.task not in going_on}
                self.tasks = {id: task for id, task in self.tasks.items() if id not in going_on}
            case records.KnowledgeBegan(base):
                self.bases[base] = records.base_of(record)
                records.follow(base, self.bases[base], self._note)
            case records.KnowledgeDelta(base):
                records.change(self.bases[base], record)
            case records.ClaimsBegan(state, requests):
                self.resources.restore(state)
                self.requests |= {request.id: request for request in requests}
            case records.RunMade():
                self._make(record)
            case records.RunStands(made, state, results):
                self._make(made, state)
                if results is not None:
                    self._end(number, self.runs[made.run], results)
            case records.RunSucceeded(run, successor, results):
                self._end(number, self.runs[run], results)
                self.runs[successor].run.take_the_place_of(self.runs[run].run, time)
            case records.RunRetired(run, results):
                self._end(number, self.runs[run], results)
                self.runs[run].run.retire()
            case records.TimeCounted(of, used):
                if (counted := self.runs.get(of) or self.tasks.get(of)) is not None:
                    counted.used = used
            case records.TaskEntered():  # for people: what it does follows from the rest
                pass
            case records.EndConfirmed(request):
                self.resources.confirm(request)
            case _:
                assert_never(record)
        return ReplayStep(number, time, record)

    def _happened(self, number: int, time: float, record: records.Happened) -> ReplayStep:
        replayed, self._deltas = self.runs[record.run], []
        run = replayed.run
        if record.fields:
            self.fields.update(record.fields)
        commands = run.handle(record.event, time)
        for command in commands:
            if isinstance(command, events.Send):
                self.requests[command.request.id] = command.request
        deltas, self._deltas, name = tuple(self._deltas), None, run.machine.placed.transition_name
        if run.fired != record.fired:
            _differ(number, "fires", *(tuple(map(name, fired)) for fired in (run.fired, record.fired)))
        if deltas != record.deltas:
            _differ(number, "changes", deltas, record.deltas)
        if (intents := records.intents_of(commands)) != record.intents:
            _differ(number, "intends", intents, record.intents)
        if run.told != record.told:
            _differ(number, "tells", run.told, record.told)
        return ReplayStep(number, time, record, name, commands)

    def _make(self, made: records.RunMade, kept: Mapping[str, Any] | None = None) -> None:
        assert self.source is not None, "a replay reads machines where it reads records"
        if (before := self._machines_before.get(made.machine)) is not None:
            self._machines[made.machine] = before
        if made.machine not in self._machines:
            source = self.source(made.machine)
            machine = generate(source.plan, source.bindings, on_failure=source.on_failure, capacities=source.capacities)
            self._machines[made.machine] = source, machine
        source, machine = self._machines[made.machine]
        run = Run(
            machine,
            Layered(self.world, self.bases[made.local]),
            id=made.run,
            bindings=source.bindings,
            goal_fields=lambda action: replayed.goal_fields(action),
            asks=made.asks,
            origin=made.origin,
            resources=self.resources,
            task=made.task,
            priority=made.priority,
            adopted=made.adopted,
            tells=True,
            kept=kept,
        )
        replayed = ReplayedRun(made, run, lambda action: self.fields.get(str(action)) if self.fields else None, self)
        self.runs[made.run] = replayed
        if made.task in self.tasks:
            task = self.tasks[made.task]
            task.runs = [one for one in task.runs if not one.made.gives_way(made, has_begun=one.run.begun)]
            task.runs.append(replayed)

    def _end(self, number: int, replayed: ReplayedRun, results: tuple[Became, ...]) -> None:
        replayed.is_over, replayed.result = True, replayed.run.result_so_far()
        if (here := records.became(replayed.result, replayed.run.machine.plan)) != results:
            _differ(number, "ends with", here, results)

    def _note(self, delta: records.KnowledgeDelta) -> None:
        if self._deltas is not None:
            self._deltas.append(delta)


def _differ(number: int, verb: str, here: tuple[object, ...], then: tuple[object, ...]) -> NoReturn:
    different = next((pair for pair in zip(here, then, strict=False) if pair[0] != pair[1]), (here[len(then) :], then[len(here) :]))
    raise ReplayDiffers(f"record {number}: the replay {verb} {different[0]!r}, the journal says {different[1]!r}")


# --- records in words, for people ----------------------------------------------------------


def words(step: ReplayStep, replay: Replay) -> tuple[str, ...]:
    """Return the words for a record, a line for each consequence; `replay` has replayed it just now."""
    record = step.record
    match record:
        case records.SharedBegan():
            return ("the world begins",)
        case records.KnowledgeBegan(base, facts, variables):
            return (f"knowledge of {_base(base)}: {len(facts)} facts, {len(variables)} variables",)
        case records.KnowledgeDelta():
            return (f"reported {delta_text(record)}",)
        case records.RunMade(_, _, name):
            run = replay.runs[record.run].run
            return (f"a machine for {name}: {counted(len(run.machine.plan.calls), 'call')}, {run.machine.placed.count_places} places",)
        case records.ClaimsBegan(requests=requests):
            return (f"requests that may have resources: {', '.join(str(request.action) for request in requests) or 'none'}",)
        case records.RunStands(made):
            return (f"the run {made.run.hex[:8]} of {made.name} {'goes on' if record.results is None else 'has ended'}",)
        case records.Happened(run_id, event):
            written = (f"  writes {delta_text(delta)}" for delta in record.deltas if delta.facts or delta.variables)
            sent = (f"  sends {command.request.action}" for command in step.commands if isinstance(command, events.Send))
            return (event_text(event, replay), *(f"  fires {name}" for name in step.fired), *written, *sent)
        case records.RunSucceeded(run_id, successor):
            return (f"the run {run_id.hex[:8]} is succeeded by {successor.hex[:8]}",)
        case records.RunRetired(run_id):
            return (f"the run {run_id.hex[:8]} has ended",)
        case records.EndConfirmed(request):
            return (f"{request.hex[:8]} has ended at last: its resources are free",)
        case records.TaskAccepted(wanted):
            return (f"accepted {wanted.words}",)
        case records.TaskHeld(task, is_held):
            return (f"{'paused' if is_held else 'resumed'} {'all' if task is None else task.hex[:8]}",)
        case records.HandPut(hand, is_taken):
            return (str(hand) if is_taken else f"{hand.name} is given back",)
        case records.TaskEntered(task, state, reason):
            return (f"{task.hex[:8]} is {state.word}{f': {reason}' if reason else ''}",)
        case records.TaskNoted(_, note):
            return (str(note) if type(note).__str__ is not object.__str__ else f"noted {type(note).__name__}",)
        case records.TimeCounted(of, used):
            return (
                f"the time of {of.hex[:8]} {'stops' if used.since is None else 'counts'}: {used.used:.2f} s of {used.limit:g} s are used",
            )
        case records.TaskOver(_, ending):
            return (f"over: {ending.code.word}: {ending.message}",)
        case _:
            assert_never(record)


def event_text(event: events.Event, replay: Replay) -> str:
    """Return an event in words; requests by the calls that they belong to."""
    match event:
        case events.Begin():
            return "begin"
        case events.Restarted():
            return "go on in another process"
        case events.KnowledgeChanged():
            return "facts have changed"
        case events.ResourcesChanged():
            return "resources have changed"
        case events.Tick():
            return "a time has come"
        case events.Stop(cancel, reason):
            return f"stop{', cancelling what runs' if cancel else ''}: {reason}"
        case events.Pause(at_once):
            return f"pause{' at once' if at_once else ''}"
        case events.Resume():
            return "resume"
        case events.InHands(names):
            return f"in people's hands: {', '.join(names) or 'nothing'}"
        case events.SingleStep():
            return "step: one call may begin"
        case events.Settled(request, kind):
            return f"a person says how {_name(request, replay)} ends: {kind.value}"
        case events.Answered(_, value, message):
            return f"answer {message or repr(value)}"
        case Accepted(request):
            return f"accepted {_name(request, replay)}"
        case Postponed(request):
            return f"postponed {_name(request, replay)}"
        case Feedback(request, text):
            return f"feedback {_name(request, replay)}: {text}"
        case Ended(request, outcome):
            message = f": {outcome.message}" if outcome.message else ""
            return f"ended {_name(request, replay)}: {outcome.kind.value}{message}"
        case _:
            assert_never(event)


def delta_text(delta: records.KnowledgeDelta) -> str:
    """Return changes of knowledge in words."""
    facts = [statement_text(fluent, value) for fluent, value in delta.facts.items()]
    variables = [f"{name} = {value!r}" for name, value in delta.variables.items()]
    return f"{', '.join((*facts, *variables, *delta.unknown)) or 'nothing'}{f' for {_base(delta.base)}' if delta.base else ''}"


def _base(number: int) -> str:
    return f"run {number}" if number else "the world"


def _name(request: UUID, replay: Replay) -> str:
    return str(replay.requests[request].action) if request in replay.requests else request.hex[:8]
