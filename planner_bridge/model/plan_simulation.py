"""Plan simulation: the progression of a state through the starts and ends of a plan's actions (PDDL 2.1, section 8).

Besides, the progression of trajectory constraints.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.core.logic.effects import Changes, Effects, changes, decided
from pnm.core.logic.evaluation import evaluate, explanation
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint, instances, is_fulfilled, progressed
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent
from pnm.errors import PnmError

Stage = Literal["start", "end", "go on"]
_NOTHING: Final[Mapping[Fluent, Value]] = {}


class NotApplicable(PnmError):
    """An action cannot start, end or go on in a state, because a condition does not hold."""

    def __init__(self, call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> None:
        expected, self.observed = explanation(condition, state)
        super().__init__(f"expected {expected}; observed {self.observed}")
        self.call = call
        self.stage = stage


def snapshot(knowledge: KnowledgeBase) -> KnowledgeBase:
    """Return a copy of the knowledge about the world, which changes on its own."""
    return KnowledgeBase(knowledge.facts(), objects=knowledge.objects_by_type(), rules=knowledge.rules)


@dataclass
class PlanSimulation:
    """The state that a plan has led to so far, and the actions running in it.

    The events of one time happen at once: every condition is evaluated in the state before, the
    effects are simultaneous, and over-all conditions must hold in the state after (PDDL 2.1, section 8).
    Both fields change.
    """

    state: KnowledgeBase
    running: dict[int, GroundAction] = field(default_factory=dict)
    """By the number of the call."""

    def advance(self, events: Iterable[tuple[PlanEvent, GroundAction]], timed: Mapping[Fluent, Value] = _NOTHING) -> Changes:
        """Let actions start and end, each start before its own end, and facts change by themselves; return the changed fluents.

        Raises `NotApplicable` if a condition does not hold; nothing has changed then unless it is an over-all condition.
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
        changed = {**changes(tuple(effect for many in effects for effect in many), self.state), **timed}
        self.running = running
        self.state.update(changed)
        for call, action in running.items():
            self._demand(call, "go on", action.invariant)
        return changed

    def _demand(self, call: int, stage: Stage, condition: Condition) -> None:
        if evaluate(condition, self.state) is not True:
            raise NotApplicable(call, stage, condition, self.state)


class ConstraintProgression:
    """Trajectory constraints, progressed through the states of a simulation. The mutable state is what is left of each."""

    def __init__(self, constraints: Iterable[Constraint], state: KnowledgeBase, time: float = 0.0) -> None:
        every = (ground for constraint in constraints for ground in instances(constraint, state))
        self._remaining = {ground: progressed((ground,), state, time) for ground in every}

    def advance(self, state: KnowledgeBase, time: float = 0.0) -> Constraint | None:
        """Progress the constraints to the next state; return one that is violated, if any is."""
        self._remaining = {constraint: progressed(rest, state, time) for constraint, rest in self._remaining.items()}
        return next((constraint for constraint, rest in self._remaining.items() if IMPOSSIBLE in rest), None)

    def unfulfilled(self, state: KnowledgeBase, time: float = 0.0) -> list[Constraint]:
        """Return the constraints that are not fulfilled if this is the last state."""
        return [constraint for constraint, rest in self._remaining.items() if not is_fulfilled(rest, state, time)]
