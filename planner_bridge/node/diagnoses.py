"""How the parts of a node are, for ``/diagnostics``: the node itself, its tasks, and what `pnm check` looks at."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from contextlib import AsyncExitStack
from time import monotonic
from typing import TYPE_CHECKING, Any

from planner_bridge.node.options import Options
from pnm.core.readiness import Readiness
from pnm.errors import InputError
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.tasks import EVENTS, Tasks

if TYPE_CHECKING:
    from pnm.ros.sim_time import SimClock
    from pnm.ros.tasks.executor_topics import Diagnosis


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
        state: returns that of the life cycle.
        clock: that of the simulation whose time is followed, if one is.
        journal: of the tasks.
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
        """Return how the journal is, and whether another node would go on with it if there has been one."""
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
