"""One goal, pursued with as many plans as it takes: planning, execution, replanning, pauses.

A run that does not lead to the goal any more is followed by another one. If others shall continue, or if it was a change of
facts that has made the rest of the plan impossible or needless, that happens while calls are under way: the new plan is made for
the world as it will be after them, and they become calls of the new machine.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import Final, cast

from planner_bridge.alarms import is_foreseen, is_relevant
from planner_bridge.circumstances import Circumstances, Conflict
from planner_bridge.codes import code_of_failures, code_of_planning
from planner_bridge.footprints import Footprint, footprint
from planner_bridge.forbidding import ForbiddenCall, forbid
from planner_bridge.model import Problem
from planner_bridge.plan import Plan, PlanningResult
from planner_bridge.plans import plan_graph
from planner_bridge.projection import Unforeseeable, after
from planner_bridge.replanning import GiveUp, History, PlanAgain, Progress, Resume, decide, rest_of, shortened, times_that_matter, why_not
from planner_bridge.search import Search
from planner_bridge.stopwatch import Stopwatch
from planner_bridge.supervision import Supervision
from planner_bridge.tasks import Episode, OnChange, Settings, TaskObserver, TaskResult
from pnm.actions.base import Outcome, Report, Request
from pnm.analysis import verify
from pnm.calls import UnderWay
from pnm.conditions import evaluate
from pnm.executor import Executor
from pnm.expressions import Fluent, Unknown, Value
from pnm.generation import generate
from pnm.knowledge import KnowledgeBase, Layered
from pnm.ledger import HANDED_OVER, RUNNING
from pnm.machine import OnFailure, PetriNetMachine, Rule
from pnm.observer import Observer
from pnm.plan_graph import ActionCall, PlanGraph, PlanGraphError
from pnm.results import Failure, RunResult
from pnm.run import Run
from pnm.sites import Site
from pnm.state_space import Unsound
from pnm.tasking import Code, OnConflict, TaskState
from pnm.trajectory import Constraint

_BEGUN: Final = frozenset({RUNNING, HANDED_OVER})


class _Over(Exception):
    """The task has come to its end."""

    def __init__(self, code: Code, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


@dataclass(frozen=True, slots=True)
class _Way:
    """How to go on after a run: with a new plan, or with the rest of the old one."""

    decision: Resume | PlanAgain
    history: History
    plan: Plan | None = None


@dataclass
class Pursuit:
    """A goal with its episodes. The mutable state is the monitor, the history, and what stands below it."""

    problem: Problem
    site: Site
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    knowledge: Layered
    circumstances: Circumstances = field(default_factory=Circumstances)
    history: History = field(default_factory=History)
    given: Plan | None = None
    """A plan to begin with, in place of one that would have to be found."""
    state: TaskState = TaskState.PLANNING
    why: str = ""
    """Why it is in this state."""
    episodes: list[Episode] = field(default_factory=list)
    plans: int = 0
    executor: Executor | None = None
    """What executes the current machine."""
    run: Run | None = None
    """The current run, or the last one."""
    _origin: float = 0.0
    """When the search for the current plan began: what its times count from."""
    _stopped: _Over | None = None
    """Why the task is over before its goal is reached."""
    _is_over: asyncio.Event = field(default_factory=asyncio.Event)
    """Nothing needs to be waited for any more."""
    _may_go: asyncio.Event = field(default_factory=asyncio.Event)
    """The task is not paused."""
    _trouble: asyncio.Event = field(default_factory=asyncio.Event)
    """The run may not lead to the goal any more, or there may be a shorter way."""

    def __post_init__(self) -> None:
        self.supervision = Supervision(self.problem, self.knowledge, self.observer, self.stop, self.settings.limits.allowed())
        self.search = Search(self.settings, self.observer, self.seconds, self.circumstances)
        self._may_go.set()

    # --- from outside ---------------------------------------------------------------------------

    async def pursue(self, *, opens: bool = False) -> TaskResult:
        """Go on until the goal holds or the task is over for another reason.

        Args:
            opens: whether the site is still to be opened.

        Raises:
            InputError: the planner refuses the problem; nothing was started.
        """
        with ExitStack() as at_the_end:
            try:
                if opens:
                    await self.site.open(self.knowledge.world)
                self.supervision.begin(at_the_end)
                at_the_end.callback(self.knowledge.world.listen(self._changed))
                await self._pursue()
            except asyncio.CancelledError:  # while no run was there to be stopped
                cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                return self._ended(Code.CANCELLED, "cancelled")
            except _Over as over:
                return self._ended(over.code, over.reason)
            except (PlanGraphError, Unsound) as error:  # a plan that is valid, but not by causes alone
                return self._ended(Code.PLANNER_ERROR, f"the plan cannot be executed: {error}")
        raise AssertionError("a pursuit ends with a reason")

    def stop(self, code: Code, reason: str) -> None:
        """End whatever is going on; what is under way is cancelled, and confirms it or is given up after its limit."""
        first, worse = self._stopped is None, code is Code.CONSTRAINT_VIOLATED  # nothing makes that good
        if first or (worse and cast("_Over", self._stopped).code is not code):
            self._stopped = _Over(code, reason)
            self._is_over.set()
            self.search.stop()
            self._may_go.set()
            if self.executor:
                self._enter(TaskState.CANCELLING, reason)
                self.executor.stop(reason=reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way.

        Args:
            reason: why.
            at_once: cancel what is under way, to begin it anew later.
        """
        self._may_go.clear()
        self._enter(TaskState.PAUSING, reason)
        if self.executor:
            self.executor.pause(at_once=at_once)
        while self.is_paused and self.executor and not (self.executor.run.paused or self.executor.run.over):
            await self.executor.happens()
        if self.is_paused:
            self._enter(TaskState.PAUSED, reason)

    def resume(self) -> None:
        """Go on where the task was if the rest of its plan still works, and else find another way."""
        if self.is_paused:
            self._may_go.set()
            self._enter(TaskState.RUNNING if self.executor else TaskState.PLANNING)
            if self.executor and (progress := self.progress):
                if self.settings.on_change is OnChange.EAGER and self._obstacle(progress):
                    self._trouble.set()
                else:
                    self.executor.resume()

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return not self._may_go.is_set()

    @property
    def progress(self) -> Progress | None:
        """How far the current plan has come; None while there is none."""
        if self.executor is None:
            return None
        calls = self.executor.run.told().calls
        return Progress(self.executor.run.machine.plan, calls, frozenset(one.call.index for one in calls if one.outcome in _BEGUN))

    @property
    def running(self) -> tuple[str, ...]:
        """The calls that are under way."""
        return tuple(str(call.action) for call in self.run.open_calls.values()) if self.run else ()

    @property
    def footprint(self) -> Footprint | None:
        """What the rest of the plan needs and changes; None while there is no plan."""
        if (progress := self.progress) is None:
            return self.search.reserved
        return footprint(progress.rest, progress.plan.goal, self.knowledge.world)

    # --- the story ------------------------------------------------------------------------------

    async def _pursue(self) -> None:
        """Go on until `_Over` is raised."""
        await self._settle()
        graph = await self._planned(self.history.forbidden(self.settings.limits))
        while True:
            result, way = await self._carry_out(graph)
            graph = await self._next(result, way)

    async def _planned(self, forbidden: frozenset[ForbiddenCall]) -> PlanGraph:
        plan = await self._find(forbidden)
        with self.seconds.of("translate"):
            return plan_graph(self._now(), plan)

    async def _carry_out(self, graph: PlanGraph) -> tuple[RunResult, _Way | None]:
        """Have a run carry out the plan, and others follow it while calls are under way; return how the last one ended."""
        await self.site.prepare({call.action: None for call in graph.calls})
        executor = self.executor = Executor(self._run(graph), self.site.client, self.circumstances.source, self.circumstances.name)
        self._enter(TaskState.RUNNING)
        if self._stopped:  # while the machine was being prepared
            executor.stop(reason=self._stopped.reason)
        if self.is_paused:
            executor.pause(at_once=False)
        way: _Way | None = None
        try:
            with self.seconds.of("execute"):
                execution = asyncio.ensure_future(executor.execute())
                while await self._is_troubled(execution):
                    way = await self._another_way(execution)
                    if way and await self._at_rest(execution) and not self._follow(way):
                        way = None
                return await execution, way
        finally:
            self.executor = None

    async def _is_troubled(self, execution: asyncio.Future[RunResult]) -> bool:
        """Wait until the run is over, or something is to be done about it."""
        trouble = asyncio.ensure_future(self._trouble.wait())
        try:
            while not execution.done() and not trouble.done():
                try:
                    await asyncio.wait((execution, trouble), return_when=asyncio.FIRST_COMPLETED)
                except asyncio.CancelledError:
                    if self._stopped:
                        execution.cancel()
                        raise
                    cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                    self.stop(Code.CANCELLED, "cancelled")
        finally:
            trouble.cancel()
        self._trouble.clear()
        return not execution.done()

    async def _next(self, result: RunResult, way: _Way | None) -> PlanGraph:
        """Return what follows a run that is over."""
        machine = cast("Run", self.run).machine
        patient = self.settings.on_change is OnChange.LAZY
        if (patient and not result.goal) or not self.supervision.monitor.idle:  # reports may still be under way
            await asyncio.sleep(self.knowledge.world.longest_lag)
        await self._settle()
        verdict = self._verdict(result)
        if verdict is None and self.given:
            verdict = _Over(code_of_failures(result.failures), result.reason)
        if verdict:
            self.episodes.append(Episode(machine, result))
            raise verdict
        if way and way.plan:
            graph = plan_graph(self._now(), way.plan)
            if not self._why_not(Progress.beginning(graph), way.history):
                self._note(way, machine, result)
                return graph
        return await self._decided(machine, result)

    async def _decided(self, machine: PetriNetMachine, result: RunResult) -> PlanGraph:
        history = self.history.after(result.calls, result.failures)
        progress = Progress(machine.plan, result.calls)
        decision = decide(self._now(), progress, self.knowledge.world, history, self.settings.limits)
        if isinstance(decision, GiveUp):
            self.episodes.append(Episode(machine, result, decision))
            raise _Over(Code.REPLAN_LIMIT, decision.reason + self._last_failure())
        self._note(_Way(decision, history), machine, result)
        self.observer.replanning(decision, result)
        await self._wait(self.history.pause(self.settings.limits))
        if isinstance(decision, Resume):
            return decision.rest
        facts = self.knowledge.world.facts()
        try:
            return await self._planned(decision.forbidden)
        except _Over as over:
            await asyncio.sleep(self.knowledge.world.longest_lag)  # what has just happened may not have been reported yet
            if self._stopped or over.code is Code.CONFLICT or self.knowledge.world.facts() == facts:
                raise
            return await self._planned(decision.forbidden)

    def _note(self, way: _Way, machine: PetriNetMachine, result: RunResult) -> None:
        self.history = way.history
        self.episodes.append(Episode(machine, result, way.decision))

    def _verdict(self, result: RunResult) -> _Over | None:
        """Return how the task ends if it ends with this run."""
        if self._stopped and self._stopped.code is Code.CONSTRAINT_VIOLATED:
            return self._stopped
        carried_out = result.goal or not (self.problem.network or self.given)  # either is more than its goal
        if carried_out and evaluate(self.problem.goal, self.knowledge) is True and not self._missing():
            return _Over(Code.GOAL_REACHED, "the goal holds")
        return self._stopped

    # --- another way while calls are under way --------------------------------------------------

    async def _another_way(self, execution: asyncio.Future[RunResult]) -> _Way | None:
        """Decide what is to follow the run before it is over; None when it has to come to its end first, or may go on."""
        run = cast("Executor", self.executor).run
        progress, has_failed = cast("Progress", self.progress), bool(run.told().failures)
        if self._stopped or self.is_paused or self._matters_when() or (has_failed and not self._continues):
            return None
        if not has_failed:
            if evaluate(self.problem.goal, self.knowledge) is True and not self._waits_for_more(progress):
                cast("Executor", self.executor).stop(cancel=False, reason="the goal holds already")
                return None
            if not self._obstacle(progress) and shortened(progress, self.knowledge.world) == progress:
                self._let_go_on()
                return None
            cast("Executor", self.executor).pause(at_once=False)
        way = await self._way(execution, has_failed)
        if way is None:
            self._let_go_on()
        return way

    def _let_go_on(self) -> None:
        """End the pause of a run that was looked at."""
        if self.executor and not self.is_paused:
            self.executor.resume()

    async def _way(self, execution: asyncio.Future[RunResult], has_failed: bool) -> _Way | None:
        if not await self._at_rest(execution):
            return None
        executor = cast("Executor", self.executor)
        told = executor.run.told()
        history = self.history.after(told.calls, told.failures) if has_failed else self.history.changed()
        decision = decide(self._now(), self._shortest(), self.knowledge.world, history, self.settings.limits)
        if isinstance(decision, GiveUp):
            return None
        self.observer.replanning(decision, told)
        if isinstance(decision, Resume):
            return _Way(decision, history)
        self._enter(TaskState.REPLANNING, decision.why)
        try:
            plan, _ = await self._search(decision.forbidden, tuple(executor.run.under_way()))
        except (_Over, Unforeseeable):
            return None
        finally:
            self._enter(TaskState.RUNNING)
        return _Way(decision, history, plan) if plan else None

    def _follow(self, way: _Way) -> bool:
        """Put another machine in the place of the one that goes on; tell whether its plan still works."""
        executor = cast("Executor", self.executor)
        told, machine = executor.run.told(), executor.run.machine
        under_way = {one.call.index: one for one in executor.run.under_way()}
        progress = Progress(machine.plan, told.calls, frozenset(under_way))
        if way.plan is None:
            graph = rest_of(self._now(), shortened(progress, self.knowledge.world))
        else:
            graph = plan_graph(self._now(), way.plan, [one.call for one in under_way.values()])
        if self._why_not(Progress.beginning(graph), way.history):
            return False
        numbers = (call.index for call in graph.calls if call.under_way)  # in both kinds of graphs they come in their old order
        adopted = dict(zip(numbers, (under_way[index] for index in sorted(under_way)), strict=True))
        self._note(way, machine, told)
        executor.succeed(self._run(graph, adopted))
        self._let_go_on()
        return True

    async def _at_rest(self, execution: asyncio.Future[RunResult]) -> bool:
        """Wait until everything that is under way can be handed over; tell whether the run is still going on then."""
        while not execution.done():
            run = cast("Executor", self.executor).run
            if all(one.outcome != RUNNING for one in run.told().calls):
                return True
            await cast("Executor", self.executor).happens()
        return False

    @property
    def _continues(self) -> bool:
        return self.settings.on_failure is OnFailure.CONTINUE_OTHERS

    def _matters_when(self) -> bool:
        return bool(times_that_matter(self.problem) or self.problem.network)

    def _shortest(self) -> Progress:
        return shortened(cast("Progress", self.progress), self.knowledge.world)

    def _obstacle(self, progress: Progress) -> str:
        return self._why_not(progress, self.history)

    def _why_not(self, progress: Progress, history: History) -> str:
        now = self._now()
        return why_not(progress, self.knowledge.world, history.forbidden(self.settings.limits), (*now.domain.constraints, *now.constraints))

    def _waits_for_more(self, progress: Progress) -> bool:
        """Tell whether calls that are under way will undo the goal, or constraints ask for more."""
        undone = why_not(progress.what_goes_on, self.knowledge.world)
        return bool(undone) or bool(self._missing())

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        """Look at the plan when facts change otherwise than its calls change them."""
        if self.settings.on_change is OnChange.LAZY or self.is_paused or not (progress := self.progress):
            return
        if is_relevant(progress, changes) and not is_foreseen(progress, changes, self.knowledge):
            self._trouble.set()

    # --- planning -------------------------------------------------------------------------------

    async def _find(self, forbidden: frozenset[ForbiddenCall]) -> Plan:
        """Find a plan that can be carried out beside those of the neighbours; wait for them if there is none.

        Raises:
            _Over: there is none, or nobody wants it any more.
        """
        while True:
            await self._until(self.circumstances.neighbours.turn())
            try:
                plan, conflicts = await self._find_in_turn(forbidden)
            finally:
                self.circumstances.neighbours.leave(in_vain=False)
            if plan:
                return plan
            reason = "; ".join(map(str, conflicts))
            if self.circumstances.on_conflict is OnConflict.REFUSE:
                raise _Over(Code.CONFLICT, reason)
            self._enter(TaskState.QUEUED, f"waits for {reason}")

    async def _find_in_turn(self, forbidden: frozenset[ForbiddenCall]) -> tuple[Plan | None, tuple[Conflict, ...]]:
        """Search, and search again when those have made way that yield."""
        while True:
            await self._may_go.wait()
            self._origin = asyncio.get_running_loop().time()
            self._enter(TaskState.PLANNING)
            plan, conflicts = await self._search(forbidden)
            if plan:
                return plan, ()
            if not all(one.yields for one in conflicts):
                self.circumstances.neighbours.leave(in_vain=True)
                return None, conflicts
            await self._until(self.circumstances.neighbours.preempt(conflicts))

    async def _search(
        self, forbidden: frozenset[ForbiddenCall], under_way: tuple[UnderWay, ...] = ()
    ) -> tuple[Plan | None, tuple[Conflict, ...]]:
        """Return a plan, or with whom all plans that were found are in conflict.

        Raises:
            _Over: there is none, or nobody wants it any more.
            Unforeseeable: it is not known what the world will be after what is under way.
        """
        if self._stopped:
            raise self._stopped
        now = forbid(self._now(after(self.knowledge.world, under_way)), forbidden)
        given = None if self.plans else self.given
        found, conflicts = await self.search.find(now, [one.call for one in under_way], self.supervision.left, given)
        if self._stopped:
            raise self._stopped
        if found.plan is None:
            failures = [failure for episode in self.episodes for failure in episode.result.failures]
            raise _Over(code_of_planning(found.status, failures), _no_plan(found, forbidden) + self._last_failure())
        if conflicts:
            return None, conflicts
        self._accept(found.plan)
        return found.plan, ()

    def _accept(self, plan: Plan) -> None:
        self.plans += 1
        self.supervision.allow(self.settings.limits.allowed(plan.makespan if plan.temporal else 0.0))
        self.observer.planned(plan)

    # --- machines -------------------------------------------------------------------------------

    def _run(self, graph: PlanGraph, adopted: Mapping[int, UnderWay] | None = None) -> Run:
        with self.seconds.of("translate"):
            machine = generate(graph, self.settings.bindings, on_failure=self.settings.on_failure)
        with self.seconds.of("verify"):
            proof = verify(machine)
        self.observer.generated(machine, proof)
        circumstances = self.circumstances
        self.run = Run(
            machine,
            self.knowledge,
            id=circumstances.new_identity(),
            bindings=self.settings.bindings,
            goal_fields=self.site.client.goal_fields,
            asks=circumstances.source is not None,
            observer=_Ears(self),
            origin=self._origin,
            resources=circumstances.resources,
            task=circumstances.id,
            priority=circumstances.priority,
            adopted=adopted or {},
        )
        return self.run

    # --- waiting, states, the end -----------------------------------------------------------------

    async def _settle(self) -> None:
        """Wait until it is known whether that is violated which looks violated now."""
        if self.supervision.doubtful > 0:
            await self._wait(self.supervision.doubtful)
            self.supervision.look()

    async def _wait(self, seconds: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._is_over.wait()

    async def _until(self, happens: Awaitable[object]) -> None:
        """Wait for something, or until the task is over."""
        waiting = asyncio.ensure_future(happens), asyncio.ensure_future(self._is_over.wait())
        try:
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for one in waiting:
                one.cancel()

    def _now(self, world: KnowledgeBase | None = None) -> Problem:
        return self.supervision.now(world or self.knowledge.world)

    def _missing(self) -> tuple[Constraint, ...]:
        return self.supervision.monitor.missing(self.supervision.elapsed)

    def _enter(self, state: TaskState, why: str = "") -> None:
        if self.is_paused and state in (TaskState.RUNNING, TaskState.PLANNING):
            return
        if (state, why) != (self.state, self.why):
            self.state, self.why = state, why
            self.observer.entered(state, why)

    def _last_failure(self) -> str:
        if not self.episodes:
            return ""
        result, missing = self.episodes[-1].result, self._missing()
        failure = "" if result.goal else f"; last failure: {result.reason}"
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        return failure + (f"; not fulfilled: {', '.join(map(str, missing[:3]))}{more}" if missing else "")

    def _ended(self, code: Code, reason: str) -> TaskResult:
        self.search.reserved = None
        self._enter(TaskState.OVER, reason)
        monitor, now = self.supervision.monitor, self.supervision.elapsed
        return TaskResult(
            code,
            reason,
            self.plans,
            tuple(self.episodes),
            self.seconds.seconds,
            self.supervision.began,
            monitor.constraint_results(now),
            monitor.preference_results(now),
        )


class _Ears(Observer):
    """Passes on what a run tells, and raises the alarm when something has failed."""

    def __init__(self, pursuit: Pursuit) -> None:
        self._pursuit = pursuit
        self._observer = pursuit.observer

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        self._observer.fired(transition, rule, now)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self._observer.sent(call, request, now)

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        self._observer.ended(call, outcome, now)

    def failed(self, failure: Failure, now: float) -> None:
        self._observer.failed(failure, now)
        self._pursuit._trouble.set()

    def orphaned(self, report: Report, now: float) -> None:
        self._observer.orphaned(report, now)


def _no_plan(found: PlanningResult, forbidden: frozenset[ForbiddenCall]) -> str:
    without = f" without {', '.join(sorted(map(str, forbidden)))}, which failed too often" if forbidden else ""
    return f"no plan{without}: {found.reason}"
