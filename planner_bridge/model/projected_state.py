"""Present state: the world with what runs have begun, which sensors may not have reported yet; while a robot moves, say, it is nowhere.

Projected state: the world as it will be when all that has ended.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Changes, changes, written
from pnm.core.logic.expressions import UNKNOWN, Fluent, same_value
from pnm.core.machine.plan_graph import ActionCall, Moment, PlanEvent
from pnm.errors import PnmError

if TYPE_CHECKING:
    from pnm.core.execution.run_view import RunView


class NotProjectable(PnmError):
    """A call cannot end in the projected state."""


def present_state(state: KnowledgeBase, runs: Iterable[RunView]) -> KnowledgeBase:
    """Return the state with what the calls of these runs have changed at their start and no sensor has spoken of since.

    A call under way is taken to succeed, so its start is taken to have come about as well, until a sensor says something else: with
    one that is slower than the others, a robot would otherwise be planned with where it has just left.
    """
    begun = {fluent: value for run in runs for fluent, value in run.unreported.items()}
    if not begun:
        return state
    present = snapshot(state)
    present.update(begun)
    return present


def projected_state(state: KnowledgeBase, runs: Iterable[RunView], beside: Iterable[RunView] = ()) -> KnowledgeBase:
    """Return the state once the calls of these runs have ended as the domain says, while those of the runs beside them go on.

    Calls that have ended count as well, as long as their effects are still looked for. What a call writes that has begun, and is being
    cancelled or not accepted yet, is unknown.

    Raises:
        NotProjectable: one of them cannot end.
    """
    runs = tuple(runs)
    simulation, numbers, unknown = Progression(snapshot(present_state(state, (*runs, *beside)))), count(), set[Fluent]()
    for run in runs:
        for call in run.settling:
            simulation.state.update(_still_to_come(run, call, simulation.state, state))
        going_on = {request.request: request for request in run.under_way()}
        for call in (call for request, call in run.open_calls.items() if request not in going_on and _has_begun(call, state)):
            unknown.update(written((*call.action.start_effects, *call.action.end_effects), state))
        for request in going_on.values():
            simulation.running[next(numbers)] = replace(request.call.action, end_effects=request.intended.end_effects)
    actions = dict(simulation.running)
    try:
        for number, action in actions.items():
            simulation.advance([(PlanEvent(number, Moment.END), action)])
    except NotApplicable as error:
        raise NotProjectable(f"{actions[error.call]} would {error.stage} although {error.observed}") from error
    simulation.state.update(dict.fromkeys(unknown, UNKNOWN))
    return simulation.state


def _still_to_come(run: RunView, call: ActionCall, simulated: KnowledgeBase, reported: KnowledgeBase) -> Changes:
    """Return what a call that has ended is still going to change, as far as the domain says."""
    changed = changes(call.action.end_effects, simulated)
    waits = any(ordering.after == PlanEvent(call.index, Moment.END) for ordering in run.machine.plan.orderings)
    # what nothing reports was written when it ended, if its end in the plan has to wait for others
    return {fluent: value for fluent, value in changed.items() if reported.is_sensed(fluent)} if waits else changed


def _has_begun(call: ActionCall, state: KnowledgeBase) -> bool:
    """Return whether the facts that its start brings about are there, so that its end would have to follow."""
    started = {fluent: value for fluent, value in changes(call.action.start_effects, state).items() if isinstance(value, bool | str)}
    return bool(started) and all(same_value(state.value(fluent), value) for fluent, value in started.items())
