"""The problem of a node, as its services tell of it: `pnm.served_world.ServedWorld`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from planner_bridge.making import Maker
from planner_bridge.model import Domain, Problem
from planner_bridge.problem_files import load_texts, write_inside
from planner_bridge.shared_world import SharedWorld
from planner_bridge.state import initial_knowledge
from planner_bridge.tasks import Settings
from planner_bridge.world_of_plans import with_names_of, world_of_plans
from pnm.conditions import Condition
from pnm.errors import InputError
from pnm.knowledge import KnowledgeBase
from pnm.language.plan import HandWrittenPlan
from pnm.tasking import MadePlan

NOTHING: Final = Problem("nothing", Domain("nothing"))
"""The problem of a node that has none, and carries out plans only."""


class ServedProblem:
    """The problem that goals are about, until another one is loaded.

    The mutable state is the problem, in `_world` and `_maker`, and when it began.

    Args:
        problem: the one to begin with.
        knowledge: what is known of its world.
        goals: texts of goals by name.
        settings: planner and limit for plans that nobody carries out.
        folder: where problems are saved, and loaded from.
        plans: whose world it is while there is no problem.
    """

    def __init__(
        self,
        problem: Problem,
        knowledge: KnowledgeBase,
        goals: Mapping[str, str],
        settings: Settings,
        folder: Path,
        plans: Iterable[HandWrittenPlan] = (),
    ) -> None:
        self._knowledge = knowledge
        self._goals = goals
        self._settings = settings
        self._folder = folder
        self._plans = tuple(plans)
        self.begins_anew: Callable[[Problem], None] = lambda _: None
        """Is told of another problem before it is begun; raises an `InputError` when that cannot be."""
        self._begin(problem)

    def _begin(self, problem: Problem) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        self._is_loaded = problem is not NOTHING
        goals = self._goals if self._is_loaded else {}
        world = problem if self._is_loaded else world_of_plans(self._plans)
        self._world = SharedWorld(world, self._knowledge, goals, elapsed=lambda: loop.time() - began)
        self._maker = Maker(problem, self._knowledge, self._settings, self.read_goal, began)

    @property
    def _loaded(self) -> SharedWorld:
        if not self._is_loaded:
            raise InputError("no domain and problem are loaded, only plans; expected them when the node starts, or by problem/load")
        return self._world

    def _world_of(self, texts: Sequence[str]) -> SharedWorld:
        """Return the world in which texts are read."""
        if self._is_loaded:
            return self._world
        return SharedWorld(with_names_of(self._world.problem, self._plans, texts), self._knowledge)

    def read_goal(self, text: str) -> Condition:
        """Return the goal that is meant.

        Raises:
            InputError: it is none.
        """
        return self._loaded.read_goal(text)

    async def make(self, goal: str, planner: str, seconds: float | None) -> MadePlan:
        """Look for a plan that nobody carries out."""
        return await self._maker.make(goal, planner, seconds)

    async def query(self, questions: Sequence[str], /) -> list[tuple[str, str]]:
        """Return what is known of each question, in order; of everything that is known, when there are none."""
        return self._world_of(questions).query(questions)

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all of it at once or nothing; return how many of the facts are news."""
        return self._world_of((*add, *remove, *forget)).update(add, remove, forget)

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem as the world is now."""
        return self._loaded.domain_text(), self._loaded.problem_text()

    async def save(self, file: str, /) -> str:
        """Write the problem as the world is now to a file in the folder; return its whole path."""
        return str(await asyncio.to_thread(write_inside, self._folder, file, self._loaded.problem_text()))

    async def load(self, domain: str, problem: str, /) -> None:
        """Begin anew with another domain or problem; goals with names must make sense in it as well."""
        known = self._world.problem.domain if domain.strip() else self._loaded.problem.domain
        loaded = await asyncio.to_thread(load_texts, domain, problem, self._folder, known)
        SharedWorld(loaded, initial_knowledge(loaded), self._goals)
        self.begins_anew(loaded)
        world = initial_knowledge(loaded)
        self._knowledge.begin_anew(world.facts(), world.objects_by_type(), world.rules)
        self._begin(loaded)

    def follow(self, tell: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        """Tell what changes from now on, as fields of a message; return what stops that."""
        self._world.attend()
        return self._knowledge.listen(lambda batch: tell(self._world.changes(batch)) if batch else None)
