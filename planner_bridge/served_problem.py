"""The world that all tasks share, for the services of the node: `pnm.served_world.ServedWorld` of a problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from planner_bridge.shared_world import SharedWorld
from pnm.errors import InputError
from pnm.expressions import Fluent, Unknown, Value


@dataclass(frozen=True)
class ServedProblem:
    """A shared world, and the folder for its files."""

    world: SharedWorld
    folder: Path

    async def query(self, questions: Sequence[str], /) -> list[tuple[str, str]]:
        """Return what is known of each question, in order; of everything that is known, when there are none."""
        return self.world.query(questions)

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all of it at once or nothing; return how many of the facts are news."""
        return self.world.update(add, remove, forget)

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem as the world is now."""
        return self.world.domain_text(), self.world.problem_text()

    async def save(self, file: str, /) -> str:
        """Write the problem as the world is now to a file in the folder; return its whole path."""
        return str(self.world.save(file, self.folder))

    async def load(self, domain: str, problem: str, /) -> None:
        """Refuse: the problem of a node is chosen when it is configured."""
        raise InputError("the problem of this node is chosen when it is configured; clean it up, and configure it with other files")

    def changes(self, batch: Mapping[Fluent, Value | Unknown], /) -> Mapping[str, object]:
        """Return what has changed, as fields of a message."""
        return self.world.changes(batch)
