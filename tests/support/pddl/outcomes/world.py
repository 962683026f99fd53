"""A world that draws the outcomes of actions: an action client, and the sensors that report everything that it changes."""

from __future__ import annotations

import asyncio
import time
from random import Random
from typing import cast
from uuid import UUID

from planner_bridge.model.problem import Problem
from pnm.actions.backend import ClientBackend
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from tests.support.pddl.outcomes.problem import Chance, Changes


class ChanceWorld(ClientBackend):
    """A world in which every request is performed at once, by a reading of its own, and ends in an outcome that is drawn.

    Args:
        chance: the problem, whose actions have outcomes.
        problem: the one that is pursued, with the same names; actions may have one for each outcome, with a number behind underscores.
        limit: actions after which the task is stopped.

    Attributes:
        state: what is so.
        actions: how many were asked for.
        first: when the first was, on the clock of the processor's wall.
    """

    def __init__(self, chance: Chance, problem: Problem, seed: int, limit: int) -> None:
        super().__init__(self)
        self.chance = chance
        self.state = chance.initial
        self.actions = 0
        self.first: float | None = None
        self._spelled = problem.vocabulary.spelled
        self._random = Random(seed)
        self._limit = limit

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Report the state of the world, from now on after every action."""
        self._knowledge, self._task = knowledge, cast("asyncio.Task[object]", asyncio.current_task())
        names = frozenset(map(self._spelled, {*self.chance.changing, *(fluent[0] for fluent, _ in self.state.numbers)}))
        knowledge.sense(names, lag=0.0)
        knowledge.replace(names, self._facts({**dict.fromkeys(self.state.facts, True), **dict(self.state.numbers)}))

    @property
    def is_over(self) -> bool:
        """Whether so many actions were asked for that the task was stopped."""
        return self.actions > self._limit

    @property
    def has_reached(self) -> bool:
        """Whether the goal holds in the world."""
        return self.chance.is_goal(self.state)

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...]:
        """Return the names of the action's parameters."""
        return action.parameters

    def send(self, request: Request, report: Reporter, /) -> None:
        """Perform the request in the next turn of the loop."""
        self.first = self.first or time.perf_counter()
        self.actions += 1
        if self.is_over:
            self._task.cancel()
        asyncio.get_running_loop().call_soon(self._perform, request, report)

    def cancel(self, request: UUID, /) -> None:
        """Do nothing: what was accepted is over."""

    def _perform(self, request: Request, report: Reporter) -> None:
        report(Accepted(request.id))
        name = request.action.name.lower()
        action = self.chance.action(
            name if name in self.chance.schemas else name.rpartition("__")[0], map(str.lower, request.action.arguments)
        )
        if self.is_over:
            ended = Outcome(OutcomeKind.CANCELED, message="too many actions")
        elif not self.chance.is_possible(action, self.state):
            ended = Outcome(OutcomeKind.ABORTED, message="its condition does not hold in the world")
        else:
            before, self.state = self.state, self.chance.drawn(action, self.state, self._random)
            gone = dict.fromkeys(before.facts - self.state.facts, False)
            self._knowledge.update(
                self._facts({**gone, **dict.fromkeys(self.state.facts - before.facts, True), **dict(self.state.numbers - before.numbers)})
            )
            ended = Outcome(OutcomeKind.SUCCEEDED)
        report(Ended(request.id, ended))

    def _facts(self, changes: Changes) -> dict[Fluent, Value]:
        return {tuple(map(self._spelled, atom)): value for atom, value in changes.items()}
