"""Builder of a machine: places, transitions, rules and roles, as the blocks of steps add them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure, PetriNetMachine, Region, Rule
from pnm.core.machine.plan_graph import Flow, Moment, Ordering, PlanEvent, PlanGraph, Step, Then
from pnm.core.net.net import Marking, NetBuilder


@dataclass(frozen=True, slots=True)
class Context:
    """Context of a block: what surrounds it."""

    repeated: bool = False
    """It may be entered again after it was left."""


@dataclass
class Builder:
    """Collects the net and its roles block by block. The mutable state is what has a default."""

    plan: PlanGraph
    bindings: Bindings
    net: NetBuilder = field(default_factory=NetBuilder)
    rules: dict[str, Rule] = field(default_factory=dict)
    initial: dict[str, int] = field(default_factory=dict)
    failure_places: dict[str, int] = field(default_factory=dict)
    restart_places: dict[str, int] = field(default_factory=dict)
    budget_places: set[str] = field(default_factory=set)
    resource_places: dict[str, str] = field(default_factory=dict)
    alive_places: set[str] = field(default_factory=set)
    settling_places: dict[str, int] = field(default_factory=dict)
    blocks: dict[int, list[str]] = field(default_factory=dict)
    orderings: dict[str, Ordering] = field(default_factory=dict)
    regions: list[Region] = field(default_factory=list)
    into: dict[PlanEvent, list[str]] = field(default_factory=dict)
    """For every event, the places it waits for."""
    out_of: dict[PlanEvent, list[str]] = field(default_factory=dict)
    """For every event, the places it marks."""
    waiting: deque[tuple[Step, Context]] = field(default_factory=deque)
    """Steps whose blocks are still to be built."""

    @cached_property
    def starts_anew(self) -> bool:
        """Whether some recovery has the whole plan begin anew."""
        calls = self.plan.calls
        return any(recovery.then is Then.RESTART_PLAN for call in calls for recovery in call.recoveries)

    def machine(self, goal: str, failed: str, on_failure: OnFailure) -> PetriNetMachine:
        """Return what was collected."""
        return PetriNetMachine(
            plan=self.plan,
            net=self.net.build(),
            initial=Marking(self.initial),
            rules=self.rules,
            goal_place=goal,
            failed_place=failed,
            failure_places=self.failure_places,
            restart_places=self.restart_places,
            budget_places=frozenset(self.budget_places),
            resource_places=self.resource_places,
            settling_places=self.settling_places,
            alive_places=frozenset(self.alive_places),
            blocks={step: tuple(places) for step, places in self.blocks.items()},
            orderings=self.orderings,
            regions=tuple(self.regions),
            on_failure=on_failure,
        )

    def transition(self, name: str, rule: Rule, inputs: dict[str, int] | Iterable[str], outputs: Iterable[str]) -> None:
        """Add a transition and its rule."""
        self.net.transition(name, inputs, outputs)
        self.rules[name] = rule

    def region(self, flow: Flow, owner: int | None, begin: str, end: str, context: Context) -> Region:
        """Make the places between the steps of a flow, and those between its owner and its first and last steps.

        The blocks of the steps are built later.

        Args:
            flow: the steps.
            owner: the step that holds them.
            begin: how the owner's marking of the first places is called.
            end: how the owner's taking of the last places is called.
            context: of the steps.
        """
        steps = {step.index: step for step in flow.steps}
        for number, ordering in enumerate(flow.orderings):
            before, after = ordering.before, ordering.after
            name = f"{before.moment.value} {steps[before.call]} < {after.moment.value} {steps[after.call]} ({number})"
            # A place for each ordering, even between the same events: each is marked once and taken once, so no place holds two tokens.
            place = self.net.place(name)
            self.orderings[place] = ordering
            self.out_of.setdefault(before, []).append(place)
            self.into.setdefault(after, []).append(place)
        first: list[str] = []
        last: list[str] = []
        for step in flow.steps:
            starts, ends = PlanEvent(step.index, Moment.START), PlanEvent(step.index, Moment.END)
            # Only steps that wait for no other are marked by the owner; the others get their tokens along the orderings.
            if starts not in self.into:
                first.append(self.net.place(f"{begin} < {step}"))
                self.into[starts] = [first[-1]]
            # Likewise the owner waits only for those ends that no other step takes from: all others have come before them.
            if ends not in self.out_of:
                last.append(self.net.place(f"{step} < {end}"))
                self.out_of[ends] = [last[-1]]
        if not flow.steps:  # an empty region still needs a place between entering and leaving it, so that the owner has something to take
            first = last = [self.net.place(f"{begin} < {end}")]
        region = Region(owner, frozenset(step.index for step in flow.steps), tuple(first), tuple(last))
        self.regions.append(region)
        self.waiting.extend((step, context) for step in flow.steps)
        return region
