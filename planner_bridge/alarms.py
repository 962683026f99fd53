"""Which changes of facts a plan should be looked at for."""

from __future__ import annotations

from collections.abc import Mapping

from planner_bridge.replanning import Progress
from pnm.conditions import names
from pnm.effects import assignments, names_written, unconditional
from pnm.expressions import Constant, Fluent, State, Unknown, Value
from pnm.plan_graph import ActionCall


def is_relevant(progress: Progress, changed: Mapping[Fluent, object]) -> bool:
    """Tell whether what has changed is read or written by the rest of the plan, or by its goal."""
    mentioned = set(progress.plan.rules.base(names(progress.plan.goal)))
    for call in progress.rest:
        mentioned |= progress.plan.rules.base(_reads(call)) | _writes(call)
    return any(fluent[0] in mentioned for fluent in changed)


def is_foreseen(progress: Progress, changed: Mapping[Fluent, Value | Unknown], state: State) -> bool:
    """Tell whether calls that have begun are what makes these changes: each to what one of them writes, or a number it computes."""
    begun = [one.call for one in progress.calls if one.outcome != "waiting" and _writes(one.call) & {fluent[0] for fluent in changed}]
    written: dict[Fluent, list[Value | None]] = {}
    for call in begun:
        effects = unconditional((*call.action.start_effects, *call.action.end_effects))
        for fluent, effect, _ in assignments(effects, state):
            written.setdefault(fluent, []).append(effect.value.value if isinstance(effect.value, Constant) else None)
    return all(value in written.get(fluent, ()) or None in written.get(fluent, ()) for fluent, value in changed.items())


def _reads(call: ActionCall) -> frozenset[str]:
    action = call.action
    return names(action.precondition) | names(action.invariant) | names(action.end_condition)


def _writes(call: ActionCall) -> frozenset[str]:
    return names_written((*call.action.start_effects, *call.action.end_effects))
