"""A world that draws the outcomes of actions: an action client, and the sensors that report everything that it changes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from random import Random
from typing import Final, cast
from uuid import UUID

from planner_bridge.model.problem import Problem
from pnm.actions.backend import ClientBackend
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from tests.support.pddl.outcomes.problem import Chance, Changes

IMPOSSIBLE: Final = "its condition does not hold in the world"


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
        self._task = cast("asyncio.Task[object]", asyncio.current_task())
        self.report_to(knowledge)

    def report_to(self, knowledge: KnowledgeBase) -> None:
        """Report everything that changes, now and after every action."""
        self._knowledge = knowledge
        names = frozenset(map(self._spelled, self.chance.changing))
        knowledge.sense(names, lag=0.0)
        knowledge.replace(names, self._facts(dict.fromkeys(self.state, True)))

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
        ended = Outcome(OutcomeKind.CANCELED, message="too many actions")
        if not self.is_over:
            is_done = self.perform(request.action.name, request.action.arguments)
            ended = Outcome(OutcomeKind.SUCCEEDED if is_done else OutcomeKind.ABORTED, message="" if is_done else IMPOSSIBLE)
        report(Ended(request.id, ended))

    def perform(self, name: str, arguments: Iterable[str]) -> bool:
        """Perform an action, and report what it changes; return whether it was possible."""
        schema = name.lower() if name.lower() in self.chance.schemas else name.lower().rpartition("__")[0]
        action, before = self.chance.action(schema, map(str.lower, arguments)), self.state
        if not self.chance.is_possible(action, before):
            return False
        self.state = self.chance.drawn(action, before, self._random)
        self._knowledge.update(self._facts({**dict.fromkeys(before - self.state, False), **dict.fromkeys(self.state - before, True)}))
        return True

    def _facts(self, changes: Changes) -> dict[Fluent, Value]:
        return {tuple(map(self._spelled, atom)): value for atom, value in changes.items()}
