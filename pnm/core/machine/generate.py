"""The frame around all steps: where a machine begins, and where it ends in goal or failed.

Between the two the blocks of all steps are placed one after the other, each by the template that steps of its shape share, and connected
by the places that stand for orderings.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from pnm.core.machine.bindings import Bindings, is_open
from pnm.core.machine.call_block import CallBlock
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import Always, ConditionFalse, ConditionTrue, Due, Ending, Failing, Rule
from pnm.core.machine.machine import END, FAILED, GOAL, START, MachineBlocks, OnFailure, PetriNetMachine, PlacedRegion, PlacedStep
from pnm.core.machine.plan_graph import ActionCall, Held, Moment, PlanEvent, PlanGraph, Step
from pnm.core.machine.step_block import PORTS, Block, BlockTemplate, Context, Draft, Terms, block_without_call
from pnm.core.net.block_net import Remembered
from pnm.core.net.no_collection import no_collection
from pnm.core.resources import check_capacity
from pnm.errors import check_kinds, counted

_TEMPLATES: Final = Remembered[object, BlockTemplate]()
"""Those that blocks of all machines share, by what they depend on."""


class Builder:
    """Places the blocks of a plan. The mutable state is what of the net there is so far."""

    def __init__(self, plan: PlanGraph, bindings: Bindings) -> None:
        self.blocks = MachineBlocks()
        starts_anew = plan.restart_limit > 0
        # If the plan can begin anew, every block can be entered again, and must give back what it has spent.
        self.context = Context(plan, bindings, starts_anew, repeated=starts_anew)
        self.resources: dict[str, int] = {}
        """The place of every resource."""
        self._into: dict[PlanEvent, list[int]] = {}
        """For every event, the places it waits for."""
        self._out_of: dict[PlanEvent, list[int]] = {}
        """For every event, the places it marks."""
        self._delayed: dict[int, list[tuple[int, float]]] = {}
        """For every step, the places that it must come later than they are marked, and by how much."""
        self._waiting: deque[tuple[Step, Context]] = deque()
        """Steps whose blocks are still to be placed."""
        self._templates: dict[object, BlockTemplate] = {}

    def add_steps(self) -> None:
        """Place the blocks of all steps of the regions placed so far, and of those that they hold."""
        # A queue instead of recursion: blocks that hold others add these while they are placed, however deeply they are nested.
        while self._waiting:
            step, context = self._waiting.popleft()
            events = (PlanEvent(step.index, moment) for moment in (Moment.START, Moment.END))
            (starts_after, announces), (ends_after, leads_to) = ((self._into.pop(one, ()), self._out_of.pop(one, ())) for one in events)
            names = self.context.bindings.resources(step.action) if isinstance(step, ActionCall) else ()
            ports = (starts_after, ends_after, announces, leads_to, [self.resources[name] for name in names])
            connected = frozenset(port for port, places in zip(PORTS, ports, strict=True) if places)
            delays = tuple([(self.blocks.place_name(place), delay) for place, delay in self._delayed.get(step.index, ())])
            match step:
                case ActionCall():
                    block: Block[Any] = CallBlock(context, step, connected, delays)
                case _:
                    block = block_without_call(context, step, connected, delays)
            if (key := block.key) is None:
                template = block.template()
            else:
                template = self._templates.get(key) or _TEMPLATES.get(key) or _TEMPLATES.keep(key, block.template())
                self._templates[key] = template
            self.place(template, block.terms, [*map(tuple, ports)])

    def place(self, template: BlockTemplate, terms: Terms[Any] | None = None, ports: Sequence[tuple[int, ...]] = ()) -> PlacedStep:
        """Place the block of a step with these terms, or without any a part of the frame."""
        context, step = (self.context, None) if terms is None else (terms.context, terms.step)
        blocks, place, regions = self.blocks, self.blocks.count_places, list[PlacedRegion]()
        free = place + len(template.places)
        if template.inner:
            held = (Held(context.plan.flow, "always"),) if step is None else step.held
        for inner in template.inner:
            flow, _, is_repeated = held[inner.number]
            regions.append(PlacedRegion(flow, step, inner.what, free))
            self._connect(regions[-1])
            if flow.steps:
                around = replace(context, repeated=is_repeated or context.repeated)
                self._waiting.extend((one, around) for one in flow.steps)
            free += regions[-1].count
            ports = (*ports, *map(regions[-1].bordering, Moment))
        block = PlacedStep(template, step, place, blocks.count_transitions, tuple(ports), terms)
        blocks.place(block)
        for region in regions:
            blocks.add_places(region, region.count)
        blocks.regions += regions
        return block

    def _connect(self, region: PlacedRegion) -> None:
        """Note the places between the steps of a region, and make those between its owner and its first and last steps."""
        flow, into, out_of = region.flow, self._into, self._out_of
        # A place for each ordering that does not follow from others: each is marked once and taken once, so no place holds two tokens.
        for number, ordering in enumerate(region.orderings, region.place):
            out_of.setdefault(ordering.before, []).append(number)
            into.setdefault(ordering.after, []).append(number)
            if ordering.delay > 0:
                self._delayed.setdefault(ordering.after.call, []).append((number, ordering.delay))
        for step in flow.steps:
            starts, ends = PlanEvent(step.index, Moment.START), PlanEvent(step.index, Moment.END)
            # Only steps that wait for no other are marked by the owner; the others get their tokens along the orderings.
            if starts not in into:
                into[starts] = [region.border(starts)]
            # Likewise the owner waits only for those ends that no other step takes from: all others have come before them.
            if ends not in out_of:
                out_of[ends] = [region.border(ends)]
        # An empty region still needs a place between entering and leaving it, so that the owner has something to take.
        if not flow.steps:
            region.border(None)


@no_collection()
def generate(
    plan: PlanGraph,
    bindings: Bindings | None = None,
    *,
    on_failure: OnFailure = OnFailure.DRAIN,
    capacities: Mapping[str, int] | None = None,
) -> PetriNetMachine:
    """Build the machine of a plan.

    Args:
        plan: its steps, with their retries and limits.
        bindings: what retries, limits and resources of calls are taken from besides.
        on_failure: what happens to running calls once a step has failed.
        capacities: how many calls may have a resource at the same time, one for those not listed: those of the `Resources` that the
            machine's runs share with others; the plan's own when not given.

    Raises:
        InputError: the name of a server or a resource has a part in braces that is not a parameter of its action.
    """
    check_kinds("generate", {"plan": (plan, PlanGraph)})
    bindings = bindings or Bindings()
    builder, shared = Builder(plan, bindings), plan.capacities if capacities is None else capacities
    for call in plan.calls:
        if call.action.operation is None:
            bindings.server(call.action)  # refuses a name that cannot be filled: while the machine runs is too late
    beginning = Draft()
    for name in ("start", "end", "goal", "failed"):
        beginning.net.place(name)
    initial = {START: 1}  # the only token besides counters and resources: all others come from it, and end on `goal` or on `failed`
    resources: dict[int, str] = {}
    users = Counter(name for call in plan.calls for name in bindings.resources(call.action))
    # The capacities of the pool that runs share win: a net with more units than the pool would promise what it cannot give.
    for place, (name, count) in enumerate(users.items(), FAILED + 1):
        beginning.net.place(f"resource {name}")
        builder.resources[name], resources[place] = place, name
        # calls may turn out to need different resources under an open name: the net must not be stricter than what runs share
        initial[place] = count if is_open(name) else shared.get(name, 1)
        check_capacity(name, initial[place])
    whole = beginning.region()
    beginning.transition("begin", Rule("begin"), ["start"], whole.first)
    *_, last = builder.place(beginning.template()).ports
    builder.add_steps()
    restarts = [block.place + number for block in builder.blocks.placed for number in block.template.restarts]
    ending = _ending(plan, [builder.blocks.place_name(place) for place in restarts])
    builder.place(ending.template(), ports=[(START,), (END,), (GOAL,), (FAILED,), last, *((place,) for place in restarts)])
    builder.blocks.resources, builder.blocks.marked = resources, initial
    return PetriNetMachine.of_blocks(plan, bindings, builder.blocks, on_failure)


def _ending(plan: PlanGraph, restarts: Sequence[str]) -> Draft:
    """Return the end of the frame, which takes all of the last places of the plan, and requests for restarts from their places."""
    ending = Draft()
    (start,), (end,), (goal,), (failed,), last = map(ending.port, ("start", "end", "goal", "failed", "last"))
    if plan.due:  # added before `finish`, so that a run which is ending does not wait for a time that only the goal needs
        ending.transition("overtaken", Rule("overtaken", Ending()), last, [end])
    ending.transition("finish", Rule("finish", Due(plan.due) if plan.due else Always()), last, [end])
    # Rules of `end` are asked in this order: failures first, then restarts; the goal is only looked at when there are neither.
    ending.transition("ended_by_failure", Rule("ended_by_failure", Failing()), [end], [failed])
    if restarts:
        restarting = ending.net.place("restarting")
        # Each request to restart is taken by a firing of its own: a second one would otherwise stay marked and restart the plan again.
        for place in restarts:
            ending.port(place)
            for source, name in ((end, "restart"), (restarting, "restart_too")):
                ending.transition(f"{name} {place}", Rule(name), [source, place], [restarting])
        # Counted here, for the plan as a whole: what asks for a restart only counts how often it asks itself.
        left, spent = (ending.net.place(f"restarts {name}") for name in ("left", "spent"))
        ending.budgets += (left, spent)
        ending.initial[left] = plan.restart_limit
        ending.transition("begin_anew", Rule("begin_anew", restarts=True), [restarting, left], [start, spent])
        limit = f"the plan to begin anew {counted(plan.restart_limit, 'time')} at most"
        used_up = Rule("restart_limit", cause=Cause.RESTART_LIMIT, expected=limit, observed="one more is asked for")
        ending.transition("restart_limit", used_up, {restarting: 1, spent: plan.restart_limit}, [failed])
    # The last two rules exclude each other, so that one of them opens whatever the world is like.
    ending.transition("goal_holds", Rule("goal_holds", ConditionTrue(plan.goal)), [end], [goal])
    ending.transition("goal_missing", Rule("goal_missing", ConditionFalse(plan.goal), cause=Cause.GOAL_FALSE), [end], [failed])
    return ending
