"""Watches the constraints and preferences of a problem while its goal is pursued, and says what became of them.

Has no clock: whoever asks says how many seconds after the start of the task it is.

What is watched while a goal is pursued: how long it takes, what time itself changes, and the constraints of the problem.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from math import inf
from typing import Final

from planner_bridge.model.forbidden_actions import ForbiddenCall
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.replanning import Progress, why_not
from planner_bridge.tasks.result import ConstraintResult, PreferenceResult, Violation
from planner_bridge.tasks.settings import TaskObserver
from pnm.actions.backend import schedule
from pnm.clock import TimeLimit
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import NOTHING, Environment, choices
from pnm.core.logic.trajectory import Constraint, ConstraintProgress, instances, is_fulfilled, names_in, observed_of, shifted
from pnm.tasks import Code

SETTLING: Final = 0.01
"""Seconds within which everything that happens at one moment is known, even what nothing reports."""


@dataclass(slots=True)
class _Watched:
    """A ground constraint; what is known of it changes."""

    constraint: Constraint
    names: frozenset[str]
    """The predicates and functions it mentions."""
    watch: ConstraintProgress
    violation: Violation | None = None

    @property
    def untouched(self) -> bool:
        """Whether all of it is left. (Whether its one time has begun, the present state says as well.)"""
        return tuple(replace(one, begun=False) for one in self.watch.rest) == (self.constraint,)


class Monitor:
    """Watches over every choice of objects for the variables of constraints and preferences.

    A preference has an instance for every choice for its own variables, with all the ground constraints
    it then stands for; a wish for the goal is one for what holds at the end. The mutable state is what
    is known of the ground constraints, and whether there was a look yet.
    """

    def __init__(self, problem: Problem, knowledge: Layered) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._constraints = [(one, self._instance(one)) for one in (*problem.domain.constraints, *problem.constraints)]
        self._preferences = [(one, self._instances(one)) for one in (*problem.domain.preferences, *problem.preferences)]
        self._looked = False

    def _instance(self, constraint: Constraint, env: Environment = NOTHING) -> list[_Watched]:
        return [_Watched(one, names_in(one), ConstraintProgress((one,))) for one in instances(constraint, self._knowledge, env)]

    def _instances(self, preference: Preference) -> list[list[_Watched]]:
        wanted = preference.wanted
        constraints = wanted if isinstance(wanted, tuple) else (Constraint("at end", (wanted,)),)
        chosen = choices(preference.variables, self._knowledge, NOTHING)
        return [[watched for one in constraints for watched in self._instance(one, env)] for env in chosen]

    def _hard(self) -> Iterator[_Watched]:
        return (watched for _, instance in self._constraints for watched in instance)

    def _soft(self) -> Iterator[_Watched]:
        return (watched for _, instances in self._preferences for instance in instances for watched in instance)

    def _all(self) -> Iterator[_Watched]:
        return chain(self._hard(), self._soft())

    @property
    def idle(self) -> bool:
        """Whether there is nothing to watch."""
        return not (self._constraints or self._preferences)

    # --- while the task goes on ----------------------------------------------------------------

    def look(self, now: float) -> tuple[Violation, ...]:
        """Look at what is known now; return the constraints that turn out to be violated, preferences left out."""
        self._looked = True
        for watched in self._soft():
            self._see(watched, now)
        return tuple(violation for watched in self._hard() if (violation := self._see(watched, now)))

    def _see(self, watched: _Watched, now: float) -> Violation | None:
        """Return the violation if this look finds it."""
        before = watched.watch
        watched.watch = before.seen(self._knowledge, now, self._lag(watched))
        if before.violated or not watched.watch.violated:
            return None
        time = now if before.doubtful_since is None else before.doubtful_since
        watched.violation = Violation(watched.constraint, time, observed_of(watched.constraint, self._knowledge))
        return watched.violation

    def _lag(self, watched: _Watched) -> float:
        return max(SETTLING, self._knowledge.world.lag(watched.names))

    def next_look(self, now: float) -> float:
        """Return when to look again even if nothing changes; infinity if that is not needed."""
        return min((one.watch.next_look(now, self._lag(one)) for one in self._all()), default=inf)

    def doubtful_until(self) -> float:
        """Return when, at the latest, it will be known of everything that looks violated now whether it is; 0 if nothing does."""
        return max((one.watch.doubtful_since + self._lag(one) for one in self._all() if one.watch.doubtful_since is not None), default=0.0)

    def missing(self, now: float) -> tuple[Constraint, ...]:
        """Return the ground constraints that would not be kept if the task ended now."""
        return tuple(one.constraint for one in self._hard() if not is_fulfilled(one.watch.rest, self._knowledge, now))

    def rest_of(self, problem: Problem, now: float) -> Problem:
        """Return the problem from the world as it is with those constraints and preferences that are left."""
        if self.idle:
            return problem
        constraints = [left for one in self._constraints for left in self._constraint_left(*one, now)]
        preferences = [left for one in self._preferences for left in self._preference_left(*one, now)]
        domain = replace(problem.domain, constraints=(), preferences=())
        return replace(problem, domain=domain, constraints=tuple(constraints), preferences=tuple(preferences))

    def _constraint_left(self, constraint: Constraint, instance: list[_Watched], now: float) -> Iterable[Constraint]:
        if all(one.untouched for one in instance):
            return (shifted(constraint, now),)
        return _left(instance, now)

    def _preference_left(self, preference: Preference, instances: list[list[_Watched]], now: float) -> Iterable[Preference]:
        if not isinstance(preference.wanted, tuple):
            return (preference,)
        if all(one.untouched for instance in instances for one in instance):
            return (replace(preference, wanted=tuple(shifted(one, now) for one in preference.wanted)),)
        return [Preference(preference.name, _left(instance, now)) for instance in instances]  # fulfilled ones too: metrics name them

    # --- at its end ----------------------------------------------------------------------------

    def constraint_results(self, now: float) -> tuple[ConstraintResult, ...]:
        """Return what became of every constraint if the task ends now."""
        return tuple(self._constraint_result(*one, now) for one in self._constraints)

    def _constraint_result(self, constraint: Constraint, instance: list[_Watched], now: float) -> ConstraintResult:
        if not self._looked:
            return ConstraintResult(constraint, "not monitored")
        found = tuple(violation for one in instance if (violation := self._violation(one, now)))
        return ConstraintResult(constraint, "violated" if found else "fulfilled", found)

    def _violation(self, watched: _Watched, now: float) -> Violation | None:
        if watched.violation or is_fulfilled(watched.watch.rest, self._knowledge, now):
            return watched.violation
        return Violation(watched.constraint, now, observed_of(watched.constraint, self._knowledge))

    def preference_results(self, now: float) -> tuple[PreferenceResult, ...]:
        """Return what became of the preferences of every name if the task ends now; those of actions are not monitored."""
        names = dict.fromkeys(preference.name for preference, _ in self._preferences)
        of_actions = dict.fromkeys(one.name for schema in self._problem.domain.actions.values() for one in schema.preferences)
        if not self._looked:
            return tuple(PreferenceResult(name, "not monitored") for name in names | of_actions)
        return (
            *(self._preference_result(name, now) for name in names),
            *(PreferenceResult(name, "not monitored") for name in of_actions),
        )

    def _preference_result(self, name: str, now: float) -> PreferenceResult:
        found = (instance for preference, instances in self._preferences if preference.name == name for instance in instances)
        violated = sum(any(self._violation(one, now) for one in instance) for instance in found)
        return PreferenceResult(name, "violated" if violated else "fulfilled", violated)


def _left(instance: list[_Watched], now: float) -> tuple[Constraint, ...]:
    return tuple(shifted(left, now) for one in instance for left in one.watch.rest)


class Supervision:
    """The clock and the monitor of one task.

    The mutable state is what stands below "state".

    Args:
        problem: what is pursued.
        knowledge: what is known.
        observer: is told when a constraint is violated.
        stop: ends the task.
        allowed: seconds that it may take, pauses left out.
    """

    def __init__(
        self, problem: Problem, knowledge: Layered, observer: TaskObserver, stop: Callable[[Code, str], None], allowed: float
    ) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._observer = observer
        self._stop = stop
        self.monitor = Monitor(problem, knowledge)
        # state
        self.began = 0.0
        self.limit = TimeLimit(allowed, self._exceeded)
        """The seconds that the task may take; those of pauses are not its own."""
        self._next_look: asyncio.TimerHandle | None = None

    def begin(self, at_the_end: ExitStack) -> None:
        """Begin; let those timed facts come true by themselves that nobody reports; look whenever something changes or a time comes."""
        self.began = asyncio.get_running_loop().time()
        world = self._knowledge.world
        at_the_end.callback(schedule(world, self._problem.timed, self.began))
        at_the_end.callback(self._end_looking)
        at_the_end.callback(world.listen(self.look))
        at_the_end.callback(self.limit.close)
        self.limit.begin()
        self.look()

    @property
    def elapsed(self) -> float:
        """How many seconds the task has taken so far."""
        return asyncio.get_running_loop().time() - self.began

    def look(self, _changes: object = None) -> None:
        """Look for violated constraints, and note when to look again."""
        now = self.elapsed
        for violation in self.monitor.look(now):
            self._observer.violated(violation, asyncio.get_running_loop().time())
            self._stop(Code.CONSTRAINT_VIOLATED, str(violation))
        if self._next_look:
            self._next_look.cancel()
        time = self.monitor.next_look(now)
        self._next_look = None if time == inf else asyncio.get_running_loop().call_at(self.began + time, self.look)

    @property
    def doubtful(self) -> float:
        """How many seconds it will take until it is known whether that is violated which looks violated now."""
        return self.monitor.doubtful_until() - self.elapsed

    def now(self, world: KnowledgeBase | None = None) -> Problem:
        """Return the problem that is left, from this world, or the one that is known."""
        elapsed = self.elapsed
        return self.monitor.rest_of(problem_now(self._problem, world or self._knowledge.world, elapsed), elapsed)

    @property
    def missing(self) -> tuple[Constraint, ...]:
        """The constraints that are not fulfilled yet."""
        return self.monitor.missing(self.elapsed)

    def why_not(self, progress: Progress, forbidden: frozenset[ForbiddenCall]) -> str:
        """Say why the rest of a plan does not lead from here to its goal; empty when it does."""
        left = self.monitor.rest_of(self._problem, self.elapsed)
        return why_not(progress, self._knowledge.world, forbidden, (*left.domain.constraints, *left.constraints))

    def _exceeded(self, seconds: float) -> None:
        self._stop(Code.TIMED_OUT, f"the limit of {seconds:g} s is reached")

    def _end_looking(self) -> None:
        if self._next_look:
            self._next_look.cancel()
