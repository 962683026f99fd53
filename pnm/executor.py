"""The executor of a run: passes events from clients, clock and knowledge to the run, and carries out the commands it returns."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import assert_never
from uuid import UUID

from pnm.clock import collect_if_due, stop_then_cancel
from pnm.core.execution import events
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.logic.computed_values import MISSING, Question
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.bindings import WhenLost
from pnm.core.machine.requests import (
    NOT_REATTACHED,
    ActionClient,
    Ended,
    Outcome,
    OutcomeKind,
    ReattachingClient,
    Report,
    Request,
    TransitionAction,
)
from pnm.core.resources import Hands
from pnm.errors import RunError
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.knowledge.people import HelpAsked, HelpEnded, note_nothing, was_carried_out
from pnm.knowledge.source import Asker, Source, SourceError

_log = logging.getLogger(__name__)


@dataclass(eq=False, repr=False)
class Executor:
    """The executor of one run, with the client that carries out its actions, on one asyncio loop.

    The mutable state is the run, which another may succeed; the inbox of events, and which changes wait in it; the timer; the
    subscriptions to knowledge and resources; the open queries and updates of the source; and which requests people have settled.
    """

    run: Run
    client: ActionClient
    source: Source | None = None
    """It answers queries and takes updates of what the run does not know itself."""
    name: str = ""
    """The name of the run, for people who are asked."""
    journal: Journal = NO_JOURNAL
    """It keeps what happens before anything is done about it; the run was made by it."""
    note: Callable[[HelpAsked | HelpEnded], None] = note_nothing
    """It is told what a person is asked about a request that was lost, and what has come of it."""
    called: Callable[[UUID], Executor | None] = lambda _: None
    """It returns the executor of the run that a request has begun here; None if a server carries the request out."""
    hands: Hands = field(default_factory=Hands)
    """What people have in their hands: nothing is sent to that."""
    ended: bool = field(default=False, init=False)
    """Whether the run was carried out, and is not any more."""

    def __post_init__(self) -> None:
        self._asker = Asker(self.run.id, self.name, task=self.run.task)
        self._source_tasks: dict[UUID, asyncio.Task[None]] = {}
        self._inbox: asyncio.Queue[events.Event] = asyncio.Queue()
        if self.run.begun:  # in another process; before anything else, such as a stop, which could cancel no request that is not attached
            self._inbox.put_nowait(events.Restarted())
        self._timer: asyncio.TimerHandle | None = None
        self._leaving: list[Callable[[], None]] = []
        self._hearing: list[Callable[[], None]] = []
        """What stops it from hearing of changes of knowledge; empty if it hears of none."""
        self._waiting: set[events.KnowledgeChanged | events.ResourcesChanged] = set()
        self._progress: asyncio.Event | None = None
        """The events for those who wait until something has happened."""

    def stop(self, *, cancel: bool = True, reason: str = "cancelled") -> None:
        """End the run: start nothing more; cancel what runs, or wait for it."""
        # Through the inbox like everything else: observers may call this while the run handles an event.
        self._inbox.put_nowait(events.Stop(cancel, reason))

    def pause(self, *, at_once: bool = False) -> None:
        """Start nothing more for now; let what runs come to its end, or cancel it, to begin it anew later."""
        self._inbox.put_nowait(events.Pause(at_once))

    def resume(self) -> None:
        """Go on after a pause."""
        self._inbox.put_nowait(events.Resume())

    def step(self) -> bool:
        """Let one request leave during a pause; return whether one has. Not to be called by observers."""
        # At once and not through the inbox: what decides that it may leave does so by what is so now.
        self._handle(events.SingleStep())
        rule = self.run.machine.placed.rule
        return any(rule(fired).action is TransitionAction.SEND for fired in self.run.fired)

    def settle(self, request: UUID, kind: OutcomeKind) -> None:
        """Have a request that is under way end in this way, because a person says so, as soon as its server is done with it."""
        self._inbox.put_nowait(events.Settled(request, kind))

    def heed_hands(self) -> None:
        """Have the run know at once what people have in their hands. Not to be called by observers."""
        if self.run.hands != self.hands.names and not self.ended:
            self._handle(events.InHands(self.hands.names))

    @property
    def needs_from_people(self) -> list[str]:
        """What calls wait for that people have in their hands, in words."""
        return [str(self.hands.taken[name]) for name in self.run.needs_from_people if name in self.hands.taken]

    @property
    def paused(self) -> bool:
        """Whether the run is to pause, nothing is under way, and no queued event can begin anything."""
        return self.run.paused and self._inbox.empty()

    @property
    def awaits(self) -> bool:
        """Whether something has come that the run has not handled, or is to come that may move it."""
        return self.run.awaits or bool(self._source_tasks) or not self._inbox.empty()

    @property
    def running(self) -> tuple[tuple[str, str], ...]:
        """The calls that are under way, with what their servers have said last; those in a run that a call has begun, behind its name."""
        calls, feedback = list[tuple[str, str]](), self.run.feedback
        for request, call in self.run.open_calls.items():
            called, name = self.called(request), str(call.action)
            inside = called.running if called else ()
            calls += [(f"{name}: {inner}", said) for inner, said in inside] or [(name, feedback[request])]
        return tuple(calls)

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered, neither here nor in runs that calls have begun."""
        called = [self.called(request) for request in self.run.open_requests]
        return self.run.awaits_answers or (bool(called) and all(one is not None and one.awaits_answers for one in called))

    def succeed(self, run: Run) -> None:
        """Go on with another run in the place of this one, at once. Not to be called by observers.

        Reports about requests that it takes over reach it, those included that have come but not been handled yet; and so do
        answers of people to what it would ask them as well. Raises `RunError` if this run is not being carried out, or is to stop;
        or if something of it is under way that the other does not take over.
        """
        # Before `Begin` is handled the old run has sent nothing that could be taken over, and after the end nothing is listened to.
        if not self._leaving or not self.run.begun:
            raise RunError("the run that is to be succeeded is not being carried out")
        self.run.check_successor(run)  # before anything changes: a refusal leaves the old run going on
        # From here on reports that wait in the inbox are handled by the new run; they name the request, not the run.
        old, self.run = self.run, run
        self.journal.succeeded(old, run)
        self._asker = replace(self._asker, run=run.id)
        self._leave({*run.take_the_place_of(old, asyncio.get_running_loop().time()), *run.open_requests})
        self._enter()
        # At once and not through the inbox: events that wait there concern requests that it must have adopted by then.
        self._handle(events.Begin())
        self._inbox.put_nowait(events.Tick())  # so that `paused` is looked at again once the inbox is empty

    @property
    def is_settled(self) -> bool:
        """Whether all that is under way can be handed over now."""
        # A request that is out but not accepted, or that is being cancelled, cannot be handed over yet.
        return len(self.run.open_requests) == len(self.run.under_way()) and not self.run.settling

    async def at_rest(self) -> bool:
        """Wait during a pause until all that is under way can be handed over. Return whether it can.

        It cannot once the run has ended, nor while a call that has ended waits for others, which the pause keeps from beginning.
        """
        while not self.ended:
            if self.is_settled:
                return True
            if self.paused and not self.run.looks_for_effects:
                return False
            await self.happens()
        return False

    async def happens(self) -> None:
        """Wait until something has happened to the run, or it is not carried out any more."""
        self._progress = self._progress or asyncio.Event()
        await self._progress.wait()

    async def execute(self) -> RunResult:
        """Run to the end and return how it ended; the run's own limits bound the time. The end is that of the last run.

        Cancelling the task stops the run: what its actions are doing is cancelled and waited for. Cancelling it again leaves them alone.
        """
        return await stop_then_cancel(self._carry_out(), self.stop)

    async def _carry_out(self) -> RunResult:
        self._enter()
        if self.run.hands != self.hands.names:
            self._inbox.put_nowait(events.InHands(self.hands.names))
        if not self.run.begun:
            self._inbox.put_nowait(events.Begin())
        try:
            moment, together = 0.0, 0
            while not self.run.over:
                if self._inbox.empty():
                    collect_if_due()
                event = await self._inbox.get()
                if not together:  # what has come meanwhile is of one moment: the order in which it is heard says nothing
                    moment, together = asyncio.get_running_loop().time(), self._inbox.qsize() + 1
                together -= 1
                self._handle(event, moment)
        except BaseException:
            if self.journal.may_act():  # otherwise another process carries it on; their reports will not be heard
                self._perform([*map(events.Cancel, self.run.open_requests)])
            raise
        finally:
            self.ended = True
            self._leave()
            self.journal.retired(self.run)
            self.run.retire()
            # Reports that came with the last event would be lost, and with them the resources that their requests keep.
            while not self._inbox.empty():
                self._heard_late(self._inbox.get_nowait())
            self.run.observer = events.SILENT  # who observes it holds this executor
        return self.run.result()

    def _hear(self, report: Report) -> None:
        report = self.run.as_settled(report)
        match report:
            case Ended(request, Outcome(OutcomeKind.LOST)) if self.source and self._leaving and self.run.when_lost(request) is WhenLost.ASK:
                self._start(request, self._ask_what_has_become(report, self.source))
            case _:
                self._take_in(report)

    def _take_in(self, report: Report) -> None:
        if self._leaving:  # after the end no one reads the inbox, but a server may still confirm what was given up
            self._inbox.put_nowait(report)
        else:
            self._heard_late(report)

    def _heard_late(self, event: events.Event) -> None:
        if isinstance(event, Ended):
            self.journal.confirmed(event.request, self.run.resources)

    def _enter(self) -> None:
        run = self.run

        def hear() -> None:
            if not self._hearing:
                self._hearing = [layer.listen(changed) for layer in (run.knowledge.world, run.knowledge.local)]

        def changed(changes: Mapping[Fluent, Value | Unknown]) -> None:
            if run.hears_of(changes):  # whatever it decides later, it decides by what is known then
                self._put_once(events.KnowledgeChanged())
            elif not run.listens:  # nor does it hear of other changes until it does: most runs of many wait for no facts
                self._stop_hearing()

        self._leaving = [run.resources.listen(partial(self._put_once, events.ResourcesChanged()), run.task), run.forget_listeners]
        run.when_it_listens(hear)

    def _leave(self, asked: Collection[UUID] = ()) -> None:
        """Listen no longer, and have nothing waited for, nor asked but these questions."""
        for stop in self._leaving:
            stop()
        self._leaving = []
        self._stop_hearing()
        for identity, task in self._source_tasks.items():
            if identity not in asked:
                task.cancel()
        self._wake_at(None)
        self._announce()

    def _stop_hearing(self) -> None:
        """Hear of no change of knowledge until the run listens again."""
        for stop in self._hearing:
            stop()
        self._hearing = []

    def _announce(self) -> None:
        if self._progress is not None:
            self._progress.set()  # wakes all that wait now; those that begin to wait later wait for the next event
            self._progress = None

    def _handle(self, event: events.Event, now: float | None = None) -> None:
        if isinstance(event, (events.KnowledgeChanged, events.ResourcesChanged)):
            self._waiting.discard(event)  # before it is handled: a change that its own commands cause has to be looked at again
        self.journal.handle(self.run, event, asyncio.get_running_loop().time() if now is None else now, self._perform)
        self._announce()

    def _perform(self, commands: Sequence[events.Command]) -> None:
        for command in commands:
            match command:
                case events.Send(request) if name := self._in_hands(request):  # decided before it was taken
                    self._inbox.put_nowait(Ended(request.id, Outcome(OutcomeKind.UNAVAILABLE, message=str(self.hands.taken[name]))))
                case events.Send(request):
                    if error := _raised_by(self.client.send, request, self._hear):
                        # The others go on. It may have reached the robot all the same, as may any that is not answered.
                        self._inbox.put_nowait(Ended(request.id, Outcome(OutcomeKind.UNAVAILABLE, message=f"it cannot be sent: {error}")))
                case events.Reattach(request, accepted):
                    client = self.client
                    accepted = accepted or bool(self._in_hands(request))  # what was not sent is not sent now
                    again = partial(client.reattach, accepted=accepted) if isinstance(client, ReattachingClient) else None
                    if again is None or _raised_by(again, request, self._hear):
                        self._inbox.put_nowait(Ended(request.id, NOT_REATTACHED))
                case events.Cancel(request):
                    _raised_by(self.client.cancel, request)  # it ends by itself, or its limit for that passes
                case events.Wake(at):
                    self._wake_at(at)
                case events.Ask(identity, question):
                    self._start(identity, self._ask(identity, question))
                case events.Withdraw(identity):
                    if identity in self._source_tasks:
                        self._source_tasks[identity].cancel()
                case events.Store(identity, question, value):
                    self._start(identity, self._update(identity, question, value))
                case _:
                    assert_never(command)

    def _in_hands(self, request: Request) -> str:
        return self.run.bindings.named(request.action, self.hands.taken) if self.hands.taken else ""

    def _start(self, identity: UUID, work: Coroutine[None, None, None]) -> None:
        task = self._source_tasks[identity] = asyncio.get_running_loop().create_task(work)
        task.add_done_callback(lambda _: self._source_tasks.pop(identity, None))

    async def _ask(self, identity: UUID, question: Question) -> None:
        answer: object = MISSING
        message = ""
        try:
            if self.source:
                answer = await self.source.query(question, replace(self._asker, question=identity))
        except SourceError as error:
            message = str(error)
            _log.warning("%s has no answer: %s", question, message)  # the run may go on with that, as a choice does
        except (Exception, asyncio.CancelledError):  # of a foreign knowledge base: the run waits for an answer
            if _is_cancelled():
                raise
            _log.exception("%s cannot be asked", question)
            message = f"{question} cannot be asked"
        self._inbox.put_nowait(events.Answered(identity, answer, message))

    async def _update(self, identity: UUID, question: Question, value: object) -> None:
        outcome = Outcome(OutcomeKind.SUCCEEDED)
        try:
            if self.source:
                await self.source.update(question, value, self._asker)
        except SourceError as error:
            outcome = Outcome(OutcomeKind.ABORTED, message=str(error))
        except (Exception, asyncio.CancelledError) as error:
            if _is_cancelled():
                raise
            _log.exception("%s cannot be stored", question)
            outcome = Outcome(OutcomeKind.ABORTED, message=f"{question} cannot be stored: {str(error) or type(error).__name__}")
        self._inbox.put_nowait(Ended(identity, outcome))

    async def _ask_what_has_become(self, end: Ended, source: Source) -> None:
        """Ask a person about a request that was lost; until then it counts as under way."""
        outcome, action = end.outcome, self.run.open_calls[end.request].action
        try:
            if await was_carried_out(source, self._asker, end.request, str(action), self.note):
                outcome = Outcome(OutcomeKind.SUCCEEDED, message="a person says that it was carried out")
            else:
                outcome = replace(outcome, message=f"{outcome.message}; no person says that it was carried out")
        except SourceError as error:
            outcome = replace(outcome, message=f"{outcome.message}; a person was asked about it in vain: {error}")
        finally:  # also when the run has ended meanwhile: no robot is at work on it
            self._take_in(Ended(end.request, outcome))
            self.note(HelpEnded(outcome.message, end.request))

    def _wake_at(self, at: float | None) -> None:
        if self._timer:
            self._timer.cancel()
        self._timer = None if at is None else asyncio.get_running_loop().call_at(at, self._inbox.put_nowait, events.Tick())

    def _put_once(self, event: events.KnowledgeChanged | events.ResourcesChanged) -> None:
        # Many facts change at once; asking the guards once after all of them is enough, and keeps the inbox short.
        if event not in self._waiting:
            self._waiting.add(event)
            self._inbox.put_nowait(event)


def _raised_by(ask: Callable[..., None], request: Request | UUID, *arguments: object) -> str:
    """Return the error of a client about one request, which concerns no other; empty if it has been asked."""
    try:
        ask(request, *arguments)
    except Exception as error:
        _log.exception("the action client failed at request %s", request if isinstance(request, UUID) else request.id)
        return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return ""


def _is_cancelled() -> bool:
    """Return whether this task itself is cancelled; otherwise the source has been, from elsewhere."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
