"""What benchmarks execute: nets and plans of any size, and runs whose requests are answered at once."""

from __future__ import annotations

from dataclasses import replace

from pnm.core.execution.events import Begin, Send
from pnm.core.execution.run import Run
from pnm.core.logic.conditions import All, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, Fluent
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.net.block_net import BlockNet, Engine, Placed
from pnm.core.net.net import NetBuilder, PetriNet
from tests.support.benchmarks.peers.nets import Arcs, places_of


def loop(turns: int = 1_000_000) -> None:
    total = 0
    for turn in range(turns):
        total += turn & 1


def net_of(arcs: Arcs) -> PetriNet:
    """The net of these arcs."""
    net = NetBuilder()
    places = [net.place(f"p{place}") for place in places_of(arcs)]
    for number, (before, after) in enumerate(arcs):
        net.transition(f"t{number}", [places[place] for place in before], [places[place] for place in after])
    return net.build()


def firings(net: BlockNet[Placed]) -> int:
    """Fire until nothing is enabled, following the token of the first place; return the number of firings."""
    engine = Engine(net, {0: 1})
    agenda, fired = [0], 0
    while agenda:
        place = agenda.pop()
        for transition, _ in net.consumers[place]:
            if engine.is_enabled(transition):
                engine.fire(transition)
                fired += 1
                agenda.extend(one for one, _ in net.outputs[transition])
    return fired


def side_by_side(calls: int) -> PlanGraph:
    """Calls that have nothing to do with each other."""
    return PlanGraph(tuple(ActionCall(index, GroundAction("no_op")) for index in range(calls)))


def in_a_row(calls: int) -> PlanGraph:
    """Calls that wait for each other."""
    ends = (Ordering(PlanEvent(index, Moment.END), PlanEvent(index + 1, Moment.START)) for index in range(calls - 1))
    return replace(side_by_side(calls), orderings=tuple(ends))


def inline(run: Run) -> int:
    """Answer every request at once; return how many there were."""
    waiting, answered = run.handle(Begin(), 0.0), 0
    while waiting:
        command = waiting.pop()
        if isinstance(command, Send):
            answered += 1
            waiting += run.handle(Accepted(command.request.id), 0.0)
            waiting += run.handle(Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED)), 0.0)
    assert run.result().goal
    return answered


def checked(calls: int) -> tuple[PlanGraph, dict[Fluent, bool]]:
    """Calls in a row that need two facts and bring about one; and the facts that hold at first."""
    place = ("free", "kitchen")
    actions = (
        GroundAction(
            "clean",
            (f"r{index}", "kitchen"),
            ("robot", "room"),
            All((Holds(("ready", f"r{index}")), Holds(place))),
            end_effects=(Set(("done", f"r{index}"), Constant(True)),),
        )
        for index in range(calls)
    )
    found = tuple(ActionCall(index, action) for index, action in enumerate(actions))
    return replace(in_a_row(calls), steps=found), {place: True, **{("ready", f"r{index}"): True for index in range(calls)}}
