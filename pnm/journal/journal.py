"""The journal of runs, as they use it; `Journal` keeps nothing, `WrittenJournal` writes a file or a database."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from time import time
from typing import Final, NotRequired, TypeAlias, TypedDict, Unpack
from uuid import UUID

from pnm.clock import TimeUsed
from pnm.core.execution.call_data import GoalFields
from pnm.core.execution.events import Cancel, Command, Event, Observer, Send, Wake
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Request
from pnm.core.resources import Hand, Resources
from pnm.journal import records
from pnm.journal.codec import Codec, Undecodable
from pnm.journal.kept import DAY, KEPT, LISTED, UNSHARED, Fenced, Hold, JournalError, Row, StandBys, TaskRow, log_end
from pnm.journal.records import SharedBegan
from pnm.journal.replay import Replay, ReplayedRun
from pnm.journal.store import JournalFile
from pnm.tasks import TaskEnding, TaskState, Wanted

Perform: TypeAlias = Callable[[Sequence[Command]], None]
"""Carries out commands."""


class RunOptions(TypedDict):
    """The options of a `Run` that is made by a journal, as its constructor has them."""

    id: UUID
    bindings: Bindings
    goal_fields: GoalFields
    asks: NotRequired[bool]
    observer: NotRequired[Observer | None]
    origin: NotRequired[float | None]
    resources: NotRequired[Resources | None]
    task: NotRequired[UUID | None]
    priority: NotRequired[int]
    adopted: NotRequired[Mapping[int, UnderWay]]
    tells: NotRequired[bool]


class Journal:
    """The journal of runs, in which nothing is kept."""

    blocked: str = ""
    """Why nothing can be kept at present; empty if it can."""
    _hold: Hold = UNSHARED
    _is_lost = False
    """Whether another process has the journal."""

    def begin(
        self, knowledge: KnowledgeBase, resources: Resources, anew: Callable[[], None] = lambda: None, began: SharedBegan | None = None
    ) -> None:
        """Record what runs share: the knowledge as `anew` leaves it, what changes in it from then on, and `began`, which is now."""
        anew()

    def may_act(self) -> bool:
        """Return whether something may leave this process; asked by any thread, right before that."""
        return not self._is_lost and self._hold.is_mine()

    def stand_bys(self) -> StandBys:
        """Return the processes that stand by to go on with it, as far as they can be seen."""
        return self._hold.stand_bys()

    def make_run(
        self, machine: PetriNetMachine, knowledge: Layered, *, name: str = "", caller: UUID | None = None, **options: Unpack[RunOptions]
    ) -> Run:
        """Return a run that is recorded; `name` is that of its task, for people, `caller` the request of the plan that has called it."""
        return Run(machine, knowledge, **options)

    def handle(self, run: Run, event: Event, now: float, perform: Perform) -> None:
        """Have the run handle an event; perform the commands once the event and they are kept."""
        perform(run.handle(event, now))

    def go_on(self, replayed: ReplayedRun, observer: Observer | None, goal_fields: GoalFields) -> Run:
        """Return a run that was replayed, connected to what it is to go on with."""
        replayed.run.observer = observer or Observer()
        replayed.goal_fields = goal_fields
        return replayed.run

    def succeeded(self, run: Run, successor: Run) -> None:
        """Record that a run has taken the place of another."""
        self._record(records.RunSucceeded(run.id, successor.id, records.became(run.result_so_far(), run.machine.plan)))

    def retired(self, run: Run) -> None:
        """Record that a run is not carried on."""
        self._record(records.RunRetired(run.id, records.became(run.result_so_far(), run.machine.plan)))

    def confirmed(self, request: UUID, resources: Resources) -> None:
        """Record that the server of a request that was given up has confirmed its end, and free what it has kept."""
        self._record(records.EndConfirmed(request))
        resources.confirm(request)

    def _record(self, record: records.Record) -> None:
        """Keep a record."""

    # --- tasks ----------------------------------------------------------------------------------

    def accepted(self, wanted: Wanted, order: int) -> None:
        """Keep a task that is about to be accepted; raise `JournalError` if it cannot be kept."""

    def held(self, task: UUID | None, *, is_held: bool) -> None:
        """Record that an operator has paused a task, or those that are still to come, or has let them go on."""
        self._record(records.TaskHeld(task, is_held))

    def put(self, hand: Hand, *, is_taken: bool) -> None:
        """Keep that a person has taken something in hand, or has given it back."""
        self._record(records.HandPut(hand, is_taken))

    def entered(self, task: UUID, state: TaskState, reason: str) -> None:
        """Record that a task is in another state; how it ends is recorded by `over`."""
        self._record(records.TaskEntered(task, state, reason))

    def noted(self, task: UUID, note: object) -> None:
        """Record what a task needs to know when it goes on in another process."""
        self._record(records.TaskNoted(task, note))

    def counted(self, of: UUID, used: TimeUsed) -> None:
        """Record how much of its limit a task has used, or a run of a plan."""
        if isfinite(used.limit):
            self._record(records.TimeCounted(of, used))

    def over(self, task: UUID, ending: TaskEnding, then: Callable[[], None] = lambda: None) -> None:
        """Keep how a task has ended, and do something then."""
        then()


NO_JOURNAL: Final = Journal()


# --- a journal that is written ahead -------------------------------------------------------
# The write-ahead journal of runs: an event, and what follows from it, is kept before anything is done about it.
#
# When it cannot be written, as on a full disk, nothing new is sent: requests wait until the records before them are kept, which is tried
# again and again. What ends work, cancelling and timers, does not wait.


_RETRY: Final = 1.0
"""Seconds until it is tried again to write."""
_OFTEN: Final = 1 / 7
"""The part of the time for which records are kept after which it is looked what is old, at least once a day."""
_LONG: Final = 1000
"""Records of a segment after which another one begins as soon as nothing is under way."""
_LONGER: Final = 100
"""Records after which another one begins while tasks go on."""
_SHARE: Final = 4
"""How much longer a segment is then than what it began with, and what the next one begins with, of which a call is a record at most: what
is said again is a part of what is written."""

_log = logging.getLogger(__name__)


class WrittenJournal(Journal):
    """The journal of runs that is kept in a file, or in PostgreSQL.

    Args:
        file: where records are kept.
        codec: writes them.
        replay: of what is in the file already, if what it has brought about goes on.
        hold: the right to write it; without it, only timers are set.
        fenced: called when another process has taken the journal over. Nothing is done any more then.
        kept: seconds for which records are kept that nothing under way needs.
        wall: returns the time of day in seconds; the clock of the computer if None.

    The mutable state is what the constructor sets under "state".
    """

    def __init__(
        self,
        file: JournalFile,
        codec: Codec,
        replay: Replay | None = None,
        kept: float = KEPT,
        hold: Hold = UNSHARED,
        fenced: Callable[[Fenced], None] = log_end,
        wall: Callable[[], float] | None = None,
    ) -> None:
        self._file = file
        self._codec = codec
        self._kept = kept
        self._period = min(DAY, kept * _OFTEN)
        self._hold = hold
        self._fenced = fenced
        self._wall = wall or (lambda: time())
        self._loop = asyncio.get_running_loop()
        told = replay or Replay()
        # state
        self._rows: list[Row] = []
        """Records that are not kept yet."""
        self._parts: dict[str, str | None] = {}
        self._known_parts: set[str] = set()
        self._waiting: deque[tuple[Perform, tuple[Command, ...]]] = deque()
        """Everybody who waits for these records to be kept."""
        self._bases = dict(told.bases)
        """The knowledge bases that are followed, by number."""
        self._numbers = max(told.bases, default=records.WORLD)
        """The last number of a knowledge base; none is used twice."""
        self._fields = told.fields
        self._news: dict[str, tuple[str, ...] | None] = {}
        """Goal fields that the event being handled has found out."""
        self._handling = False
        self._deltas: list[records.KnowledgeDelta] = []
        self._is_replaced = False
        """Whether another world takes the place of the one that is followed."""
        self._due: asyncio.Handle | None = None
        """The writer of the next moment, or of the next attempt."""
        self.blocked = ""
        self._is_astray = False
        """Whether its file was not found when nothing was to be written."""
        self._is_lost = False
        self._is_closed = False
        self._resources, self._shared = told.resources, told.shared
        self._segment_began, self._length = told.segment_began, told.length
        """The beginning of the segment, and its records."""
        self._segment_wall = file.segment_wall
        """The time of day when it has."""
        self._fresh = 1 + told.shared.again if told.shared else 0
        """The records with which it has begun."""
        self._dropped = -inf
        """The time of day when old records were dropped."""
        self._ongoing = told.ongoing
        self._live = {id: replayed.run for id, replayed in told.runs.items()}
        """The runs that are said again."""
        self._requests = dict(told.requests)
        """What was sent, as far as it may be under way."""
        self._is_looked_at = False
        """Whether it is about to be looked whether a segment begins."""
        self._next_look = self._fresh + _LONGER
        """The records of the segment after which it is looked."""
        self._written = 0
        """The characters of the segment."""
        self._beginning = 0
        """Those of its beginning."""
        self._unfinished = {task.accepted.wanted.id: (task.accepted, task.time) for task in told.unfinished}
        """The tasks that are not over, with the times when they were accepted."""
        self._runs = Counter({id: sum(one.run.begun and one.made.caller is None for one in task.runs) for id, task in told.tasks.items()})
        """The machines that each task has had, one after the other."""
        self._number_of = {id(base): number for number, base in self._bases.items()}
        for number, base in self._bases.items():
            records.follow(number, base, self._changed)
        hold.keep(self._look, self._lose)

    def begin(
        self, knowledge: KnowledgeBase, resources: Resources, anew: Callable[[], None] = lambda: None, began: SharedBegan | None = None
    ) -> None:
        """Record what runs share: the knowledge as `anew` leaves it, what changes in it from then on, and `began`, which is now."""
        self._is_replaced = True
        anew()
        self._is_replaced = False
        self._resources, self._ongoing = resources, self._ongoing.in_another_world()
        self._shared = replace(began or SharedBegan(resources.capacities), began=self._loop.time())
        self._begin_segment(knowledge, self._shared)

    def make_run(
        self, machine: PetriNetMachine, knowledge: Layered, *, name: str = "", caller: UUID | None = None, **options: Unpack[RunOptions]
    ) -> Run:
        """Return a run, and record what it was made from."""
        asks, adopted = options.get("asks", False), options.get("adopted", {})
        options["goal_fields"], options["tells"] = self._remembering(options["goal_fields"]), True
        run = self._live[options["id"]] = super().make_run(machine, knowledge, **options)
        text = self._codec.text(records.MachineSource(machine.plan, options["bindings"], machine.on_failure, machine.capacities))
        source = hashlib.sha256(text.encode()).hexdigest()
        if source not in self._known_parts:  # several records may name it
            self._known_parts.add(source)
            self._parts[source] = text
        if (local := self._number_of.get(id(knowledge.local))) is None:
            local = self._numbers = self._numbers + 1
            self._number_of[id(knowledge.local)], self._bases[local] = local, knowledge.local  # kept: its identity is not used again
            self._record(records.follow(local, knowledge.local, self._changed))
        self._runs[run.task] += caller is None
        priority, origin = options.get("priority", 0), options.get("origin")
        accepted, _ = self._unfinished.get(run.task, (None, 0.0))
        row = self._task_row(records.TaskSummary(accepted, self._runs[run.task])) if accepted and caller is None else None
        self._record(records.RunMade(run.id, run.task, name, source, local, caller, priority, origin, asks, adopted), task=row)
        return run

    def handle(self, run: Run, event: Event, now: float, perform: Perform) -> None:
        """Have the run handle an event, and keep both; perform the commands then."""
        self._handling = True
        try:
            commands = run.handle(event, now)
        finally:
            self._handling = False
        deltas, news, self._deltas, self._news = self._deltas, self._news, [], {}
        self._record(records.Happened(run.id, event, news, run.fired, tuple(deltas), records.intents_of(commands), run.told), now)
        self._waiting.append((perform, tuple(commands)))
        sent = (command.request for command in commands if isinstance(command, Send))
        self._requests |= {request.id: Request(request.id, request.action, {}) for request in sent}
        # What is only heard, and leads to nothing outside, is committed with what comes next, or a moment later: if it were lost
        # before that, it would be heard again, as if it had come after the death of this process.
        leads_outside = any(type(command) is not Wake for command in commands)
        if leads_outside or run.over or self.blocked or not isinstance(event, records.HEARD):
            self._write()

    def go_on(self, replayed: ReplayedRun, observer: Observer | None, goal_fields: GoalFields) -> Run:
        """Return a run that was replayed, connected to what it is to go on with."""
        return super().go_on(replayed, observer, self._remembering(goal_fields))

    def accepted(self, wanted: Wanted, order: int) -> None:
        """Keep a task that is about to be accepted; raise `JournalError` if it cannot be kept."""
        task = records.TaskAccepted(wanted, order, self._wall())
        self._record(task, task=self._task_row(records.TaskSummary(task, self._runs[wanted.id])))
        self._write(looks=True)
        if self.blocked:
            del self._rows[-1]  # it is refused, and must not come up when the journal can be written again
            self._ongoing.forget(wanted.id)
            raise JournalError(self.blocked)
        self._unfinished[wanted.id] = task, self._loop.time()

    def put(self, hand: Hand, *, is_taken: bool) -> None:
        """Keep that a person has taken something in hand, or has given it back: before anybody hears of it, if it can be written."""
        super().put(hand, is_taken=is_taken)
        self._write()

    def over(self, task: UUID, ending: TaskEnding, then: Callable[[], None] = lambda: None) -> None:
        """Keep how a task has ended, and do something then. A segment begins if this one is long."""
        accepted, began = self._unfinished.pop(task)
        summary = records.TaskSummary(accepted, self._runs.pop(task, 0), ending, self._wall(), self._loop.time() - began)
        self._record(records.TaskOver(task, ending), task=self._task_row(summary))
        if self._is_lost:  # another process keeps it
            then()
            return
        self._waiting.append((lambda _: then(), ()))
        self._write()
        self._begin_segment_if_due()

    def close(self) -> None:
        """Write what is not kept yet, and close the file."""
        self._write()
        if self._due is not None:
            self._due.cancel()
        self._is_closed = True
        self._hold.release()
        self._file.close()

    def _begin_segment(self, world: KnowledgeBase, shared: SharedBegan) -> None:
        """Begin a segment, with all that is to be known without those before it; and drop what is old."""
        if self._bases.get(records.WORLD) is not world:
            records.follow(records.WORLD, world, self._changed)
        ongoing, now, wall = self._ongoing, self._loop.time(), self._wall()
        self._live = {id: run for id, run in self._live.items() if id in ongoing.runs}
        locals = {id(run.knowledge.local) for run in self._live.values()}
        self._bases = {records.WORLD: world} | {number: base for number, base in self._bases.items() if id(base) in locals}
        self._number_of = {id(base): number for number, base in self._bases.items()}
        open_requests = {request for run in self._live.values() for request in run.open_requests}.union(self._resources.given_up)
        self._requests = {id: request for id, request in self._requests.items() if id in open_requests}
        claims = records.ClaimsBegan(self._resources.values(), tuple(self._requests.values()))
        again = [*ongoing.again(now, self._bases, claims, self._live)]
        texts = [(said, self._codec.text(record)) for said, record in again]  # before anything is begun: it may have no text
        self._fields.clear()
        self._known_parts = {record.made.machine for _, record in again if isinstance(record, records.RunStands)}
        self._parts |= dict.fromkeys(self._known_parts)  # which are kept already
        self._runs = Counter({task: self._runs[task] for task in self._unfinished})
        self._segment_began, self._segment_wall, self._length, self._written = now, wall, 0, 0
        began = replace(shared, again=len(texts), since=ongoing.since if ongoing else 0)
        self._keep(now, self._codec.text(began), begins=wall)
        for said, text in texts:
            self._keep(said, text)
        self._fresh, self._beginning, self._next_look = self._length, self._written, self._length + _LONGER
        self._write()
        ongoing.segment = self._file.segment
        self._drop_if_due()

    def _begin_segment_if_due(self) -> None:
        """Begin a segment if this one is long, the longer the more goes on; or has records that are old enough to be dropped some day."""
        self._is_looked_at = False
        if not self._shared or self._handling or self.blocked or self._is_lost or self._is_closed:
            return
        goes_on, length = bool(self._unfinished or self._resources.held or self._ongoing), self._length - self._fresh
        age = max(self._loop.time() - self._segment_began, self._wall() - self._segment_wall)
        is_long = length >= _LONGER and self._written > (1 + _SHARE) * self._beginning if goes_on else self._length >= _LONG
        if goes_on and is_long:
            is_long = length >= _SHARE * sum(len(run.machine.plan.calls) for id, run in self._live.items() if id in self._ongoing.runs)
        if not (is_long or (age >= self._period and length > 0)):
            self._next_look = self._length + _LONGER // 4
            return
        self._write()  # what has happened is behind this segment
        if self.blocked or self._waiting or self._is_lost:
            return
        try:
            self._begin_segment(self._bases[records.WORLD], self._shared)
        except Undecodable as error:  # of the goal of a request, which is kept nowhere else
            _log.warning("no segment of the journal begins while this goes on: %s", error)
            self._fresh, self._next_look = self._length, self._length + _LONGER

    def _drop_if_due(self) -> None:
        """Drop what is old, unless it was looked for a short while ago."""
        if self._dropped <= self._wall() < self._dropped + self._period:
            return
        self._dropped = self._wall()
        try:
            self._file.drop(self._dropped - self._kept, self._dropped - LISTED * self._kept)
        except JournalError as error:
            _log.warning("old records are not dropped: %s", error)

    def _look(self) -> None:
        """Write what is not kept yet, see that what is kept can be found, and drop what is old, also while there is nothing to do."""
        self._write(looks=True)
        if self._is_lost or self.blocked:
            return
        self._begin_segment_if_due()
        self._drop_if_due()

    def _task_row(self, summary: records.TaskSummary) -> TaskRow:
        accepted, ended = summary.accepted, summary.ended
        wall = accepted.wall if ended is None else ended
        return TaskRow(accepted.wanted.id.hex, wall, ended is not None, self._codec.text(summary))

    # --- knowledge ------------------------------------------------------------------------------

    def _changed(self, delta: records.KnowledgeDelta) -> None:
        if delta.base not in self._bases or self._is_replaced:
            return  # of a run that has ended in an earlier segment, or no change of the world that is followed
        if self._handling:
            self._deltas.append(delta)
        else:
            self._record(delta)

    def _remembering(self, goal_fields: GoalFields) -> GoalFields:
        """Return goal fields that are noted when they are news: a replay cannot ask servers."""

        def remember(action: GroundAction) -> tuple[str, ...] | None:
            known, fields = str(action), goal_fields(action)
            if known not in self._fields or self._fields[known] != fields:
                self._fields[known] = self._news[known] = fields
            return fields

        return remember

    # --- writing ----------------------------------------------------------------------------------

    def _record(self, record: records.Record, now: float | None = None, task: TaskRow | None = None) -> None:
        """Note a record; it is written with the next event, or a moment later. What is heard after the end is another process's to keep."""
        is_late = isinstance(record, records.TaskEntered | records.TaskNoted) and record.task not in self._unfinished
        if self._is_closed or is_late:
            return
        now = self._loop.time() if now is None else now
        self._keep(now, self._codec.text(record), task=task)
        self._ongoing.note(now, record)
        if self._length >= self._next_look and not self._is_looked_at:
            self._is_looked_at = True
            self._loop.call_soon(self._begin_segment_if_due)  # between two events of all runs

    def _keep(self, now: float, text: str, begins: float | None = None, task: TaskRow | None = None) -> None:
        self._rows.append(Row(now, text, begins, task))
        self._length += 1
        self._written += len(text)
        if self._due is None:
            self._due = self._loop.call_soon(self._write)

    def _write(self, *, looks: bool = False) -> None:
        """Keep what was recorded, and do what has waited for that; if it `looks`, the file must first be where others find it."""
        if self._due is not None:
            self._due.cancel()
            self._due = None
        if self._is_lost:
            return
        try:
            if looks or self.blocked:
                self._file.look()
            if self._rows:
                self._file.append(self._rows, self._parts)
        except Fenced as error:
            self._lose(error)
            return
        except JournalError as error:
            self._is_astray = self._is_astray or not self._rows
            self._block(str(error))
            return
        if self.blocked and (self._rows or self._is_astray):
            _log.warning("the journal can be written again")
            self.blocked, self._is_astray = "", False
        self._rows, self._parts = [], {}
        while self._waiting and self._hold.is_mine():  # otherwise when it has been renewed
            perform, commands = self._waiting.popleft()
            perform(commands)

    def _lose(self, why: Fenced) -> None:
        """Do nothing any more: another process goes on with everything, and watches what runs."""
        if not self._is_lost:
            self._is_lost, self.blocked = True, str(why)
            self._waiting.clear()
            self._fenced(why)

    def _block(self, why: str) -> None:
        """Let requests wait; what only ends work, or tells the time, is done at once."""
        if not self.blocked:
            _log.error("%s; nothing new is sent until it can", why)
        self.blocked = why
        held = {command.request.id for _, commands in self._waiting for command in commands if isinstance(command, Send)}
        for position, (perform, commands) in enumerate(self._waiting):
            at_once = tuple(
                command
                for command in commands
                if isinstance(command, Wake) or (isinstance(command, Cancel) and command.request not in held and self._hold.is_mine())
            )
            self._waiting[position] = perform, tuple(command for command in commands if command not in at_once)
            if at_once:
                perform(at_once)
        if self._due is None:
            self._due = self._loop.call_later(_RETRY, self._write)
