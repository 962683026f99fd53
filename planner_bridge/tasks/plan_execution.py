"""A plan being carried out by runs that follow each other while calls are under way.

When others shall continue after a failure, or when a change of facts has made the rest of the plan impossible or needless, another
plan is made for the world as it will be after what is under way; those calls become calls of the next machine.

From a plan to a run of its machine, which is proved first.

Which changes of facts a plan should be looked at for.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from enum import Enum, auto
from typing import assert_never

from planner_bridge.model.plan_simulation import Unforeseeable
from planner_bridge.ordering.interference import Footprint, footprint
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.tasks.constraint_monitor import Supervision
from planner_bridge.tasks.context import Mission
from planner_bridge.tasks.control import Over, Standing
from planner_bridge.tasks.plan_search import Finding
from planner_bridge.tasks.replanning import GiveUp, History, Progress, Resume, decide, rest_of, shortened, times_that_matter, why_not
from planner_bridge.tasks.settings import OnChange
from planner_bridge.tasks.task_history import Chronicle, Way
from pnm.core.execution.call_results import Failure, RunResult
from pnm.core.execution.events import Observer
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.run import Run
from pnm.core.logic.conditions import names
from pnm.core.logic.effects import names_written, possible_assignments
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Constant, Fluent, State, Unknown, Value
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import CallOutcome, OnFailure, Rule
from pnm.core.machine.plan_graph import ActionCall, PlanGraph, PlanGraphError
from pnm.core.machine.requests import Outcome, Report, Request
from pnm.core.machine.verification.explore import Unsound
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from pnm.tasks import TaskState


def make_run(graph: PlanGraph, mission: Mission, alarm: Callable[[], None], origin: float, adopted: Mapping[int, UnderWay]) -> Run:
    """Return a run of the plan.

    Args:
        graph: the plan.
        mission: what it is for.
        alarm: is called when something fails.
        origin: the time from which the plan's times count.
        adopted: for every call that is under way, the request that the run takes over.

    Raises:
        Unsound: the plan cannot be carried out.
    """
    with mission.seconds.of("translate"):
        settings, capacities = mission.settings, mission.circumstances.resources.capacities
        machine = generate(graph, settings.bindings, on_failure=settings.on_failure, capacities=capacities)
    with mission.seconds.of("verify"):
        proof = verify(machine)
    mission.observer.generated(machine, proof)
    circumstances = mission.circumstances
    return Run(
        machine,
        mission.knowledge,
        id=circumstances.new_identity(),
        bindings=mission.settings.bindings,
        goal_fields=mission.site.client.goal_fields,
        asks=circumstances.source is not None,
        observer=_Alarmed(mission.observer, alarm),
        origin=origin,
        resources=circumstances.resources,
        task=circumstances.id,
        priority=circumstances.priority,
        adopted=adopted,
    )


class _Alarmed(Observer):
    """Passes on what a run tells, and raises the alarm when something has failed."""

    def __init__(self, observer: Observer, alarm: Callable[[], None]) -> None:
        self._observer = observer
        self._alarm = alarm

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        self._observer.fired(transition, rule, now)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self._observer.sent(call, request, now)

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        self._observer.ended(call, outcome, now)

    def failed(self, failure: Failure, now: float) -> None:
        self._observer.failed(failure, now)
        self._alarm()

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        self._observer.withheld(call, names, now)

    def waiting(self, is_so: bool, now: float) -> None:
        self._observer.waiting(is_so, now)

    def orphaned(self, report: Report, now: float) -> None:
        self._observer.orphaned(report, now)


def is_relevant(progress: Progress, changed: Mapping[Fluent, object]) -> bool:
    """Tell whether what has changed is read or written by the rest of the plan, or by its goal."""
    mentioned = set(progress.plan.rules.base(names(progress.plan.goal)))
    for call in progress.rest:
        mentioned |= progress.plan.rules.base(_reads(call)) | _writes(call)
    return any(fluent[0] in mentioned for fluent in changed)


def is_foreseen(progress: Progress, changed: Mapping[Fluent, Value | Unknown], state: State) -> bool:
    """Tell whether calls that have begun are what makes these changes: each to what one of them writes, or a number it computes."""
    mentioned = {fluent[0] for fluent in changed}
    begun = [one.call for one in progress.calls if one.kind is not CallOutcome.WAITING and _writes(one.call) & mentioned]
    written: dict[Fluent, list[Value | None]] = {}
    for call in begun:
        for fluent, effect, _ in possible_assignments((*call.action.start_effects, *call.action.end_effects), state):
            written.setdefault(fluent, []).append(effect.value.value if isinstance(effect.value, Constant) else None)
    return all(value in written.get(fluent, ()) or None in written.get(fluent, ()) for fluent, value in changed.items())


def _reads(call: ActionCall) -> frozenset[str]:
    action = call.action
    return names(action.precondition) | names(action.invariant) | names(action.end_condition)


def _writes(call: ActionCall) -> frozenset[str]:
    return names_written((*call.action.start_effects, *call.action.end_effects))


class _Advice(Enum):
    """What to do about a run that may not lead to the goal any more."""

    GO_ON = auto()
    """It still does."""
    FINISH = auto()
    """The goal holds already: start nothing more."""
    END_FIRST = auto()
    """What follows is decided when it has come to its end."""
    LOOK = auto()
    """Look for another way while calls are under way."""
    MAKE_ROOM = auto()
    """Others have begun with what it is in conflict with: start nothing more, and see then what can go on beside them."""


class Relay:
    """The runs of one plan, and of those that follow it while calls are under way.

    The mutable state is the executor, which has the current run; whether there is trouble; whether another way is being
    looked for, during which the run starts nothing; and whether there is no room for the rest of the plan.

    Args:
        graph: the plan to begin with.
        mission: what it is for.
        standing: whether the task is paused or is to end.
        supervision: what of the problem is left.
        finding: finds other plans.
        chronicle: what has happened before.

    Raises:
        Unsound: the plan cannot be carried out.
    """

    def __init__(
        self, graph: PlanGraph, mission: Mission, standing: Standing, supervision: Supervision, finding: Finding, chronicle: Chronicle
    ) -> None:
        self._mission = mission
        self._standing = standing
        self._supervision = supervision
        self._finding = finding
        self._chronicle = chronicle
        circumstances = mission.circumstances
        self._trouble = asyncio.Event()
        self._is_looking = False
        self.lacks_room = False
        """Whether others have begun, during a pause, with what the rest of the plan is in conflict with; its run ends then, even
        if they are over before it is."""
        self.executor = Executor(self._run(graph), mission.site.client, circumstances.source, circumstances.name)

    @property
    def run(self) -> Run:
        """The current run."""
        return self.executor.run

    @property
    def progress(self) -> Progress:
        """How far the current plan has come."""
        calls = self.run.interim_result().calls
        return Progress(self.run.machine.plan, calls, frozenset(one.call.index for one in calls if one.is_under_way))

    @property
    def footprint(self) -> Footprint:
        """What the rest of the current plan needs and changes."""
        progress = self.progress
        return footprint(progress.rest, progress.plan.goal, self._mission.world)

    async def carry_out(self) -> tuple[RunResult, Way | None]:
        """Go on until a run has come to its end; return how it ended, and what was decided to follow it if that is known."""
        if self._standing.stopped:  # while the machine was being prepared
            self.executor.stop(reason=self._standing.stopped.reason)
        if self._standing.is_paused:
            self.executor.pause(at_once=False)
        way: Way | None = None
        execution = asyncio.ensure_future(self.executor.execute())
        try:
            while await self._is_troubled(execution):
                way = await self._another_way(execution)
                if way and await self._at_rest(execution) and not self._follow(way):
                    way = None
                self._end_look()
            return await execution, way
        except asyncio.CancelledError:  # whoever has said so before wants everything to be left as it is
            execution.cancel()
            raise
        except BaseException:  # an error: nothing of it may go on by itself
            self.executor.stop(reason="an error has occurred")
            await execution
            raise

    # --- from outside ---------------------------------------------------------------------------

    def stop(self, reason: str) -> None:
        """Start nothing more, and cancel what is under way."""
        self.executor.stop(reason=reason)

    def go_on(self) -> None:
        """Go on after a pause; if the plan does not work any more, or is in the way of others, look for another way first."""
        if self._mission.circumstances.neighbours.newcomers(lambda: self.footprint):
            self.lacks_room = True
        if self.lacks_room or (self._is_eager and self._obstacle(self.progress)):
            self._trouble.set()
        elif not self._is_looking:
            self.executor.resume()

    def changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        """Look at the plan when facts change otherwise than its calls change them."""
        if not self._is_eager or self._standing.is_paused:
            return
        progress = self.progress
        if is_relevant(progress, changes) and not is_foreseen(progress, changes, self._mission.knowledge):
            self._trouble.set()

    @property
    def _is_eager(self) -> bool:
        return self._mission.settings.on_change is OnChange.EAGER

    # --- another way while calls are under way --------------------------------------------------

    async def _is_troubled(self, execution: asyncio.Future[RunResult]) -> bool:
        """Wait until something is to be done about the run; tell whether it is still going on then."""
        trouble = asyncio.ensure_future(self._trouble.wait())
        try:
            await asyncio.wait((execution, trouble), return_when=asyncio.FIRST_COMPLETED)
        finally:
            trouble.cancel()
        self._trouble.clear()
        return not self.executor.ended

    def _advice(self) -> _Advice:
        progress, has_failed = self.progress, bool(self.run.interim_result().failures)
        if self._standing.stopped or self._standing.is_paused:
            return _Advice.END_FIRST
        if self.lacks_room:
            return _Advice.MAKE_ROOM
        if self._matters_when():
            return _Advice.END_FIRST
        if has_failed:
            return _Advice.LOOK if self._mission.settings.on_failure is OnFailure.CONTINUE_OTHERS else _Advice.END_FIRST
        if evaluate(self._mission.problem.goal, self._mission.knowledge) is True and not self._waits_for_more(progress):
            return _Advice.FINISH
        if not self._obstacle(progress) and shortened(progress, self._mission.world) == progress:
            return _Advice.GO_ON
        return _Advice.LOOK

    async def _another_way(self, execution: asyncio.Future[RunResult]) -> Way | None:
        """Decide what is to follow the run before it is over; None when it has to come to its end first, or may go on."""
        advice = self._advice()
        match advice:
            case _Advice.FINISH:
                self.executor.stop(cancel=False, reason="the goal holds already")
            case _Advice.MAKE_ROOM:
                self.executor.stop(cancel=False, reason="others have begun with what it is in conflict with")
            case _Advice.GO_ON | _Advice.END_FIRST:
                if not self._standing.is_paused:  # any more
                    self.executor.resume()
            case _Advice.LOOK:
                self._is_looking = True
                self.executor.pause(at_once=False)
                return await self._look(execution)
            case _:
                assert_never(advice)
        return None

    def _end_look(self) -> None:
        if self._is_looking:
            self._is_looking = False
            if not self._standing.is_paused:
                self.executor.resume()

    async def _look(self, execution: asyncio.Future[RunResult]) -> Way | None:
        if not await self._at_rest(execution):
            return None
        told = self.run.interim_result()
        mission, history = self._mission, self._chronicle.history
        history = history.after(told.calls, told.failures) if told.failures else history.changed()
        left = self._left(self.progress)
        decision = decide(self._supervision.now(), left, mission.world, history, mission.settings.limits, mission.kept(history))
        match decision:
            case GiveUp():
                return None
            case Resume():
                self._mission.observer.replanning(decision, told)
                return Way(decision, history)
        self._mission.observer.replanning(decision, told)
        self._standing.enter(TaskState.REPLANNING, decision.why)
        try:
            plan, _ = await self._finding.look(decision.forbidden, tuple(self.run.under_way()))
        except (Over, Unforeseeable, PlanGraphError):
            return None
        finally:
            self._standing.enter(TaskState.RUNNING)
        if plan is None:
            return None
        self._finding.accept(plan)
        return Way(decision, history, plan)

    def _follow(self, way: Way) -> bool:
        """Put another machine in the place of the one that goes on; tell whether its plan still works."""
        under_way = {one.call.index: one for one in self.run.under_way()}
        try:
            graph = self._graph(way, under_way)
            if self._why_not(Progress.beginning(graph), way.history):
                return False
            numbers = (call.index for call in graph.calls if call.under_way)  # in both kinds of graphs they come in their old order
            run = self._run(graph, dict(zip(numbers, (under_way[index] for index in sorted(under_way)), strict=True)))
        except (PlanGraphError, Unsound):  # what is under way does not fit into it
            return False
        self._chronicle.follow(way, self.run.machine, self.run.interim_result())
        self.executor.succeed(run)
        return True

    def _graph(self, way: Way, under_way: Mapping[int, UnderWay]) -> PlanGraph:
        now = self._supervision.now()
        if way.plan is not None:
            return plan_graph(now, way.plan, [one.call for one in under_way.values()])
        progress = Progress(self.run.machine.plan, self.run.interim_result().calls, frozenset(under_way))
        return rest_of(now, self._left(progress))

    async def _at_rest(self, execution: asyncio.Future[RunResult]) -> bool:
        """Wait until everything that is under way can be handed over; tell whether the run is still going on then."""
        while not self.executor.ended:
            is_settled = all(one.kind is not CallOutcome.RUNNING for one in self.run.interim_result().calls)
            if is_settled and set(self.run.open_requests) == {one.request for one in self.run.under_way()}:
                return True
            await self.executor.happens()
        return False

    def _matters_when(self) -> bool:
        return bool(times_that_matter(self._mission.problem) or self._mission.problem.network)

    def _left(self, progress: Progress) -> Progress:
        """Return what there is still to be done; a failure makes nothing needless, but facts that have changed may."""
        return progress if self.run.interim_result().failures else shortened(progress, self._mission.world)

    def _obstacle(self, progress: Progress) -> str:
        return self._why_not(progress, self._chronicle.history)

    def _why_not(self, progress: Progress, history: History) -> str:
        return self._supervision.why_not(progress, self._mission.forbidden(history))

    def _waits_for_more(self, progress: Progress) -> bool:
        """Tell whether calls that are under way will undo the goal, or constraints ask for more."""
        return bool(why_not(progress.what_goes_on, self._mission.world) or self._supervision.missing)

    def _run(self, graph: PlanGraph, adopted: Mapping[int, UnderWay] | None = None) -> Run:
        return make_run(graph, self._mission, self._trouble.set, self._finding.origin, adopted or {})
