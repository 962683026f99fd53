"""Random small plans for several tasks that share robots, and the world that they are about."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final
from uuid import UUID

from pnm.core.logic.computed_values import Layer, Literal, Operation, Query, Update
from pnm.core.logic.conditions import TRUE, Condition, Holds, Not, conjunction
from pnm.core.logic.effects import Alternative, Set
from pnm.core.logic.expressions import Constant, Fluent
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import (
    EMPTY,
    ActionCall,
    Choice,
    Flow,
    GroundAction,
    Loop,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Step,
    Then,
)

SEEN: Final = "seen"
"""The predicate of effects that a sensor reports."""
HELD: Final = "held"
"""The predicate of effects that are assumed."""
CALM: Final[Fluent] = ("calm",)
"""A fact that changes by itself."""
SERVERS: Final = ("go", "grip", "look")
SHAPES: Final = 500
"""How many different scenarios of tasks there are; what goes wrong differs for every seed."""


@dataclass(frozen=True)
class Job:
    """A task, and the plan that it is."""

    task: UUID
    run: UUID
    plan: PlanGraph
    priority: int
    on_failure: OnFailure


@dataclass(frozen=True)
class Scenario:
    """Tasks, and what they share."""

    jobs: tuple[Job, ...]
    bindings: Bindings
    capacities: Mapping[str, int]

    def job(self, task: UUID) -> Job:
        """Return the job of a task."""
        return next(job for job in self.jobs if job.task == task)

    @property
    def sensed(self) -> tuple[str, ...]:
        """The predicates that sensors report."""
        return SEEN, CALM[0]


@lru_cache(maxsize=SHAPES)
def scenario(number: int) -> Scenario:
    """Return the scenario of a number."""
    rng = random.Random(number)
    capacities = {"arm": rng.choice([1, 1, 2])}
    bindings = Bindings(
        {name: Binding(accept=3.0, cancel=2.0, timeout=rng.choice([5.0, 8.0]), retries=rng.choice([0, 1, 1, 2])) for name in SERVERS},
        assumed=frozenset({HELD}),
        lag=0.5,
    )
    jobs = tuple(_job(rng, position, capacities) for position in range(rng.choice([1, 1, 2, 3])))
    return Scenario(jobs, bindings, capacities)


def _job(rng: random.Random, position: int, capacities: Mapping[str, int]) -> Job:
    seed = rng.random()
    count = sum(1 for _ in _Drawing(random.Random(seed), f"t{position}", 0).calls())
    drawn = _Drawing(random.Random(seed), f"t{position}", count)
    steps, orderings = drawn.steps()
    goal = conjunction(Holds(fluent) for fluent in drawn.wanted)
    plan = PlanGraph(steps, orderings, goal, capacities=capacities)
    on_failure = rng.choice([OnFailure.DRAIN, OnFailure.CANCEL])
    return Job(UUID(int=position + 1), UUID(int=position + 101), plan, rng.choice([0, 0, 1]), on_failure)


@dataclass
class _Drawing:
    """Draws a plan; `others` is the number of its first step that is no call, which is known once it was drawn before."""

    rng: random.Random
    task: str
    others: int
    number: int = 0

    def __post_init__(self) -> None:
        self.wanted: list[Fluent] = []

    def calls(self) -> Iterator[int]:
        self.steps()
        return iter(range(self.number))

    def steps(self) -> tuple[tuple[Step, ...], tuple[Ordering, ...]]:
        rng = self.rng
        steps = tuple(self._step() for _ in range(rng.choice([1, 2, 2, 3, 4])))
        orderings = []
        for later in range(1, len(steps)):
            earlier = rng.randrange(later + 1)
            if earlier < later:
                orderings.append(Ordering(PlanEvent(steps[earlier].index, Moment.END), PlanEvent(steps[later].index, Moment.START)))
        return steps, tuple(orderings)

    def _step(self) -> Step:
        kind = self.rng.random()
        if kind < 0.1:
            body = self._call(is_wanted=True)
            return Loop(self._other(), Not(Holds(self.wanted[-1])), Flow((body,)), 2)
        if kind < 0.25:
            then = Flow((self._call(),))
            return Choice(self._other(), Holds(CALM), then, Flow((self._call(),)) if self.rng.random() < 0.7 else EMPTY)
        if kind < 0.35:
            return ActionCall(self._number(), _counting())
        return self._call(is_wanted=True, may_recover=True)

    def _call(self, *, is_wanted: bool = False, may_recover: bool = False) -> ActionCall:
        rng, number = self.rng, self._number()
        effect: Fluent = (rng.choice([SEEN, HELD]), self.task, f"s{number}")
        if is_wanted:
            self.wanted.append(effect)
        busy: Fluent = ("busy", self.task, f"s{number}")
        is_busy = rng.random() < 0.3
        invariant: Condition = Holds(CALM) if rng.random() < 0.1 else TRUE
        action = GroundAction(
            rng.choice(SERVERS),
            (self.task, f"s{number}"),
            ("task", "step"),
            invariant=invariant,
            start_effects=(Set(busy, Constant(True)),) if is_busy else (),
            end_effects=(Set(effect, Constant(True)), *((Set(busy, Constant(False)),) if is_busy else ())),
            duration=rng.choice([0.5, 1.0, 2.0, 4.0]),
            resources=rng.choice([(), ("arm",), ("arm",), ("arm", "leg")]),
            returns=(("found", Literal.of(number)),) if rng.random() < 0.3 else (),
        )
        beside = copy(rng)  # so that tasks without several outcomes are drawn as if there were none
        if beside.random() < 0.3:
            more = Set((beside.choice([SEEN, HELD]), self.task, f"more{number}"), Constant(True))
            ways = Alternative(action.end_effects, name="usual"), Alternative((*action.end_effects, more), name="more")
            action = replace(action, outcomes=ways, outcome="usual")
        recoveries = (self._recovery(),) if may_recover and rng.random() < 0.25 else ()
        return ActionCall(number, action, recoveries=recoveries)

    def _recovery(self) -> Recovery:
        rng = self.rng
        cause = rng.choice([Cause.ABORTED, Cause.EFFECTS_MISSING, Cause.LOST, Cause.UNAVAILABLE])
        then = rng.choice([Then.RETRY, Then.SKIP, Then.FAIL, Then.RETRY])
        chain = Flow((self._call(),)) if rng.random() < 0.4 else EMPTY
        return Recovery(frozenset({cause}), then, chain, rng.choice([1, 2]) if then is Then.RETRY else 1)

    def _number(self) -> int:
        self.number += 1
        return self.number - 1

    def _other(self) -> int:
        self.others += 1
        return self.others - 1


def _counting() -> GroundAction:
    """Return an operation that must be done once: it adds one to a variable."""
    count = Query(Literal.of("count"), Layer.LOCAL)
    return GroundAction("count", operation=Update(Literal.of("count"), Operation("add", (count, Literal.of(1)))))
