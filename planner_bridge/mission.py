"""What is pursued, where, and how: what all parts of a pursuit are given."""

from __future__ import annotations

from dataclasses import dataclass, field

from planner_bridge.circumstances import Circumstances
from planner_bridge.forbidding import ForbiddenCall, users
from planner_bridge.model import Problem
from planner_bridge.replanning import History
from planner_bridge.stopwatch import Stopwatch
from planner_bridge.tasks import Settings, TaskObserver
from pnm.knowledge import KnowledgeBase, Layered
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

    def kept(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that need what was waited for in vain, as far as that is still withheld."""
        names = self.circumstances.resources.withheld_from(history.lacking)
        return users(self.problem.domain, self.settings.bindings, names.keys())

    def forbidden(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that no plan may use as things are."""
        return history.forbidden(self.settings.limits) | self.kept(history)

    @property
    def world(self) -> KnowledgeBase:
        """What all tasks share of what is known."""
        return self.knowledge.world
