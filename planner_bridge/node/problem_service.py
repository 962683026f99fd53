"""The problem of a node, as its services tell of it: `pnm.tasks.ServedWorld`.

Files of domains and problems that others name: inside one folder, and never half written.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.node.initial_world import with_names_of, world_of_plans
from planner_bridge.node.plan_request import Maker
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.read.reader import MAX_BYTES
from planner_bridge.tasks.scheduling.task_manager import CurrentProblem
from planner_bridge.tasks.settings import Settings
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError
from pnm.language.plan import HandWrittenPlan
from pnm.tasks import MadePlan


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in the folder, whatever links are on the way.

    Raises:
        InputError: it is none, or is outside of the folder.
    """
    root = folder.resolve()
    if not name.strip() or "\0" in name:
        raise InputError(f"not a path: {name!r}; expected the path of a file in {root}")
    try:
        path = (root / name).resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(f"not a path: {name[:200]!r} ({error})") from error
    if root not in path.parents:
        raise InputError(f"{name[:200]!r} is not in the folder {root}; expected the path of a file in it")
    return path


def write_inside(folder: Path, name: str, text: str) -> Path:
    """Write a file in the folder, whole or not at all, and return its path.

    Raises:
        InputError: the path leads out of the folder, or cannot be written.
    """
    path = inside(folder, name)
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
        try:
            with open(handle, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(draft, 0o644)
            os.replace(draft, path)
        except BaseException:
            with suppress(OSError):
                os.unlink(draft)
            raise
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def load_texts(domain: str, problem: str, folder: Path, loaded: Domain) -> Problem:
    """Return a problem, of which domain and problem are each given as PDDL or as the path of a file in the folder.

    Args:
        domain: empty for the one that is loaded.
        problem: the problem.
        folder: what paths are relative to.
        loaded: the domain that is loaded.

    Raises:
        InputError: one of them cannot be read.
    """
    for text in (domain, problem):
        if len(text) > MAX_BYTES:
            raise InputError(f"{len(text)} characters; expected {MAX_BYTES} at most")
    chosen = loaded
    if domain.strip():
        chosen = parse_domain(domain, "domain") if _is_text(domain) else read_domain(inside(folder, domain))
    return parse_problem(problem, chosen, "problem") if _is_text(problem) else read_problem(inside(folder, problem), chosen)


def _is_text(given: str) -> bool:
    return given.lstrip()[:1] in ("(", ";")


NOTHING: Final = Problem("nothing", Domain("nothing"))
"""The problem of a node that has none, and carries out plans only."""


class ServedProblem:
    """The problem that goals are about, until another one is loaded.

    The mutable state is the current problem, and what is made of it: `_world` and `_maker`.

    Args:
        current: the problem, which tasks are about as well.
        knowledge: what is known of its world.
        goals: texts of goals by name.
        settings: planner and limit for plans that nobody carries out.
        folder: where problems are saved, and loaded from.
        plans: whose world it is while there is no problem.
    """

    def __init__(
        self,
        current: CurrentProblem,
        knowledge: KnowledgeBase,
        goals: Mapping[str, str],
        settings: Settings,
        folder: Path,
        plans: Iterable[HandWrittenPlan] = (),
    ) -> None:
        self._current = current
        self._knowledge = knowledge
        self._goals = goals
        self._settings = settings
        self._folder = folder
        self._plans = tuple(plans)
        self._begin()

    def _begin(self) -> None:
        loop, problem, began = asyncio.get_running_loop(), self._current.problem, self._current.began
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
        self._current.replace(loaded)
        world = initial_knowledge(loaded)
        self._knowledge.begin_anew(world.facts(), world.objects_by_type(), world.rules)
        self._begin()

    def follow(self, tell: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        """Tell what changes from now on, as fields of a message; return what stops that."""
        self._world.attend()
        return self._knowledge.listen(lambda batch: tell(self._world.changes(batch)) if batch else None)
