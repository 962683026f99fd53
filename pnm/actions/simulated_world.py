"""A simulated world with a truth of its own, apart from what anybody believes.

Actions begin and finish in it by their real conditions and effects; an action that does not
succeed leaves the world as it was before it began, as far as nobody else has changed it since.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Computed, Condition, every_part
from pnm.core.logic.effects import Changes, changes, decided, undo, values_before
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.explain import failing
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError


class SimulatedWorld:
    """The true state, and the actions that are going on in it.

    Raises:
        InputError: a name is said to be able to change, but is derived by rules.
    """

    def __init__(self, truth: KnowledgeBase, dynamic: Iterable[str]) -> None:
        self.truth = truth
        self.dynamic = frozenset(dynamic)
        """The predicates and functions that can change: those are what sensors report."""
        for name in sorted(self.dynamic & truth.rules.derived):
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported")

    def holds(self, condition: Condition) -> bool:
        """Tell whether the condition is true in the world."""
        return evaluate(condition, self.truth) is True

    def change(self, facts: Mapping[Fluent, Value | Unknown]) -> None:
        """Change facts behind everybody's back."""
        self.truth.update(facts)

    def begin(self, action: GroundAction) -> Activity | str:
        """Begin the action, or say why it cannot be done."""
        if denied := _denied(action.precondition, self.truth):
            return f"{action} cannot start: {denied} is not so"
        activity = Activity(self, action)
        if denied := _denied(action.invariant, self.truth):
            activity.undo()
            return f"{action} cannot go on: {denied} is not so"
        return activity

    def reported(self, assumed: Iterable[str] = ()) -> frozenset[str]:
        """Return the names that sensors report: all that can change, without those that nobody watches."""
        return self.dynamic - frozenset(assumed)

    def report(self, names: frozenset[str]) -> Changes:
        """Return what sensors see of these predicates and functions."""
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
        """What of the over-all condition no longer holds; empty when all of it does."""
        return _denied(self.action.invariant, self.world.truth)

    def finish(self) -> str:
        """Apply the end effects, or undo the start effects and say why the action cannot end well."""
        if denied := _denied(self.action.end_condition, self.world.truth):
            self.undo()
            return f"{self.action} cannot end well: {denied} is not so"
        self.world.change(changes(self._ending, self.world.truth))
        return ""

    def undo(self) -> None:
        """Leave the world as if the action had not begun."""
        self.world.change(undo(self._before, self._written, self.world.truth))


def _denied(condition: Condition, truth: KnowledgeBase) -> str:
    """Say which parts do not hold. The world has no variables: what is only known with them is left to the run."""
    parts = () if condition == TRUE else failing(condition, truth)
    return " ".join(str(part) for part in parts if evaluate(part, truth) is False or not _is_computed(part))


def _is_computed(condition: Condition) -> bool:
    return any(isinstance(part, Computed) for part in every_part(condition))
