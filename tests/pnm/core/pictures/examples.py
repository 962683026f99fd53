"""Plans that are drawn."""

from __future__ import annotations

from pnm.core.logic.conditions import Holds
from pnm.core.machine.plan_graph import (
    ActionCall,
    Cause,
    Choice,
    Flow,
    GroundAction,
    Loop,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Then,
)
from tests.support.runs.simulated import move


def two_robots() -> PlanGraph:
    """Two robots and six calls; one waits for the other, and the last one for both."""
    calls = (
        ActionCall(0, move("r1", "hall", "door")),
        ActionCall(1, move("r2", "dock", "hall")),
        *(ActionCall(2 + number, move("r1", f"place{number}", f"place{number + 1}")) for number in range(4)),
    )
    chain = (Ordering(PlanEvent(2 + n, Moment.END), PlanEvent(3 + n, Moment.START), (("at", "r1", f"place{n + 1}"),)) for n in range(3))
    free = Ordering(PlanEvent(0, Moment.END), PlanEvent(1, Moment.START), (("free", "hall"), ("open", "door")))
    return PlanGraph(calls, (free, Ordering(PlanEvent(0, Moment.END), PlanEvent(2, Moment.START)), *chain))


def nested_plan() -> PlanGraph:
    """A loop, a choice, a recovery with a chain, and a text with what XML and Graphviz would read as their own."""
    say = GroundAction("say", ("Hello & <bye>",), ("text",))
    sorry = Recovery(frozenset({Cause.ABORTED}), Then.RETRY, Flow((ActionCall(3, say),)))
    loop = Loop(4, Holds(("on",)), Flow((ActionCall(0, say),)), 3)
    choice = Choice(5, Holds(("on",)), Flow((ActionCall(1, say),)), Flow((ActionCall(2, say, recoveries=(sorry,)),)))
    return PlanGraph((loop, choice))
