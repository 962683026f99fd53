"""A machine taken apart for its proof: blocks, one per step, the regions they stand in, and what connects them.

The regions that a machine declares are not trusted: they are compared with the net.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, product
from typing import Final, TypeAlias

from pnm.core.machine.guards import ConditionFalse, ConditionTrue
from pnm.core.machine.machine import OnFailure, PetriNetMachine, Region
from pnm.core.machine.plan_graph import Conditional, Moment
from pnm.core.machine.requests import CallOutcome
from pnm.core.machine.verification.part import Inside, Part, PartStep, Unsound, step_of, without_counts
from pnm.core.net.net import Weights

Owner: TypeAlias = int | None
"""The number of a step, or None for the frame around all of them."""
Event: TypeAlias = tuple[Owner, str]
"""The start or the end of a block, or the marking of one of its places."""
ENOUGH: Final = 2
"""Counters larger than two are verified as two: guards only distinguish none, some and all spent."""


@dataclass(frozen=True, slots=True)
class PlacedBlock:
    """A block and what connects it to others of its region."""

    owner: Owner
    part: Part
    first: tuple[str, ...]
    """Inputs that its start waits for."""
    rest: tuple[str, ...]
    """Inputs that only its end waits for."""
    early: frozenset[str]
    """Outputs that its start gives."""


Owners: TypeAlias = Mapping[str, set[Owner]]
"""Blocks by the places that they are connected to."""


class Anatomy:
    """The blocks and regions of a machine, or of a sample of one.

    Args:
        beside: the blocks that are left out of the sample, by the places that they give to, and by those that they take from.

    Raises:
        Unsound: a place makes a forbidden connection, or regions are not what the machine declares.
    """

    def __init__(self, machine: PetriNetMachine, beside: tuple[Owners, Owners] = ({}, {})) -> None:
        self.machine = machine
        self.transitions: dict[Owner, list[str]] = {None: []}
        for name, rule in machine.rules.items():
            self.transitions.setdefault(rule.call, []).append(name)
        self.writers, self.readers = map(self._owners, (machine.net.outputs, machine.net.inputs), beside)
        self.holding = {step.index: step for step in machine.plan.every_step if isinstance(step, Conditional)}
        """The loops, choices and waits of the plan."""
        self.region_of: dict[Owner, Region] = {}
        self.regions: dict[Owner, list[Region]] = {}
        self.first: dict[str, Region] = {}
        self.last: dict[str, Region] = {}
        for region in machine.regions:
            for step in region.steps:
                if step in self.region_of:
                    raise Unsound(f"step {step} stands in two regions")
                self.region_of[step] = region
            if region.steps:  # a region without steps is a single place inside the block of its owner, and needs no entry
                self.regions.setdefault(region.owner, []).append(region)
                self.first |= dict.fromkeys(region.first, region)
                self.last |= dict.fromkeys(region.last, region)
        self._check_nesting()  # the proof goes from the innermost steps outwards: owners in a circle would be left out of it
        self._check_lasting(check_roles(machine))
        self.between = frozenset(filter(self._is_between, machine.net.places))
        """Places that connect blocks, or should."""
        for place in self.between:
            self._check_channel(place)
        for regions in self.regions.values():
            for region in regions:
                self._check_entry(region)

    def _owners(self, weights: Mapping[str, Weights], beside: Owners) -> dict[str, set[Owner]]:
        owners: dict[str, set[Owner]] = {place: {*beside.get(place, ())} for place in self.machine.net.places}
        for transition, connected in weights.items():
            owner = self.machine.rules[transition].call
            for place in connected:
                owners[place].add(owner)
        return owners

    def _is_between(self, place: str) -> bool:
        # Many blocks share these by design; that each takes all it needs at once is checked by `_resources`.
        if place in self.machine.resource_places:
            return False
        # A place that only one block reads and writes is inside that block, unless it has a role between blocks.
        readers = self.readers[place]
        between = len(readers) != 1 or readers != self.writers[place]
        return between or place in self.machine.orderings or place in self.first or place in self.last

    # --- checks -------------------------------------------------------------------------------

    def _check_nesting(self) -> None:
        """Check that every block stands in a region, and that its owners lead to the frame."""
        proved: set[Owner] = {None}
        for owner in self.transitions:
            chain: list[Owner] = []
            while owner not in proved:
                if owner not in self.region_of or owner in chain:
                    raise Unsound(f"step {owner} stands in no region of the plan")
                chain.append(owner)
                owner = self.region_of[owner].owner
            proved.update(chain)

    def _check_lasting(self, start: str) -> None:
        """Check that only the frame takes from the start, nothing from failures and final places, and that counters are of one block."""
        machine = self.machine
        if self.readers[start] != {None} or self.writers[start] - {None}:
            raise Unsound(f"{start} is not where the frame begins")
        for place in (machine.goal_place, machine.failed_place, *machine.failure_places):
            if self.readers[place]:
                raise Unsound(f"step {min(self.readers[place], key=str)} takes from {place}, which stays as it is")
        for place, call in machine.failure_places.items():
            if self.writers[place] - {call}:
                raise Unsound(f"{place} marks the failure of another call than its own")
        for place in machine.budget_places:
            if len(self.readers[place] | self.writers[place]) > 1:
                raise Unsound(f"{place} counts for more than one step")

    def _check_channel(self, place: str) -> None:
        """Check that the place connects two blocks at most: neighbours, or a step and what holds it."""
        readers, outside = self.readers[place], self.writers[place] - self.readers[place]
        # A block may write to the place that it reads (it gives back what it looked at), hence two writers but one from outside.
        if len(readers) > 1 or len(outside) > 1 or len(self.writers[place]) > 2:
            raise Unsound(f"{place} connects more than two blocks")
        # The order of waits is proved free of cycles over these places, so they must connect what they claim to connect.
        if place in self.machine.orderings:
            ordering = self.machine.orderings[place]
            if outside != {ordering.before.call} or readers != {ordering.after.call}:
                raise Unsound(f"{place} does not connect the calls of its ordering {ordering}")
        entered, left = self.first.get(place), self.last.get(place)
        if (entered or left) and not (readers and outside):
            raise Unsound(f"{place} does not connect a step and its owner")
        # Nothing passes between two blocks here; restarts go from any depth to the frame, which is explored with them.
        if not readers or not outside or place in self.machine.restart_places:
            return
        (writer,), (reader,) = outside, readers
        if entered or left:
            good = entered is None or (writer == entered.owner and self.region_of.get(reader) is entered)
            good = good and (left is None or (reader == left.owner and self.region_of.get(writer) is left))
        else:
            good = None not in (writer, reader) and self.region_of.get(writer) is self.region_of.get(reader)
        if not good:
            raise Unsound(f"{place} connects steps that do not stand beside each other")

    def _check_entry(self, region: Region) -> None:
        first, last = frozenset(region.first), frozenset(region.last)
        for name in self.transitions[region.owner]:
            marked = first.intersection(self.machine.net.outputs[name])
            taken = last.intersection(self.machine.net.inputs[name])
            # Entered or left in part, the block inside would not get all its inputs, as its exploration assumes.
            if 0 < len(marked) < len(region.first) or 0 < len(taken) < len(region.last):
                raise Unsound(f"{name} enters or leaves only some of the steps it holds")

    # --- blocks -------------------------------------------------------------------------------

    def block(self, owner: Owner) -> PlacedBlock:
        """Cut the block of a step, or the frame, out of the machine; what it holds becomes a single step."""
        machine = self.machine
        regions = self.regions.get(owner, [])
        own_records = self._restarts if owner is None else ()
        # Where restarts are alike only some are explored, and the transitions of the others are left out with them.
        left_out = machine.restart_places.keys() - set(own_records) if owner is None else frozenset[str]()
        own = [step_of(machine, name) for name in self.transitions[owner]]
        steps = (*(step for step in own if left_out.isdisjoint(step.inputs)), *self._inside(regions))
        owed: tuple[Owner, ...] = (owner,) if owner in range(len(machine.plan.calls)) else ()  # a junction owes nothing
        if owner in self.holding or (owner is None and regions):
            owed, steps = (None,), tuple(self._holding(owner, step) for step in steps)
        places = dict.fromkeys(chain.from_iterable(connected for step in steps for connected in (step.inputs, step.outputs)))
        held = {place for region in regions for place in (*region.first, *region.last)}
        ends = frozenset((machine.goal_place, machine.failed_place))
        finals = ends if owner is None else frozenset[str]()
        between = [place for place in places if place in self.between and place not in held and place not in machine.restart_places]
        inputs = [place for place in between if owner in self.readers[place] and self.writers[place] - {owner}]
        written = [place for place in between if owner in self.writers[place] and place not in finals]
        outputs = [place for place in written if place in ends or self.readers[place] - {owner}]
        given = frozenset(chain.from_iterable(step.outputs for step in steps))
        # An input that the block also puts back is looked at late, at its end; all others are needed to start.
        first = tuple(place for place in inputs if place not in given)
        rest = tuple(place for place in inputs if place in given)
        for step, together in product(steps, (first, rest)):
            if 0 < sum(place in step.inputs for place in together) < len(together):
                raise Unsound(f"{step.name} takes only some of the inputs {list(together)}")
        early = frozenset(
            place for place in outputs if place in machine.orderings and machine.orderings[place].before.moment is Moment.START
        )
        resources = frozenset(place for place in places if place in machine.resource_places)
        # The block is explored with exactly what it takes: that others give it back is proved for them, each on its own.
        taken = _resources(steps, {place: machine.initial[place] for place in resources})
        initial = {place: machine.initial[place] for place in places if machine.initial[place] and place not in resources}
        counters = frozenset(place for place in places if place in machine.counter_places).union(map(_may_come, own_records))
        budgets = counters & machine.budget_places
        steps, initial, left = without_counts(steps, initial, budgets)
        places = dict.fromkeys(place for place in places if place not in budgets or place in left)
        counters = counters - budgets | left
        part = Part(
            places=tuple(places),
            steps=steps,
            initial={**initial, **taken, **{_may_come(record): ENOUGH for record in own_records}},
            supplies=tuple(together for together in (first, rest) if together),
            failures=frozenset(place for place in counters if place in machine.failure_places),
            records=counters,
            counters=counters,
            cancels=machine.on_failure is OnFailure.CANCEL,
            outputs=frozenset(outputs),
            ends=frozenset(outputs) - early,
            finals=finals,
            goal=machine.goal_place if owner is None else "",
            early=early if rest else frozenset(),
            restarts=frozenset(own_records) if owner is None else frozenset(place for place in places if place in machine.restart_places),
            # Any other step may ask for a restart at any moment; for the frame these are its own records.
            others_restart=bool(machine.restart_places) and owner is not None,
            repeats=owner is not None and (bool(machine.restart_places) or self.region_of[owner].owner is not None),
            resources=resources,
            alive=frozenset(machine.alive_places & places.keys()),
            settling=frozenset(place for place in places if machine.settling_places.get(place, -1) == owner),
            owed=owed,
        )
        return PlacedBlock(owner, part, first, rest, early)

    @cached_property
    def _restarts(self) -> tuple[str, ...]:
        """Return places that steps inside the frame mark to have the plan begin anew: all, or as many as matter.

        If the frame treats all of them alike, what can happen depends on whether none, one or several are marked.
        """
        machine, places = self.machine, self.machine.restart_places
        taking: dict[str, list[object]] = {place: [machine.initial[place], place in machine.failure_places] for place in places}
        numbers: list[int] = []
        for number, name in enumerate(self.transitions[None]):
            inputs, outputs = machine.net.inputs[name], machine.net.outputs[name]
            touched = [place for place in (*inputs, *outputs) if place in taking]
            if touched:
                rest = {place: weight for place, weight in inputs.items() if place not in taking}
                taking[touched[0]].append((machine.rules[name].guard, rest, inputs.get(touched[0]), outputs))
                numbers.append(number)
            # Treated together or put back: how many are marked could matter then, so all of them are explored.
            if len(touched) > 1 or any(place in taking for place in outputs):
                return tuple(places)
        are_alike = all(taken == next(iter(taking.values())) for taken in taking.values())
        # Rules are asked in order: others between these could tell the first from the last.
        stand_together = not numbers or numbers == [*range(numbers[0], numbers[-1] + 1)]
        return tuple(places)[:ENOUGH] if are_alike and stand_together else tuple(places)

    def _inside(self, regions: Iterable[Region]) -> Iterable[PartStep]:
        """Return one step in the place of all that happens inside each region."""
        for region in regions:
            first = dict.fromkeys(region.first, 1)
            yield PartStep("inside", Inside(), first, dict.fromkeys(region.last, 1))
            if region.owner is None:
                for place in self._restarts:
                    yield PartStep("restart asked", Inside(), {**first, _may_come(place): 1}, {**first, place: 1})

    def _holding(self, owner: Owner, step: PartStep) -> PartStep:
        """Return a step of a loop, a choice or the frame with what it means for that: what it holds is entered, or it may be left."""
        entered = frozenset[int]().union(
            *(region.steps for region in self.regions.get(owner, ()) if not step.outputs.keys().isdisjoint(region.first))
        )
        if owner is None:
            settles = isinstance(step.guard, Inside) and not entered
        else:
            condition, ways = self.holding[owner].condition, self.holding[owner].ways
            guards = {truth: ConditionTrue(condition) if truth else ConditionFalse(condition) for truth in ways}
            settles = any(step.guard == guards[truth] and entered == {inner.index for inner in flow.steps} for truth, flow in ways.items())
        return step._replace(settles=settles, outcome=CallOutcome.WAITING if entered and not settles else None)

    def note_waits(self, block: PlacedBlock, waits: dict[Event, set[Event]]) -> None:
        """Note which events of other blocks of the same region the events of this block wait for."""
        start, end = (block.owner, "start"), (block.owner, "end")
        waits.setdefault(end, set()).add(start)
        for places, event in ((block.first, start), (block.rest, end)):
            for place in places:
                (writer,) = self.writers[place] - {block.owner}  # `_check_channel` has made sure that there is exactly one
                if place not in self.first:
                    waits.setdefault(event, set()).add((writer, f"start of {place}"))
        for place in block.part.outputs:
            waits.setdefault((block.owner, f"start of {place}"), set()).add(start if place in block.early else end)


def _may_come(place: str) -> str:
    """Name the counter of how often the place may still be marked from outside, for the exploration to end."""
    return f"{place} may come"


def _resources(steps: Iterable[PartStep], resources: Mapping[str, int]) -> dict[str, int]:
    """Return the resources that the block takes; it must take all of them at once.

    That it has none of it when it does, is explored: there is only so much for it.
    """
    taken: dict[str, int] = {}
    if not resources:
        return taken
    for step in steps:
        wanted = {place: weight for place, weight in step.inputs.items() if place in resources}
        if wanted and taken not in ({}, wanted):
            raise Unsound(f"{step.name} waits for {', '.join(wanted)} while it may hold resources that others wait for")
        for place, weight in wanted.items():
            if weight > resources[place]:
                raise Unsound(f"{step.name} takes {weight} of {place}, and there is {resources[place]}")
        taken |= wanted
    return taken


def check_roles(machine: PetriNetMachine) -> str:
    """Return the place where the machine begins; raise `Unsound` if a place has two roles, or more is marked than budgets and resources."""
    roles: tuple[Iterable[str], ...] = (
        *((machine.goal_place,), (machine.failed_place,), machine.failure_places, machine.restart_places),
        *(machine.budget_places, machine.resource_places, machine.orderings, machine.border_places),
    )
    places = set[str]()
    for role in roles:
        if not places.isdisjoint(role):
            raise Unsound(f"{next(place for place in role if place in places)} has two roles")
        places.update(role)
    moving = frozenset(machine.alive_places).union(machine.settling_places)
    if not places.isdisjoint(moving):
        raise Unsound(f"{min(places & moving)} is no place of a call that is under way")
    if missing := (places | moving).difference(machine.net.places):
        raise Unsound(f"{min(missing)} is no place of the net")
    marked = [place for place in machine.initial if place not in machine.budget_places and place not in machine.resource_places]
    if len(marked) != 1 or machine.initial[marked[0]] != 1 or marked[0] in places or marked[0] in moving:
        raise Unsound(f"{', '.join(marked) or 'nothing'} is marked at first; expected one place without a role, and one token")
    return marked[0]
