"""Control of a task: pausing, resuming and stopping it, its time limit, and the state it shows."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from math import ulp
from typing import Final, Protocol, TypeVar

from planner_bridge.model.plan import Policy
from planner_bridge.ordering.interference import Forecast, ReadWriteSets, read_write_sets
from planner_bridge.tasks.settings import TaskObserver
from pnm.clock import TimeLimit
from pnm.core.execution.run import Run
from pnm.core.logic.conditions import TRUE
from pnm.executor import Executor
from pnm.tasks import Code, TaskRefused, TaskState

T = TypeVar("T")

_ALWAYS_SHOWN: Final = frozenset({TaskState.PAUSING, TaskState.PAUSED, TaskState.CANCELLING, TaskState.OVER})


class TaskEnded(Exception):
    """The task has come to its end, with a code and a reason.

    Args:
        can_be_helped: whether a person who mends something may keep it from ending so.
        by_facts: whether it is tried again when facts change, as well.
    """

    def __init__(self, code: Code, reason: str, *, can_be_helped: bool = False, by_facts: bool = True) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason
        self.can_be_helped = can_be_helped
        self.by_facts = by_facts


class Execution(Protocol):
    """The execution of a plan."""

    @property
    def executor(self) -> Executor:
        """The executor of its runs."""

    @property
    def needed(self) -> ReadWriteSets:
        """The needs and changes of the rest of the plan."""

    @property
    def whole(self) -> ReadWriteSets | None:
        """The needs and changes of the whole plan, however far it has come; None if they are not known."""

    @property
    def forecast(self) -> Forecast | None:
        """The time at which the plan is expected to be done with its needs, and its results then; None if nobody can say."""

    def resume(self) -> None:
        """Go on after a pause of the task."""

    def look_again(self) -> None:
        """Look again at the plan: people have taken something in hand, or have given it back."""

    def why_no_step(self) -> str:
        """Return why nothing may begin during the pause of the task; empty if it may."""


class TaskControl:
    """Control of a task: its requested pause or stop, its state, and its execution. Everything in it is mutable state."""

    def __init__(self, observer: TaskObserver) -> None:
        self._observer = observer
        self.state = TaskState.QUEUED
        self.reason = ""
        """Why the task is in this state."""
        self._activity = TaskState.QUEUED, ""
        """The state that a pause hides, and its reason."""
        self.has_begun = False
        self.stopped: TaskEnded | None = None
        """Why the task is to end before its goal is reached."""
        self.execution: Execution | None = None
        self.reserved: Callable[[], ReadWriteSets] | None = None
        """The footprint of the plan found last, computed if another task needs it: others respect it before the plan is executed."""
        self.replanned: Callable[[], object] = lambda: None
        """Called whenever there may be another plan, or another run."""
        self.policy: Policy | None = None
        """What the plan found last is the beginning of, if actions have several outcomes."""
        self.awaits_hands = False
        """Whether it waits for people to give back what they have in their hands; what needs nothing of that goes on."""
        self.awaits_help = False
        """Whether a person is asked for help, without which the task does not go on."""
        self.planner_stop = threading.Event()
        """Ends searches for plans."""
        self.over = asyncio.Event()
        """Set once the task is over and its listeners know."""
        self._last_run: Run | None = None
        self._waits = 0
        """For how many things the task waits that come by themselves, or that others see to."""
        self._time_limit: TimeLimit | None = None
        self._is_stopped = asyncio.Event()
        self._is_unpaused = asyncio.Event()
        self._is_unpaused.set()

    # --- what others ask --------------------------------------------------------------------------

    @property
    def is_paused(self) -> bool:
        """Whether the task is paused, or is to pause."""
        return not self._is_unpaused.is_set()

    @property
    def awaits(self) -> bool:
        """Whether something is to come without which the task cannot go on; not if it is paused, or a person is asked."""
        return self._waits > 0 or (self.execution is not None and self.execution.executor.awaits)

    @property
    def awaits_people(self) -> bool:
        """Whether the task does not go on before somebody resumes it, or answers."""
        return self.is_paused or self.awaits_help or self.awaits_hands or self.awaits_answers

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing of the plan goes on before a person has answered."""
        return self.execution is not None and self.execution.executor.awaits_answers

    @property
    def run(self) -> Run | None:
        """The current run, or the last one."""
        return self.execution.executor.run if self.execution else self._last_run

    @property
    def footprint(self) -> ReadWriteSets | None:
        """The needs and changes of the rest of the plan, or of its running calls during a pause; None while there is no plan."""
        if self.execution and self.is_paused:
            run = self.execution.executor.run
            return read_write_sets(run.unsettled, TRUE, run.knowledge.world)
        if self.execution:
            return self.execution.needed
        return self.reserved() if self.reserved else None

    @property
    def has_plan(self) -> bool:
        """Whether there is a plan, and with it a footprint."""
        return bool(self.execution or self.reserved)

    @property
    def whole(self) -> ReadWriteSets | None:
        """What the footprint of the plan is at most; None if that is not known."""
        return self.execution.whole if self.execution else self.footprint

    @property
    def forecast(self) -> Forecast | None:
        """The forecast of the plan; None while there is none. A wait for people takes as long as they do."""
        if self.execution and not self.awaits_answers and (expected := self.execution.forecast):
            return expected
        return None if self.footprint is None else Forecast(self.footprint)

    # --- stopping and pausing ---------------------------------------------------------------------

    def stop(self, code: Code, reason: str) -> None:
        """End the task: start nothing more and cancel what is under way.

        The first reason counts, unless a constraint is violated later, which cannot be made good.
        """
        if self.stopped and (code is not Code.CONSTRAINT_VIOLATED or self.stopped.code is code):
            return
        self.stopped = TaskEnded(code, reason)
        self._is_stopped.set()
        self._is_unpaused.set()
        self.planner_stop.set()
        self.enter(TaskState.CANCELLING, reason)
        if self.execution:
            self.execution.executor.stop(reason=reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Pause until `resume`; return when nothing is under way, or when the task is not paused any more.

        The pause of a task that is being stopped ends with the task. `at_once` cancels the calls that are under way,
        to begin them anew later.
        """
        if not self.stopped:
            if self._time_limit:
                self._time_limit.pause()
            self._is_unpaused.clear()
            executor = self.execution.executor if self.execution else None
            if executor:  # before the state is shown, upon which it may be decided that the task goes on
                executor.pause(at_once=at_once)
            if self.has_begun and self.state is not TaskState.PAUSED:
                self.enter(TaskState.PAUSING, reason)
            await self._at_rest(executor, reason)
        if self.state is TaskState.CANCELLING:
            await self.over.wait()

    async def step(self) -> None:
        """Let one request leave during a pause, and return when nothing is under way any more; raise `TaskRefused` if none can."""
        execution = self.execution
        if self.state is not TaskState.PAUSED or execution is None:
            raise TaskRefused("only a task that is paused, and whose plan has begun, can go on by one request")
        if why_not := execution.why_no_step():
            raise TaskRefused(why_not)
        if not execution.executor.step():
            raise TaskRefused("nothing can begin now: the next call waits for more than the end of the pause")
        reason = self.reason
        self.enter(TaskState.PAUSING, reason)  # so that others respect what is under way
        await self._at_rest(execution.executor, reason)

    async def _at_rest(self, executor: Executor | None, reason: str) -> None:
        """Be paused as soon as nothing is under way."""
        while executor and self.is_paused and not (executor.paused or executor.ended):
            await executor.happens()
        if self.is_paused:
            self.enter(TaskState.PAUSED, reason)

    def hold(self) -> None:
        """Be paused from the beginning, as in a process that has died; `pause` follows."""
        self._is_unpaused.clear()

    def end(self) -> None:
        """Be over for good: whoever waits for that goes on, and nobody is told of anything more."""
        self.over.set()
        self._observer, self._time_limit, self.reserved = TaskObserver(), None, None

    def conclude(self, reason: str) -> None:
        """Be over from the beginning, as in a process that has died: its listeners have heard of it there."""
        self.state, self.reason = TaskState.OVER, reason
        self.over.set()

    def resume(self) -> None:
        """Go on after a pause: with the rest of the plan if that still works."""
        if self.is_paused:
            if self._time_limit and not self.awaits_hands:
                self._time_limit.go_on()
            self._is_unpaused.set()
            self._show(*self._activity)
            if self.execution:
                self.execution.resume()

    def limit_time(self, limit: TimeLimit) -> None:
        """Have pauses stop the time of this limit, in place of an earlier one."""
        self._time_limit = limit
        if self.is_paused or self.awaits_hands:
            limit.pause()

    def await_hands(self, needed: Collection[str]) -> None:
        """Note what people have in their hands that the task waits for, in words, if anything; its limit stands still meanwhile."""
        had, self.awaits_hands = self.awaits_hands, bool(needed)
        if (needed or had) and self._activity[0] is TaskState.RUNNING:
            self.enter(TaskState.RUNNING, f"waits: {'; '.join(needed)}" if needed else "")
        if needed and self._time_limit:
            self._time_limit.pause()
        elif had and self._time_limit and not self.is_paused:
            self._time_limit.go_on()

    # --- what the task does -----------------------------------------------------------------------

    def begin(self, activity: TaskState) -> None:
        """Note that the task has begun, with an activity that is shown when it shows itself first."""
        self.has_begun = True
        self._activity = activity, ""

    def begin_execution(self, execution: Execution) -> None:
        """Note which execution of a plan pauses and stops are passed on to, until `end_execution`."""
        self.execution = execution
        self.replanned()
        if self.stopped:
            execution.executor.stop(reason=self.stopped.reason)
        if self.is_paused:
            execution.executor.pause(at_once=False)
        elif execution.executor.run.pausing:  # it was held back in a process that has died
            execution.resume()

    def end_execution(self) -> None:
        """Note that no plan is executed any more."""
        self._last_run, self.execution = self.run, None
        self.replanned()

    def reserve(self, footprint: Callable[[], ReadWriteSets] | None) -> None:
        """Note the footprint of a plan that was found, or that there is none in mind any more."""
        self.reserved = footprint
        self.replanned()

    def enter(self, state: TaskState, reason: str = "") -> None:
        """Show another state; a pause or a coming end hides the activity of the task."""
        if state not in _ALWAYS_SHOWN:
            self._activity = state, reason
            if self.is_paused or self.stopped:
                return
        self._show(state, reason)

    def _show(self, state: TaskState, reason: str) -> None:
        if (state, reason) != (self.state, self.reason) and self.state is not TaskState.OVER:
            self.state, self.reason = state, reason
            self._observer.entered(state, reason)

    # --- waiting for what comes by itself, or what others see to --------------------------------------

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Have the task count as waiting meanwhile: it does not stand still."""
        self._waits += 1
        try:
            yield
        finally:
            self._waits -= 1

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Do work in a thread, and return what comes of it."""
        with self.waiting():
            return await asyncio.to_thread(work)

    async def unpaused(self) -> None:
        """Wait until the task is not paused; raise `TaskEnded` if it was stopped."""
        await self._is_unpaused.wait()
        self.check()

    async def until(self, event: Awaitable[T]) -> T:
        """Wait for something, and return it; raise `TaskEnded` if the task was stopped."""
        happening, stopping = asyncio.ensure_future(event), asyncio.ensure_future(self._is_stopped.wait())
        try:
            with self.waiting():
                await asyncio.wait((happening, stopping), return_when=asyncio.FIRST_COMPLETED)
        finally:
            happening.cancel()
            stopping.cancel()
        self.check()
        return await happening  # raises what has gone wrong

    async def wait(self, seconds: float) -> None:
        """Wait some seconds, or until the task is stopped."""
        with self.waiting(), suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._is_stopped.wait()

    def check(self) -> None:
        """Raise `TaskEnded` if the task was stopped."""
        if self.stopped:
            raise self.stopped


STILL: Final = 60.0
"""Seconds after which a task that stands still is ended."""
_LATER: Final = 0.1
"""The part of a long wait after which it is looked at again whether something is still to come."""


class Watchdog:
    """Ends a task that stands still: nothing has happened to it for some time, it waits for nothing, and nobody has paused it.

    What is proved is the machine of a plan; this is for what stands around it. A task never stands still unless there is a mistake here.
    `end` is called each time that it is found so. The mutable state is when something has happened last, and the timer.
    """

    def __init__(self, control: TaskControl, end: Callable[[], None]) -> None:
        self._control = control
        self._end = end
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self.heard()

    def heard(self) -> None:
        """Note that something has happened to the task."""
        self._last = self._loop.time()
        if self._timer is None:
            self._look_at(self._last + STILL)

    def close(self) -> None:
        """Look no more, and forget the task."""
        self._end = lambda: None
        if self._timer is not None:
            self._timer.cancel()

    def _look_at(self, time: float) -> None:
        self._timer = self._loop.call_at(time, self._look)

    def _look(self) -> None:
        self._timer, now = None, self._loop.time()
        if now < self._last + STILL:
            self._look_at(self._last + STILL)
        elif not self._control.awaits_people:  # of which is heard when it is over
            if not self._control.awaits:
                self._end()
            # later and later: a rehearsal jumps over years in which nothing happens, and would look at each minute of them
            self._look_at(now + max(STILL, (now - self._last) * _LATER, ulp(now)))
