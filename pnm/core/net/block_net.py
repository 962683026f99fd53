"""Nets of blocks: each block is a template, placed somewhere in the net; what leads into it and out of it are its *ports*.

A template is made once and shared by all blocks that are alike. A block has the numbers of its first place and of its first transition, and
for every port the places that it stands for; arcs, consumers and names follow from that, and are worked out when they are asked for.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Generic, Protocol, TypeAlias, TypeVar

from pnm.core.net.net import PetriNet, unmarked_at_first

NumberedArcs: TypeAlias = list[tuple[int, int]]
"""Places, by number, and the weights of the arcs that connect them to one transition."""
_Codes: TypeAlias = "Iterable[tuple[int, int]]"
"""Places, or ports as negative numbers from -1 downwards, and the weights of the arcs that connect them to one transition."""


class Template:
    """A block by itself: its places and transitions by number, and its ports. All that it consists of cannot be changed."""

    def __init__(self, net: PetriNet, ports: Sequence[str]) -> None:
        """Make the template of a small net, some of whose places are ports."""
        self.places = tuple(place for place in net.places if place not in set(ports))
        self.transitions = tuple(net.transitions)
        self.ports = tuple(ports)
        codes = {place: number for number, place in enumerate(self.places)} | {port: ~number for number, port in enumerate(ports)}
        self.codes: Mapping[str, int] = MappingProxyType(codes)
        self.inputs, self.outputs = (
            tuple(tuple((self.codes[place], weight) for place, weight in arcs[transition].items()) for transition in self.transitions)
            for arcs in (net.inputs, net.outputs)
        )
        consumers: dict[int, list[tuple[int, int]]] = {code: [] for code in self.codes.values()}
        for transition, arcs in enumerate(self.inputs):
            for code, weight in arcs:
                consumers[code].append((transition, weight))
        self.consumers: Mapping[int, tuple[tuple[int, int], ...]] = MappingProxyType({code: tuple(one) for code, one in consumers.items()})
        """For every place and port, the transitions that take from it, and how much."""
        self.unmarked = tuple(map(unmarked_at_first, self.inputs))
        """As `Arcs.unmarked`, but for the transitions that take from ports."""
        self.giving = frozenset(code for arcs in self.outputs for code, _ in arcs)
        """The places and ports that some transition gives to."""
        self.reading = tuple(~number for number in range(len(ports)) if consumers[~number])
        """The ports that some transition takes from."""
        self.counted = frozenset(code for arcs in self.inputs if unmarked_at_first(arcs) for code, _ in arcs if code >= 0)
        """The places, ports apart, that some transition takes from which takes more than one token."""
        self.taking = tuple(number for number, arcs in enumerate(self.inputs) if any(code < 0 for code, _ in arcs))
        """The transitions that take from ports."""

    def numbers(self, *places: str) -> tuple[int, ...]:
        """Return the numbers of places of its own."""
        return tuple(self.codes[place] for place in places)


class Segment(Protocol):
    """A stretch of the places of a net."""

    @property
    def place(self) -> int:
        """The number of its first place."""

    def place_name(self, number: int) -> str:
        """Return the name of one of its places, which are numbered from 0 here."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A block of a net: a template and where it is."""

    template: Template
    title: object
    """What it is for, as text: prefix of its names; None for none."""
    place: int
    """The number of its first place."""
    transition: int
    """The number of its first transition."""
    ports: tuple[tuple[int, ...], ...]
    """For every port, the places that it stands for."""

    def place_name(self, number: int) -> str:
        """Return the name of a place of its own."""
        name = self.template.places[number]
        return name if self.title is None else f"{self.title} {name}"

    def all_at(self, codes: Iterable[int]) -> list[int]:
        """Return the places that have these codes in the template: its own by their numbers, those of ports by negative ones."""
        return [place for place, _ in self.arcs((code, 1) for code in codes)]

    def arcs(self, arcs: _Codes) -> NumberedArcs:
        """Return arcs of the template as they are in the net."""
        found: list[tuple[int, int]] = []
        for code, weight in arcs:
            if code >= 0:
                found.append((self.place + code, weight))
            else:
                found += [(place, weight) for place in self.ports[~code]]
        return found


AnyPlaced = TypeVar("AnyPlaced", bound=Placed)


def whole(net: PetriNet) -> Placed:
    """Return a net as one block."""
    return Placed(Template(net, ()), None, 0, 0, ())


class BlockArcs(Generic[AnyPlaced]):
    """The blocks of a net, and the places between them. The mutable state is all of it, until the last block is placed."""

    def __init__(self) -> None:
        self.placed: list[AnyPlaced] = []
        """In the order of their transitions."""
        self.segments: list[Segment] = []
        """In the order of their places."""
        self._first_transitions: list[int] = []
        self._first_places: list[int] = []
        self.count_places = self.count_transitions = 0

    # --- building -----------------------------------------------------------------------------

    def add_places(self, segment: Segment, count: int) -> None:
        """Add a stretch of places."""
        if count:
            self.segments.append(segment)
            self._first_places.append(segment.place)
            self.count_places += count

    def place(self, block: AnyPlaced) -> None:
        """Add a block."""
        self.add_places(block, len(block.template.places))
        self.placed.append(block)
        self._first_transitions.append(block.transition)
        self.count_transitions += len(block.template.transitions)

    # --- by number ----------------------------------------------------------------------------

    def index_of(self, transition: int) -> int:
        """Return which of the blocks has the transition."""
        return bisect_right(self._first_transitions, transition) - 1

    def segment_of(self, place: int) -> Segment:
        """Return the stretch in which a place is."""
        return self.segments[bisect_right(self._first_places, place) - 1]

    def inputs(self, transition: int) -> list[tuple[int, int]]:
        """Return the places that the transition takes from, and how much of each."""
        block = self.placed[self.index_of(transition)]
        return block.arcs(block.template.inputs[transition - block.transition])

    def outputs(self, transition: int) -> list[tuple[int, int]]:
        """Return the places that it gives to, and how much to each."""
        block = self.placed[self.index_of(transition)]
        return block.arcs(block.template.outputs[transition - block.transition])

    def consumers(self, place: int) -> list[tuple[int, int]]:
        """Return the transitions that take from the place, in their order, and how much each does."""
        block, found = self.segment_of(place), list[tuple[int, int]]()
        if isinstance(block, Placed):
            found += [(block.transition + number, weight) for number, weight in block.template.consumers[place - block.place]]
        for reader, port in self.readers.get(place, ()):
            found += [(reader.transition + number, weight) for number, weight in reader.template.consumers[port]]
        return sorted(found) if len(found) > 1 else found

    def unmarked(self) -> list[int]:
        """Return for every transition from how many places it takes; 0 for those that take one token from one place."""
        counts: list[int] = []
        for block in self.placed:
            template = block.template
            counts += template.unmarked
            for number in template.taking:
                counts[block.transition + number] = unmarked_at_first(block.arcs(template.inputs[number]))
        return counts

    def counted(self) -> bytearray:
        """Return for every place whether some transition takes from it which takes more than one token."""
        found = bytearray(self.count_places)
        for block in self.placed:
            template = block.template
            for code in template.counted:
                found[block.place + code] = True
            for number in template.taking:
                arcs = block.arcs(template.inputs[number])
                if unmarked_at_first(arcs):
                    for place, _ in arcs:
                        found[place] = True
        return found

    @cached_property
    def readers(self) -> Mapping[int, list[tuple[AnyPlaced, int]]]:
        """For every place that ports stand for, the blocks that take from it there, each with its port."""
        return self._linked(reading=True)

    @property
    def writers(self) -> Mapping[int, list[tuple[AnyPlaced, int]]]:
        """For every place that ports stand for, the blocks that give to it there, each with its port."""
        return self._linked(reading=False)

    def _linked(self, *, reading: bool) -> dict[int, list[tuple[AnyPlaced, int]]]:
        found: dict[int, list[tuple[AnyPlaced, int]]] = {}
        for block in self.placed:
            for number, places in enumerate(block.ports):
                if places and (block.template.consumers[~number] if reading else ~number in block.template.giving):
                    for place in places:
                        found.setdefault(place, []).append((block, ~number))
        return found
