"""What is pursued, where, and how: what all parts of a pursuit are given."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from planner_bridge.circumstances import Circumstances
from planner_bridge.forbidding import ForbiddenCall, users
from planner_bridge.model import Problem
from planner_bridge.stopwatch import Stopwatch
from planner_bridge.tasks import Settings, TaskObserver
from pnm.knowledge import KnowledgeBase, Layered
from pnm.results import Failure
from pnm.sites import Site


@dataclass(frozen=True)
class Mission:
    """A goal, and everything that is there to reach it.

    Args:
        problem: whose goal is pursued.
        site: where actions are carried out.
        settings: planner, bindings, limits and policies.
        observer: is told what happens.
        seconds: measures where the time goes.
        knowledge: what is known.
        circumstances: what is shared with other tasks.
    """

    problem: Problem
    site: Site
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    knowledge: Layered
    circumstances: Circumstances = field(default_factory=Circumstances)

    def waited_for(self, failures: Iterable[Failure]) -> frozenset[ForbiddenCall]:
        """Return the calls that need what was waited for in vain in these failures."""
        return users(self.problem.domain, self.settings.bindings, {name for one in failures for name in one.lacking})

    @property
    def world(self) -> KnowledgeBase:
        """What all tasks share of what is known."""
        return self.knowledge.world
