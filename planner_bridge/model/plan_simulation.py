"""The course of a plan: the states that the starts and ends of its calls lead through.

The world as it will be after what is under way, if that goes well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from pnm.core.execution.handover import UnderWay
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.core.logic.effects import Changes, Effects, changes, decided
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.explain import failing, observed
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent
from pnm.errors import PnmError

Deed = Literal["start", "end", "go on"]
_NOTHING: Final[Mapping[Fluent, Value]] = {}


class Denied(PnmError):
    """A call cannot start, end or go on, because a condition does not hold."""

    def __init__(self, call: int, deed: Deed, condition: Condition, state: KnowledgeBase) -> None:
        super().__init__(expected_and_observed(condition, state))
        self.call = call
        self.deed = deed
        self.observed = seen_instead(condition, state)


def snapshot(knowledge: KnowledgeBase) -> KnowledgeBase:
    """Return a copy of what is known about the world, which changes on its own."""
    return KnowledgeBase(knowledge.facts(), objects=knowledge.objects_by_type(), rules=knowledge.rules)


def seen_instead(condition: Condition, state: KnowledgeBase) -> str:
    """Say what is so in place of those parts of the condition that do not hold."""
    return "; ".join(observed(part, state) for part in failing(condition, state))


def expected_and_observed(condition: Condition, state: KnowledgeBase) -> str:
    """Say which parts of the condition do not hold, and what is so in their place."""
    return f"expected {' '.join(map(str, failing(condition, state)))}; observed {seen_instead(condition, state)}"


@dataclass
class Course:
    """The state that a plan has led to so far, and the calls that are going on in it.

    What happens at one time happens at once: every condition is evaluated in the state before, the
    effects are simultaneous, and over-all conditions must hold in the state after (PDDL 2.1, section 8).
    Both fields change.
    """

    state: KnowledgeBase
    running: dict[int, GroundAction] = field(default_factory=dict)

    def happen(self, events: Iterable[tuple[PlanEvent, GroundAction]], timed: Mapping[Fluent, Value] = _NOTHING) -> Changes:
        """Let calls start and end, each start before its own end, and facts change by themselves; return what that changes.

        Raises:
            Denied: a condition does not hold; nothing has changed unless it is an over-all condition.
        """
        effects: list[Effects] = []
        running = dict(self.running)
        for event, action in events:
            if event.moment is Moment.START:
                self._demand(event.call, "start", action.precondition)
                running[event.call] = replace(action, end_effects=decided(action.end_effects, self.state))
                effects.append(action.start_effects)
            else:
                self._demand(event.call, "end", action.end_condition)
                effects.append(running.pop(event.call).end_effects)
        found = {**changes(tuple(one for many in effects for one in many), self.state), **timed}
        self.running = running
        self.state.update(found)
        for call, action in running.items():
            self._demand(call, "go on", action.invariant)
        return found

    def _demand(self, call: int, deed: Deed, condition: Condition) -> None:
        if evaluate(condition, self.state) is not True:
            raise Denied(call, deed, condition, self.state)


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
