"""What a node says of itself: the moments of its life cycle, and its diagnoses."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from contextlib import AsyncExitStack
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from pnm.core.machine.verification.verify import Proof
from pnm.core.readiness import Readiness
from pnm.errors import InputError, Tolerated
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.tasks import EVENTS, ServedWorld, TaskCommands, Tasks

if TYPE_CHECKING:
    from planner_bridge.node.options import Options
    from pnm.ros.sim_time import SimClock
    from pnm.ros.tasks.executor_topics import Diagnosis


def standing_words(place: str, holder: str) -> str:
    """Return in words that a node waits for a journal."""
    return f"stands by: {holder} holds the journal {place}"


class NodeObserver:
    """Follows the life cycle of a node, which is in the log of `pnm.tasks.EVENTS` besides: one empty method per event."""

    def unconfigured(self) -> None:
        """Note that the node waits for a lifecycle manager."""

    def tolerated(self, warnings: Iterable[Tolerated]) -> None:
        """Note the doubtful parts of the files."""

    def proved(self, plan: str, proof: Proof) -> None:
        """Note that the machine of a plan is verified."""

    def standing_by(self, place: str, holder: str) -> None:
        """Note that another process holds the journal, and that it is waited for."""

    def rated(self, file: Path | None) -> None:
        """Note the file of rates; None if there is none. This comes before the journal."""

    def journalled(self, place: str, going_on: int | None) -> None:
        """Note where tasks are kept, empty if nowhere, and how many of another process go on; None if none has kept anything there."""

    def configured(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld) -> None:
        """Note that there will be tasks, which can be listened to; how they are commanded here, and the world that they share."""

    def activated(self, actions: tuple[str, ...]) -> None:
        """Note that goals are accepted, by the action servers of these names."""

    def deactivated(self) -> None:
        """Note that goals are rejected and tasks are paused."""

    def missing(self, server: str) -> None:
        """Note that an action server that a plan needs is missing."""

    def failed(self, error: BaseException) -> None:
        """Note that the action servers that plans need cannot be used, or that the node cannot be configured."""


# --- diagnoses ------------------------------------------------------------------------------------
# How the parts of a node are, for ``/diagnostics``: the node itself, its tasks, and what `pnm check` looks at.


async def open_diagnoses(
    stack: AsyncExitStack,
    ros: Any,
    look: Callable[[], Awaitable[Iterable[Readiness]]],
    tasks: Tasks,
    state: Callable[[], str],
    clock: SimClock | None,
    journal: Journal,
    options: Options,
) -> None:
    """Publish diagnoses until the stack is closed; there is a warning when their type is not installed.

    Args:
        look: returns how ready action servers and sensors are.
        clock: that of the simulation whose time is followed, if one is.
    """
    from pnm.ros.tasks.executor_topics import (  # here, because rclpy is an extra
        Diagnosis,
        Diagnostics,
        Level,
        diagnosis_of,
        diagnosis_of_tasks,
    )

    served = {name: getattr(options, name) or "" for name in ("domain", "problem", "world", "planner")}

    async def diagnose() -> tuple[Diagnosis, ...]:
        level, message = (Level.OK, "active") if state() == "active" else (Level.WARN, f"{state()}: goals are rejected")
        node = Diagnosis("node", level, message, served)
        trouble = clock.trouble(monotonic()) if clock else ""
        watched = (Diagnosis("clock", Level.WARN if trouble else Level.OK, trouble or "/clock goes on"),) if clock else ()
        kept = () if journal is NO_JOURNAL else (diagnosis_of_journal(journal),)
        return node, *watched, *kept, diagnosis_of_tasks(tasks.status()), *map(diagnosis_of, await look())

    def diagnosis_of_journal(journal: Journal) -> Diagnosis:
        """Return the state of the journal, and whether another node stands by if there was one."""
        others = journal.stand_bys()
        if journal.blocked:
            return Diagnosis("journal", Level.ERROR, journal.blocked)
        if others.are_missed:
            missed = f"no other node stands by any more; the last one was {others.names[-1]}, {others.ago:.0f} s ago"
            return Diagnosis("journal", Level.WARN, missed)
        return Diagnosis("journal", Level.OK, f"{', '.join(others.names)} stands by" if others.names else "can be written")

    try:
        diagnostics = Diagnostics(ros, diagnose)
    except InputError as error:  # a ROS installation has the type, as have the wheels of the extra
        EVENTS.warning("there are no diagnostics: %s", error)
        return
    await diagnostics.open()
    stack.push_async_callback(diagnostics.close)
