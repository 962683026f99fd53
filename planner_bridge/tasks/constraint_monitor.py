"""Monitoring of a task: its trajectory constraints and preferences, the facts that change by themselves, and its time limit."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from heapq import heappop, heappush
from math import inf
from typing import Final

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.guards import ForbiddenCall
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from planner_bridge.tasks.context import TaskContext
from planner_bridge.tasks.replanning import Progress, why_not
from planner_bridge.tasks.result import ConstraintResult, PreferenceResult, TrajectoryNote, Violation, notes_of
from pnm.actions.backend import schedule
from pnm.actions.prediction import Prediction
from pnm.clock import TimeLimit
from pnm.core.knowledge_base import KnowledgeBase, Layered, Readers
from pnm.core.logic.conditions import TOLERANCE, All
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import NOTHING, Environment, OnlyObjects, choices
from pnm.core.logic.rules import read_by
from pnm.core.logic.trajectory import Constraint, ConstraintProgress, instances, is_fulfilled, names_in, observed_of, shifted
from pnm.core.nature import Nature
from pnm.journal.replay import ReplayedTask
from pnm.tasks import Code

SETTLING: Final = 0.01
"""Seconds within which everything that happens at one moment is known, even what nothing reports."""


@dataclass(slots=True)
class _MonitoredConstraint:
    """A ground constraint; what is known of it changes."""

    constraint: Constraint
    names: frozenset[str]
    """The predicates and functions it mentions."""
    progress: ConstraintProgress
    violation: Violation | None = None

    @property
    def untouched(self) -> bool:
        """Whether all of it is left. (Whether its one time has begun, the present state says as well.)"""
        return tuple(replace(rest, begun=False) for rest in self.progress.rest) == (self.constraint,)


class ConstraintMonitor:
    """Monitors every instance of the constraints and preferences of a problem; it has no clock.

    A preference has an instance for every choice for its own variables, with all the ground constraints
    it then stands for; a wish for the goal is one for what holds at the end. A look is at those ground constraints alone whose
    conditions read what has changed, or whose time has come: of any other, nothing else would be known after it.

    The mutable state is what is known of the ground constraints, and what stands below "state".
    """

    def __init__(self, problem: Problem, knowledge: Layered) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._objects = OnlyObjects(problem.objects_by_type)  # also for a process that goes on: those that are found come besides
        self._constraints = [(constraint, self._instance(constraint)) for constraint in (*problem.domain.constraints, *problem.constraints)]
        self._preferences: list[tuple[Preference, list[list[_MonitoredConstraint]]]] = []
        for preference in (*problem.domain.preferences, *problem.preferences):
            wanted = preference.wanted
            constraints = wanted if isinstance(wanted, tuple) else (Constraint("at end", (wanted,)),)
            chosen = choices(preference.variables, self._objects, NOTHING)
            ground = [[watched for constraint in constraints for watched in self._instance(constraint, env)] for env in chosen]
            self._preferences.append((preference, ground))
        self._hard = [watched for _, instance in self._constraints for watched in instance]
        self._soft = [watched for _, ground in self._preferences for instance in ground for watched in instance]
        self._ground = (*self._hard, *self._soft)
        self._readers = Readers[int]()
        """Ground constraints, by position, and what their conditions read."""
        self._rules = knowledge.world.rules
        for position, watched in enumerate(self._ground):
            # what is to hold during a time is over at its end, at which nobody has to look
            is_over = watched.constraint.operator == "hold-during"
            self._readers.add(position, None if is_over else read_by(All(watched.constraint.conditions), self._rules))
        # state
        self._looked = False
        self._changes: int | None = None
        """The number of changes of the world at the last look; None if all have to be looked at."""
        self._times: dict[int, float] = {}
        """For ground constraints by position, when to look at them again even if nothing changes."""
        self._queue: list[tuple[float, int]] = []
        """These times in order, with some that do not count any more."""
        self.has_news = True
        """Whether something else is known since the last note."""

    def _instance(self, constraint: Constraint, env: Environment = NOTHING) -> list[_MonitoredConstraint]:
        return [
            _MonitoredConstraint(ground, names_in(ground), ConstraintProgress((ground,)))
            for ground in instances(constraint, self._objects, env)
        ]

    @property
    def note(self) -> tuple[tuple[ConstraintProgress, ...], dict[int, Violation]]:
        """The state of the ground constraints, in their order, and the violations of some, by position."""
        self.has_news = False
        violations = {position: watched.violation for position, watched in enumerate(self._ground) if watched.violation}
        return tuple(watched.progress for watched in self._ground), violations

    def restore(self, note: TrajectoryNote) -> None:
        """Go on with what another process knew; the problem is the same."""
        self._changes, self.has_news = None, False
        for position, (watched, progress) in enumerate(zip(self._ground, note.progress, strict=True)):
            watched.progress, watched.violation = progress, note.violations.get(position)

    @property
    def violations(self) -> tuple[Violation, ...]:
        """The violations of constraints so far, preferences left out."""
        return tuple(watched.violation for watched in self._hard if watched.violation)

    @property
    def idle(self) -> bool:
        """Whether there is nothing to watch."""
        return not (self._constraints or self._preferences)

    def look(self, now: float) -> tuple[Violation, ...]:
        """Look at what is known now; return the constraints that turn out to be violated, preferences left out."""
        self._looked = True
        violations: list[Violation] = []
        for position in self._to_see(now):
            watched = self._ground[position]
            before, lag = watched.progress, self._lag(watched)
            after = before.seen(self._knowledge, now, lag)
            if after != before:
                watched.progress, self.has_news = after, True
            if self._times.get(position) != (time := after.next_look(now, lag)):
                self._times[position] = time
                if time < inf:
                    heappush(self._queue, (time, position))
            if after.violated and not before.violated:
                time = now if before.doubtful_since is None else before.doubtful_since
                watched.violation = Violation(watched.constraint, time, observed_of(watched.constraint, self._knowledge))
                if position < len(self._hard):
                    violations.append(watched.violation)
        return tuple(violations)

    def _to_see(self, now: float) -> Iterable[int]:
        """Return the ground constraints of which something else may be known by now."""
        world, before = self._knowledge.world, self._changes
        changed = None if before is None or world.rules is not self._rules else world.changed_since(before)
        self._changes = world.changes
        if changed is None:
            return range(len(self._ground))
        concerned = self._readers.concerned(changed)
        while self._queue and self._queue[0][0] <= now + TOLERANCE:
            _, position = heappop(self._queue)
            self._times.pop(position, None)
            concerned.add(position)
        return sorted(concerned)

    def _lag(self, watched: _MonitoredConstraint) -> float:
        return max(SETTLING, self._knowledge.world.lag(watched.names))

    def next_look(self) -> float:
        """Return when to look again even if nothing changes; infinity if that is not needed."""
        while self._queue and self._times.get(self._queue[0][1]) != self._queue[0][0]:
            heappop(self._queue)
        return self._queue[0][0] if self._queue else inf

    def doubtful_until(self) -> float:
        """Return when, at the latest, it will be known of everything that looks violated now whether it is; 0 if nothing does."""
        since = ((watched, watched.progress.doubtful_since) for watched in self._ground)
        return max((doubtful + self._lag(watched) for watched, doubtful in since if doubtful is not None), default=0.0)

    def missing(self, now: float) -> tuple[Constraint, ...]:
        """Return the ground constraints that would not be kept if the task ended now."""
        return tuple(watched.constraint for watched in self._hard if not is_fulfilled(watched.progress.rest, self._knowledge, now))

    def rest_of(self, problem: Problem, now: float) -> Problem:
        """Return the problem from the world as it is with those constraints and preferences that are left."""
        if self.idle:
            return problem
        constraints: list[Constraint] = []
        for constraint, instance in self._constraints:
            constraints += (shifted(constraint, now),) if all(watched.untouched for watched in instance) else _left(instance, now)
        preferences: list[Preference] = []
        for preference, ground in self._preferences:
            if not isinstance(preference.wanted, tuple):
                preferences.append(preference)
            elif all(watched.untouched for instance in ground for watched in instance):
                preferences.append(replace(preference, wanted=tuple(shifted(constraint, now) for constraint in preference.wanted)))
            else:  # fulfilled ones too: metrics name them
                preferences += (Preference(preference.name, _left(instance, now)) for instance in ground)
        return replace(problem, domain=_unconstrained(problem.domain), constraints=tuple(constraints), preferences=tuple(preferences))

    def constraint_results(self, now: float) -> tuple[ConstraintResult, ...]:
        """Return the result of every constraint if the task ends now."""
        if not self._looked:
            return tuple(ConstraintResult(constraint, "not monitored") for constraint, _ in self._constraints)
        results: list[ConstraintResult] = []
        for constraint, instance in self._constraints:
            violations = tuple(violation for watched in instance if (violation := self._violation(watched, now)))
            results.append(ConstraintResult(constraint, "violated" if violations else "fulfilled", violations))
        return tuple(results)

    def _violation(self, watched: _MonitoredConstraint, now: float) -> Violation | None:
        if watched.violation or is_fulfilled(watched.progress.rest, self._knowledge, now):
            return watched.violation
        return Violation(watched.constraint, now, observed_of(watched.constraint, self._knowledge))

    def preference_results(self, now: float) -> tuple[PreferenceResult, ...]:
        """Return the results of the preferences of every name if the task ends now; those of actions are not monitored."""
        names = dict.fromkeys(preference.name for preference, _ in self._preferences)
        of_actions = dict.fromkeys(preference.name for schema in self._problem.domain.actions.values() for preference in schema.preferences)
        if not self._looked:
            return tuple(PreferenceResult(name, "not monitored") for name in names | of_actions)
        violated = dict.fromkeys(names, 0)
        for preference, ground in self._preferences:
            violated[preference.name] += sum(any(self._violation(watched, now) for watched in instance) for instance in ground)
        monitored = (PreferenceResult(name, "violated" if count else "fulfilled", count) for name, count in violated.items())
        return (*monitored, *(PreferenceResult(name, "not monitored") for name in of_actions))


@once_per_domain
def _unconstrained(domain: Domain) -> Domain:
    return replace(domain, constraints=(), preferences=())


def _left(instance: list[_MonitoredConstraint], now: float) -> tuple[Constraint, ...]:
    return tuple(shifted(left, now) for watched in instance for left in watched.progress.rest)


class TaskMonitor:
    """The clock of a task, which is stopped when its time is used up, or a constraint of its monitor is violated.

    The mutable state is what stands below "state".
    """

    def __init__(self, context: TaskContext, kept: ReplayedTask | None = None) -> None:
        self._context = context
        self._kept = kept
        self.constraints = ConstraintMonitor(context.problem, context.knowledge)
        # state
        self.began = 0.0
        self._since = 0.0
        """The time of the world in the problem of the context."""
        self.limit = TimeLimit(
            context.settings.limits.allowed(),
            lambda seconds: context.control.stop(Code.TIMED_OUT, f"the limit of {seconds:g} s is reached"),
            partial(context.runner.journal.counted, context.task.id),
        )
        """The seconds that the task may take, pauses left out."""
        self._next_look: asyncio.TimerHandle | None = None
        self.prediction: Prediction | None = None
        """Of processes and events, where there are any."""
        self._known: tuple[int, Problem] | None = None
        """The problem from the world as it was after so many changes, without its constraints."""

    def begin(self, cleanup: ExitStack) -> None:
        """Begin: schedule the timed facts that nothing reports, and look at the constraints at every change and when their time comes."""

        def end_looking() -> None:
            if self._next_look:
                self._next_look.cancel()

        self.began = now = asyncio.get_running_loop().time()
        self._since = now if self._context.since is None else self._context.since
        if self._kept and (trajectories := notes_of(self._kept, TrajectoryNote)):
            self.began = trajectories[-1].began
            self.constraints.restore(trajectories[-1])
        if self._kept and self._kept.used:
            self.limit.continue_from(self._kept.used, self._kept.replay.now)
        self._context.observer.began(self.began)
        world = self._context.world
        cleanup.callback(schedule(world, self._context.problem.timed, self._since))
        if self._context.problem.domain.nature:
            self.prediction = Prediction(Nature(self._context.problem), world)
            cleanup.callback(self.prediction.close)
        cleanup.callback(end_looking)
        if not self.constraints.idle:
            cleanup.callback(world.listen(self.look))
        cleanup.callback(self.limit.close)
        self._context.control.limit_time(self.limit)
        self.limit.begin()
        for violation in self.constraints.violations:  # which the other process has seen as the last thing
            self._context.control.stop(Code.CONSTRAINT_VIOLATED, str(violation))
        self.look()

    @property
    def elapsed(self) -> float:
        """The seconds that the task has taken so far."""
        return asyncio.get_running_loop().time() - self.began

    def look(self, _changes: object = None) -> None:
        """Look for violated constraints, and note when to look again."""
        now = self.elapsed
        for violation in self.constraints.look(now):
            self._context.observer.violated(violation, asyncio.get_running_loop().time())
            self._context.control.stop(Code.CONSTRAINT_VIOLATED, str(violation))
        if self.constraints.has_news:  # in the transaction of what was looked at: it counts for both or for none
            self._context.note(TrajectoryNote(self.began, *self.constraints.note))
        if self._next_look:
            self._next_look.cancel()
        time = self.constraints.next_look()
        self._next_look = None if time == inf else asyncio.get_running_loop().call_at(self.began + time, self.look)

    async def settle(self) -> None:
        """Wait out the report delay, so that an apparent constraint violation is confirmed or withdrawn."""
        doubtful = self.constraints.doubtful_until() - self.elapsed
        if doubtful > 0:
            await self._context.control.wait(doubtful)
            self.look()

    def now(self, world: KnowledgeBase | None = None) -> Problem:
        """Return the problem that is left, from this world, or from the present one."""
        problem, known = self._context.problem, self._context.world
        if self.prediction:
            self.prediction.bring_up_to_date()
        if (world := self._context.present if world is None else world) is not known or problem.timed:
            passed = asyncio.get_running_loop().time() - self._since
            now = problem_now(problem, world, passed)
        elif self._known and self._known[0] == known.changes:
            now = self._known[1]
        else:
            now = problem_now(problem, known)
            self._known = known.changes, now
        return self.constraints.rest_of(now, self.elapsed)

    @property
    def missing(self) -> tuple[Constraint, ...]:
        """The constraints that are not fulfilled yet."""
        return self.constraints.missing(self.elapsed)

    def why_not(self, progress: Progress, forbidden: frozenset[ForbiddenCall]) -> str:
        """Return why the rest of a plan does not lead from here to its goal; empty when it does."""
        left = self.constraints.rest_of(self._context.problem, self.elapsed)
        return why_not(progress, self._context.present, forbidden, (*left.domain.constraints, *left.constraints))
