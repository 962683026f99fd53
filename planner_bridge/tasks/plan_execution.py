"""Execution of a plan by a verified run, which runs of other plans may succeed while calls are under way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Any, Final

from planner_bridge.ordering.interference import Forecast, ReadWriteSets, forecast, read_write_sets
from planner_bridge.tasks.constraint_monitor import TaskMonitor
from planner_bridge.tasks.context import TaskContext
from planner_bridge.tasks.replanning import Progress, why_not
from planner_bridge.tasks.result import TaskLog
from planner_bridge.tasks.settings import OnChange, ProvedMachine
from pnm.core.execution.call_results import Failure, RunResult
from pnm.core.execution.events import Observer, broadcast
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.machine_index import prepare
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.effects import names_written, possible_assignments
from pnm.core.logic.expressions import EXISTS, Constant, Fluent, State, Unknown, Value, is_number
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import GroundAction, PlanGraph
from pnm.core.machine.requests import CallOutcome
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from pnm.journal.replay import ReplayedRun
from pnm.tasks import TaskState

_NAMED: Final = 3
"""Facts of one report that are named; of others there is only their number."""


class PlanExecution(Observer):
    """The execution of one plan, and of those that follow it while calls are under way.

    The mutable state is the executor, which has the current run; its future result; whether attention is called for, and at which
    time it will be; whether the run is still to be replaced; whether it is held, so that it starts nothing while a plan is searched
    for, or is finishing; and whether the plan is blocked.

    Args:
        begin_with: the machine of a plan, with its proof; or the run with which another process has begun.
        origin: the time from which the times of plans count.
    """

    def __init__(
        self, context: TaskContext, monitor: TaskMonitor, log: TaskLog, begin_with: ProvedMachine | ReplayedRun, origin: float
    ) -> None:
        self._context = context
        self._monitor = monitor
        self._log = log
        self._origin = origin
        self._attention = asyncio.Event()
        self._timer: asyncio.TimerHandle | None = None
        self._is_due = False
        """Whether the run is still to be replaced, and could not be."""
        self._tried: tuple[UnderWay, ...] | None = None
        """The part that it would have handed over then; None if it could not be handed over."""
        self._is_held = False
        self._whole: tuple[PlanGraph, ReadWriteSets] | None = None
        """A plan, and the needs and changes of all of it."""
        self._news = ""
        self.set_off_by = ""
        """The reports for which the plan was looked at last, since it began, and when they came; empty if there were none."""
        self.is_finishing = False
        self.is_blocked = False
        """Whether others have begun, during a pause, with what the rest of the plan is in conflict with; its run ends then, even
        if they are over before it is."""
        runner, client = context.runner, context.runner.backend.client
        if isinstance(begin_with, ReplayedRun):
            run = runner.journal.go_on(begin_with, broadcast(Observer, (context.observer, self)), client.goal_fields)
        else:
            run = self._run_of(begin_with, {})
        self.executor = Executor(run, client, runner.source, context.task.wanted.text, runner.journal, context.note, hands=runner.hands)
        self._future: asyncio.Future[RunResult] = asyncio.get_running_loop().create_future()

    async def __aenter__(self) -> PlanExecution:
        self._context.control.begin_execution(self)
        stop_listening = self._context.world.listen(self._changed, None if self.is_eager else EXISTS)

        def end(_: object) -> None:
            self._context.control.end_execution()
            stop_listening()
            if self._timer:
                self._timer.cancel()

        self._future = asyncio.ensure_future(self._context.runner.execute_run(self.executor))
        self._future.add_done_callback(end)
        self._context.control.enter(TaskState.RUNNING)
        if self._context.runner.hands.taken:
            self.look_again()
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        """Stop the run after an error; a cancelled asyncio task leaves everything as it is."""
        if kind is not None and issubclass(kind, asyncio.CancelledError):
            self._future.cancel()
        elif not self._future.done():
            self.executor.stop(reason="an error has occurred")
            await asyncio.wait((self._future,))

    # --- what is known --------------------------------------------------------------------------

    @property
    def run(self) -> Run:
        """The current run."""
        return self.executor.run

    @property
    def is_over(self) -> bool:
        """Whether the run has come to its end."""
        return self._future.done()

    @property
    def result(self) -> RunResult:
        """The result of the run, so far or for good."""
        return self._future.result() if self.is_over else self.run.interim_result()

    @property
    def progress(self) -> Progress:
        """The progress of the current plan; nothing is under way once the run is over."""
        calls = self.result.calls
        under_way = () if self.is_over else (result.call.index for result in calls if result.is_under_way)
        return Progress(self.run.machine.plan, calls, frozenset(under_way))

    @property
    def needed(self) -> ReadWriteSets:
        """The needs and changes of the rest of the plan."""
        progress = self.progress
        return read_write_sets(progress.rest, progress.plan.goal, self._context.world)

    @property
    def whole(self) -> ReadWriteSets | None:
        """The needs and changes of the whole plan; None if they are others in another world, for what derived facts rest on changes."""
        plan, world = self.run.machine.plan, self._context.world
        if world.rules.derived:
            return None
        if self._whole is None or self._whole[0] is not plan:
            self._whole = plan, read_write_sets([replace(call, under_way=False) for call in plan.calls], plan.goal, world)
        return self._whole[1]

    @property
    def forecast(self) -> Forecast:
        """The time at which the plan is expected to be done with its needs."""
        progress = self.progress
        left = self.left(progress, lambda action: action.duration or 0.0)
        return forecast(progress.plan, progress.events, left, self._context.world, asyncio.get_running_loop().time())

    def left(self, progress: Progress, lasts: Callable[[GroundAction], float]) -> dict[int, float]:
        """Return the seconds that calls under way still take, by number; a late call as long again as it is late."""
        now = asyncio.get_running_loop().time()
        under_way = [progress.calls[number] for number in sorted(progress.under_way)]
        began = [(now if result.started is None else result.started, result.call) for result in under_way]
        return {call.index: abs(time + lasts(call.action) - now) for time, call in began}

    @property
    def under_way(self) -> tuple[UnderWay, ...]:
        """The requests that another run can take over."""
        return () if self.is_over else self.run.under_way()

    @property
    def is_eager(self) -> bool:
        """Whether the plan is looked at again as soon as facts change."""
        return self._context.settings.on_change is OnChange.EAGER

    def obstacle(self) -> str:
        """Return why the rest of the plan does not lead to its goal any more; empty when it does."""
        return self._monitor.why_not(self.progress, self._context.forbidden(self._log.history))

    def waits_for_more(self) -> bool:
        """Return whether calls that are under way will undo the goal, or constraints ask for more."""
        return bool(why_not(self.progress.what_goes_on, self._context.present) or self._monitor.missing)

    # --- attention ------------------------------------------------------------------------------

    async def attention(self) -> None:
        """Wait until the run is over, or may have to be replaced: something failed, facts have changed, or that is due anyway."""
        called: list[asyncio.Future[Any]] = [asyncio.ensure_future(self._attention.wait())]
        if self._is_due:

            async def other_rest() -> None:  # something else is under way that can be handed over than when that was tried last
                while self._to_hand_over in (None, self._tried):
                    await self.executor.happens()

            called.append(asyncio.ensure_future(other_rest()))
        try:
            await asyncio.wait((self._future, *called), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for one in called:
                one.cancel()
        self.set_off_by, self._news = self._news or self.set_off_by, ""
        self._attention.clear()  # after the wait: whatever calls for attention from now on is seen in the next round

    def note(self, *, is_due: bool) -> None:
        """Note whether the run, which was looked at, is still to be replaced: then it is looked at again once it has come further."""
        self._is_due, self._tried = is_due, self._to_hand_over

    @property
    def _to_hand_over(self) -> tuple[UnderWay, ...] | None:
        return self.under_way if self.executor.is_settled else None

    def call_attention_at(self, time: float) -> None:
        """Call for attention at a time, on the clock of the event loop."""
        if self._timer:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_at(time, self._attention.set)

    def failed(self, failure: Failure, now: float) -> None:
        """Call for attention after a failure."""
        self._attention.set()

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        """Call for attention when facts change otherwise than the calls change them, or objects were found."""
        news = {fluent: value for fluent, value in changes.items() if fluent[0] == EXISTS}
        if news:
            self._whole = None  # quantifiers range over more now
            self._context.control.replanned()
        # During a pause the plan is compared with the world once, when it is resumed.
        if not (news or self.is_eager) or self._context.control.is_paused:
            return
        whole, names = self.whole, self.run.machine.plan.used_by
        if not news and whole and whole.used.isdisjoint(changes):  # as most: all tasks hear of all changes
            return
        used = {fluent: value for fluent, value in changes.items() if (fluent in whole.used if whole else fluent[0] in names)}
        progress = self.progress if used and self.is_eager else None  # which takes a look at every call
        if news := news | (unforeseen(progress, relevant(progress, used), self._context.knowledge) if progress else {}):
            said = [
                statement_text(fluent, value) for fluent, value in sorted(news.items(), key=lambda one: is_number(one[1]))
            ]  # facts first
            named = " ".join(said[:_NAMED]) + (f" and {len(said) - _NAMED} more" if len(said) > _NAMED else "")
            self._news = f"set off by the report {named} at {self._monitor.elapsed:.2f} s"
            self._attention.set()

    # --- control --------------------------------------------------------------------------------

    def resume(self) -> None:
        """Go on after a pause; if the plan does not work any more, or is in conflict with others, call for attention first."""
        if self._context.scheduler.new_conflicts(self._context.task, lambda: self.needed):
            self.is_blocked = True
        # The run stays paused in these cases, so that nothing starts before it is decided what to do.
        if self.is_blocked or self.result.failures or ((self.is_eager or self.run.hands) and self.obstacle()):
            self._attention.set()
        elif not self._is_held:
            self.executor.resume()

    def look_again(self) -> None:
        """Call for attention: people have taken something in hand, which the run knows, or have given it back, of which it hears then."""
        self._attention.set()

    def why_no_step(self) -> str:
        """Return why nothing of the plan may begin now: it does not lead to its goal, or others are at work with what it needs."""
        conflicts = self._context.scheduler.conflicts(self._context.task, lambda: self.needed)
        others = ", ".join(conflict.name for conflict in conflicts)
        if self.is_blocked or others:
            return f"the plan is in conflict with {others or 'what others have begun'}; it has to be resumed, to wait or to be planned anew"
        if self.result.failures:
            return f"the plan has failed: {self.result.reason}; it has to be resumed, to be planned anew"
        obstacle = self.obstacle()
        return f"the plan does not work any more: {obstacle}; it has to be resumed, to be planned anew" if obstacle else ""

    def hold(self) -> None:
        """Start nothing more until `release`."""
        self._is_held = True
        self.executor.pause(at_once=False)

    def release(self) -> None:
        """Go on, unless the task is paused; what people have given back may be used again."""
        self._is_held = False
        self.executor.heed_hands()
        self._context.control.await_hands(self.executor.needs_from_people)
        if not self._context.control.is_paused:
            self.executor.resume()

    def finish(self, reason: str) -> None:
        """Start nothing more; what is under way goes on to its end."""
        self.is_finishing = True
        self.executor.stop(cancel=False, reason=reason)

    async def at_rest(self) -> bool:
        """Wait until everything that is under way can be handed over; return whether it can: if not, the run is over or has to go on."""
        rests = await self.executor.at_rest()
        if self.executor.ended:
            await asyncio.wait((self._future,))  # which is done a moment later
        return rests

    def succeed(self, successor: ProvedMachine) -> None:
        """Go on with the machine of another plan, which takes over the calls that are under way."""
        self.set_off_by = ""
        numbers = (call.index for call in successor[0].plan.calls if call.under_way)  # in the order that they had in the old plan
        self.executor.succeed(self._run_of(successor, dict(zip(numbers, self.run.under_way(), strict=True))))
        self._context.control.replanned()

    def _run_of(self, proved: ProvedMachine, adopted: Mapping[int, UnderWay]) -> Run:
        context, runner, (machine, proof) = self._context, self._context.runner, proved
        context.observer.generated(machine, proof)
        if self._monitor.prediction:  # what the plan waits for is known as soon as it is so
            actions = [call.action for call in machine.plan.calls]
            needs = (part for one in actions for part in (one.precondition, one.invariant, one.end_condition))
            self._monitor.prediction.watched = (machine.plan.goal, *needs)
            self._monitor.prediction.look()
        return runner.journal.make_run(
            machine,
            context.knowledge,
            id=runner.new_id(),
            bindings=context.settings.bindings,
            goal_fields=runner.backend.client.goal_fields,
            name=context.task.name,
            asks=runner.source is not None,
            observer=broadcast(Observer, (context.observer, self)),
            origin=self._origin,
            resources=runner.resources,
            task=context.task.id,
            priority=context.task.wanted.priority,
            adopted=adopted,
        )


async def proved_machine(context: TaskContext, graph: PlanGraph) -> ProvedMachine:
    """Generate and verify the machine of a plan in a thread, which may take seconds; raise `Unsound` if the plan cannot be executed."""

    def prove() -> ProvedMachine:
        settings, stopwatch = context.settings, context.task.stopwatch
        with stopwatch.of("translate"):
            capacities = context.runner.resources.capacities
            machine = generate(graph, settings.bindings, on_failure=settings.on_failure, capacities=capacities)
        with stopwatch.of("verify"):
            proof = verify(machine)
        prepare(machine)
        return machine, proof

    return await context.control.in_thread(partial(context.settings.memory.machine, graph, prove))


def relevant(progress: Progress, changed: Mapping[Fluent, Value | Unknown]) -> dict[Fluent, Value | Unknown]:
    """Return those of the changes that are of what the rest of the plan reads or writes, or its goal."""
    left, used_by = {*(call.index for call in progress.rest), len(progress.plan.calls)}, progress.plan.used_by
    return {fluent: value for fluent, value in changed.items() if not left.isdisjoint(used_by.get(fluent[0], ()))}


def unforeseen(progress: Progress, changed: Mapping[Fluent, Value | Unknown], state: State) -> dict[Fluent, Value | Unknown]:
    """Return those of the changes that no call that has begun makes: neither to what one of them writes, nor a number it computes."""
    mentioned = {fluent[0] for fluent in changed}
    begun = (result.call.action for result in progress.calls if result.kind is not CallOutcome.WAITING)
    written: dict[Fluent, list[Value | None]] = {}
    for effects in ((*action.start_effects, *action.possible_effects) for action in begun):
        for fluent, effect, _ in possible_assignments(effects, state) if names_written(effects) & mentioned else ():
            written.setdefault(fluent, []).append(effect.value.value if isinstance(effect.value, Constant) else None)
    is_made = {fluent: value in written.get(fluent, ()) or None in written.get(fluent, ()) for fluent, value in changed.items()}
    return {fluent: value for fluent, value in changed.items() if not is_made[fluent]}
