"""A simulated world: the true state, apart from the knowledge that any run has of it.

Actions begin and finish in it by their real conditions and effects; the effects of an action that does not
succeed are rolled back, as far as the same fluents were not changed since.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, data_in, evaluate, unmet
from pnm.core.logic.effects import Changes, changes, decided, undo, values_before
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError


class SimulatedWorld:
    """The true state, and the actions that are going on in it; raises `InputError` if rules derive one of the dynamic names."""

    def __init__(self, truth: KnowledgeBase, dynamic: Iterable[str]) -> None:
        self.truth = truth
        self.dynamic = frozenset(dynamic)
        """The predicates and functions that can change: sensors report these."""
        for name in sorted(self.dynamic & truth.rules.derived):
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported")

    def holds(self, condition: Condition) -> bool:
        """Return whether the condition is true in the world."""
        return evaluate(condition, self.truth) is True

    def change(self, facts: Mapping[Fluent, Value | Unknown]) -> None:
        """Change facts without an action, unknown to every run."""
        self.truth.update(facts)

    def begin(self, action: GroundAction) -> Activity | str:
        """Begin the action and return its activity, or the reason why it cannot be done."""
        if denied := _denied(action.precondition, self.truth):
            return f"{action} cannot start: {denied} is not so"
        activity = Activity(self, action)
        if denied := _denied(action.invariant, self.truth):
            activity.undo()
            return f"{action} cannot go on: {denied} is not so"
        return activity

    def reported(self, assumed: Iterable[str] = ()) -> frozenset[str]:
        """Return the names that sensors report: all that can change, without those assumed."""
        return self.dynamic - frozenset(assumed)

    def report(self, names: frozenset[str]) -> Changes:
        """Return the sensor report on these predicates and functions."""
        return {fluent: value for fluent, value in self.truth.facts().items() if fluent[0] in names}


class Activity:
    """A ground action going on in the world."""

    def __init__(self, world: SimulatedWorld, action: GroundAction) -> None:
        self.world = world
        self.action = action
        self._ending = decided(action.end_effects, world.truth)
        self._written = changes(action.start_effects, world.truth)
        self._before = values_before(self._written, world.truth)
        world.change(self._written)

    @property
    def broken(self) -> str:
        """The conjuncts of the over-all condition that no longer hold; empty when all of them do."""
        return _denied(self.action.invariant, self.world.truth)

    def finish(self) -> str:
        """Apply the end effects, or roll the start effects back and return why the action cannot succeed."""
        if denied := _denied(self.action.end_condition, self.world.truth):
            self.undo()
            return f"{self.action} cannot end well: {denied} is not so"
        self.world.change(changes(self._ending, self.world.truth))
        return ""

    def undo(self) -> None:
        """Roll the start effects back."""
        self.world.change(undo(self._before, self._written, self.world.truth))


def _denied(condition: Condition, truth: KnowledgeBase) -> str:
    """Return the conjuncts that do not hold. The world has no variables: conditions on these are left to the run."""
    parts = () if condition == TRUE else unmet(condition, truth)
    return " ".join(str(part) for part in parts if evaluate(part, truth) is False or not any(data_in(part)))


LAG: Final = 0.01
"""Seconds within which all changes of one moment are reported."""


def report_changes(world: SimulatedWorld, knowledge: KnowledgeBase, assumed: Iterable[str] = ()) -> None:
    """Keep knowledge up to date with the world, without the assumed names.

    Reports are immediate, but an action's end effects are reported before its end.
    """
    names = world.reported(assumed)
    knowledge.sense(names, lag=LAG)
    knowledge.replace(names, world.report(names))

    def report(changes: Mapping[Fluent, Value | Unknown]) -> None:
        knowledge.update({fluent: value for fluent, value in changes.items() if fluent[0] in names})

    world.truth.listen(report)
