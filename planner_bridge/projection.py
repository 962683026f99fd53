"""The world as it will be after what is under way, if that goes well."""

from __future__ import annotations

from collections.abc import Iterable

from planner_bridge.course import Course, Denied, snapshot
from pnm.calls import UnderWay
from pnm.errors import PnmError
from pnm.knowledge import KnowledgeBase
from pnm.plan_graph import Moment, PlanEvent


class Unforeseeable(PnmError):
    """Something that is under way cannot come to its end as things are."""


def after(world: KnowledgeBase, under_way: Iterable[UnderWay]) -> KnowledgeBase:
    """Return what will be known of the world once these calls have ended.

    Raises:
        Unforeseeable: one of them cannot end well.
    """
    going_on = {one.call.index: one.call.action for one in under_way}
    course = Course(snapshot(world), dict(going_on))
    try:
        for number, action in going_on.items():
            course.happen([(PlanEvent(number, Moment.END), action)])
    except Denied as denied:
        raise Unforeseeable(f"{going_on[denied.call]} would {denied.deed} although {denied.observed}") from denied
    return course.state
