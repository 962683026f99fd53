"""The other tasks, as far as a plan has to get on with them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from uuid import UUID

from planner_bridge.footprints import Footprint


@dataclass(frozen=True, slots=True)
class Conflict:
    """A task beside which a plan cannot be carried out.

    Args:
        task: the other one.
        name: what people know it by.
        footprint: what its plan still needs and changes.
        why: what is in the way.
    """

    task: UUID
    name: str
    footprint: Footprint
    why: str

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


class Neighbours:
    """Those of a task that is alone: nobody."""

    def conflicts(self, footprint: Footprint, /) -> tuple[Conflict, ...]:
        """Return the tasks that a plan with this footprint has to respect and is in conflict with."""
        return ()

    async def changed(self) -> None:
        """Wait until one of them is over, or needs less than before."""
        await asyncio.Event().wait()


ALONE = Neighbours()
