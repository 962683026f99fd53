"""What others may ask of, and tell to, the world that all tasks of a process share; texts in, texts out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol


class ServedWorld(Protocol):
    """Knowledge and problem of a process. To be used on the event loop's thread; what is wrong is an `InputError`."""

    async def query(self, questions: Sequence[str], /) -> Sequence[tuple[str, str]]:
        """Return what is known of each question, in order; of everything that is known, when there are none.

        Args:
            questions: conditions in PDDL, or functions.

        Returns:
            The questions with "true", "false", "unknown", a number or the name of an object.
        """

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all of it at once or nothing; return how many of the facts were not known to be so before."""

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem as the world is now."""

    async def save(self, file: str, /) -> str:
        """Write the problem as the world is now to a file under the folder for problems; return its whole path."""

    async def load(self, domain: str, problem: str, /) -> None:
        """Begin anew with another domain or problem, each PDDL as a text or the path of a file; refused while there are tasks."""

    def follow(self, tell: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        """Tell whatever changes from now on, as fields of a ``pnm_interfaces/msg/KnowledgeChange``; return what stops that."""
