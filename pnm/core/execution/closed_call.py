"""Closed calls: what of a call is the same whatever knowledge has, computed once per machine and shared by its runs.

A call is closed when the plan gives all its parameters. What it changes is constant when its effects assign constants; of any other
call that is computed anew, by `pnm.core.execution.effect_checks`, which is the definition of what stands here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from pnm.core.execution.effect_checks import Intention
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.compiled_condition import CompiledCondition, compiled
from pnm.core.logic.conditions import TRUE, conjunction
from pnm.core.logic.effects import constants, names_written
from pnm.core.logic.expressions import Fluent, Unknown, Value, is_number, same_value
from pnm.core.machine.bindings import open_parameters, own_values
from pnm.core.machine.plan_graph import ActionCall


class ConstantEffects(NamedTuple):
    """Effects of a call that are the same in every state."""

    intention: Intention
    """What the call is going to change where nothing of it is sensed."""
    visible: Mapping[Fluent, Value]
    """What should be seen of it where it is sensed."""
    done: tuple[tuple[Fluent, Value | Unknown], ...]
    """What is so already where there is nothing to do; empty if that can never be said."""

    def intended(self, world: KnowledgeBase) -> Intention:
        """Return the intention of the call, as `effect_checks.intention` would."""
        seen = world.reported(self.visible)
        return replace(self.intention, expected=seen) if seen else self.intention

    def are_done(self, world: KnowledgeBase) -> bool:
        """Return whether there is nothing to do, as `effect_checks.already_true` would."""
        for fluent, value in self.done:
            if not same_value(world.value(fluent), value):
                return False
        return bool(self.done)


class ClosedCall(NamedTuple):
    """What of a closed call does not depend on knowledge."""

    own: Mapping[str, object]
    """The values that it has for goal fields by itself."""
    names: frozenset[str]
    """The names of all that its effects may change."""
    expects: bool
    """Whether it has a condition for its end, or something is expected of it."""
    needed: CompiledCondition | None
    """What must hold until its end, and there; None for nothing."""
    effects: ConstantEffects | None
    """None if what it changes depends on the state."""


def closed_call(call: ActionCall) -> ClosedCall | None:
    """Return what of the call does not depend on knowledge; None for one that leaves parameters open, or is about knowledge itself."""
    action = call.action
    if action.operation is not None or action.given or open_parameters(action):
        return None
    names = names_written((*action.start_effects, *action.end_effects))
    expects, needed = not (action.end_condition == action.expected == TRUE), conjunction((action.invariant, action.end_condition))
    return ClosedCall(own_values(action), names, expects, None if needed == TRUE else compiled(needed), _constant_effects(call))


def _constant_effects(call: ActionCall) -> ConstantEffects | None:
    action = call.action
    start, end = constants(action.start_effects), constants(action.end_effects)
    if start is None or end is None or action.expected != TRUE:
        return None
    changed, lasting = start | end, {fluent: value for fluent, value in start.items() if fluent in call.lasting}
    visible = {fluent: value for fluent, value in (lasting | end).items() if isinstance(value, bool | str)}
    done = () if any(map(is_number, changed.values())) else tuple(changed.items())
    return ConstantEffects(Intention(start, end, action.end_effects), visible, done)
