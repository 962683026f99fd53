"""The shared world as a node serves it: what takes long is done in a thread."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from planner_bridge.model import Problem
from planner_bridge.problem_files import load_texts, write_inside
from planner_bridge.shared_world import SharedWorld


class ServedProblem:
    """Answers others' questions about a world, as `pnm.served_world.ServedWorld`.

    Args:
        world: what is asked and told.
        folder: where problems are saved, and loaded from.
        begin: begins anew with another problem; raises an `InputError` when that cannot be.
    """

    def __init__(self, world: SharedWorld, folder: Path, begin: Callable[[Problem], Awaitable[None]]) -> None:
        self._world = world
        self._folder = folder
        self._begin = begin

    async def query(self, questions: Sequence[str], /) -> tuple[tuple[str, str], ...]:
        """Return what is known of each question, in order; of everything that is recorded, when there are none."""
        return self._world.query(questions)

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all of it at once or nothing; return how many of the facts were not known to be so before."""
        return self._world.update(add, remove, forget)

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem as the world is now."""
        return self._world.domain_text(), self._world.problem_text()

    async def save(self, file: str, /) -> str:
        """Write the problem as the world is now to a file in the folder; return its whole path."""
        return str(await asyncio.to_thread(write_inside, self._folder, file, self._world.problem_text()))

    async def load(self, domain: str, problem: str, /) -> None:
        """Begin anew with another domain or problem, each PDDL as a text or the path of a file in the folder."""
        await self._begin(await asyncio.to_thread(load_texts, domain, problem, self._folder, self._world.domain))
