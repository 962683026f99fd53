"""Nets of blocks and the engine that fires them: each block is a template, placed in a net; what leads into and out of it are its *ports*.

A template is made once and shared by all blocks that are alike. A block has the numbers of its first place and of its first transition, and
for every port the places that it stands for; arcs, consumers and names follow from that. A net by itself is one block without ports.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, Generic, Protocol, Self, TypeAlias, TypeVar, cast
from weakref import ref

from pnm.core.net.net import Marking, PetriNet
from pnm.errors import NotEnabled

NumberedArcs: TypeAlias = list[tuple[int, int]]
"""Places, by number, and the weights of the arcs that connect them to one transition."""
_Codes: TypeAlias = tuple[tuple[int, int], ...]
"""Places, or ports as negative numbers from -1 downwards, and the weights of the arcs that connect them to one transition."""


@dataclass(frozen=True, eq=False)
class Template:
    """A block by itself: its places and transitions by number, and its ports, which have the codes -1, -2 and so on.

    Nothing of it can be written to: machines that are made later share it, and what was proved of it.
    """

    places: tuple[str, ...]
    transitions: tuple[str, ...]
    ports: tuple[str, ...]
    inputs: tuple[_Codes, ...]
    """For every transition, what it takes from."""
    outputs: tuple[_Codes, ...]
    """For every transition, what it gives to."""

    @classmethod
    def of(cls, net: PetriNet, ports: Sequence[str] = (), **others: Any) -> Self:
        """Make the template of a small net, some of whose places are ports."""
        places = tuple([place for place in net.places if place not in ports])
        codes = {place: number for number, place in enumerate(places)} | {port: ~number for number, port in enumerate(ports)}
        arcs = (
            tuple([tuple([(codes[place], weight) for place, weight in one[name].items()]) for name in net.inputs])
            for one in (net.inputs, net.outputs)
        )
        return cls(places, tuple(net.inputs), tuple(ports), *arcs, **others)

    @cached_property
    def codes(self) -> Mapping[str, int]:
        """The code of every place and port."""
        return MappingProxyType(
            {name: number for number, name in enumerate(self.places)} | {name: ~number for number, name in enumerate(self.ports)}
        )

    @cached_property
    def consumers(self) -> Mapping[int, Sequence[tuple[int, int]]]:
        """For every place and port, the transitions that take from it, and how much."""
        consumers: dict[int, list[tuple[int, int]]] = {code: [] for code in self.codes.values()}
        for transition, arcs in enumerate(self.inputs):
            for code, weight in arcs:
                consumers[code].append((transition, weight))
        return MappingProxyType({code: tuple(found) for code, found in consumers.items()})

    @cached_property
    def giving(self) -> frozenset[int]:
        """The places and ports that some transition gives to."""
        return frozenset(code for arcs in self.outputs for code, _ in arcs)

    @cached_property
    def reading(self) -> Sequence[int]:
        """The ports that some transition takes from."""
        return tuple([~number for number in range(len(self.ports)) if self.consumers[~number]])

    @cached_property
    def unmarked(self) -> Sequence[int]:
        """As `BlockNet.unmarked`, but for the transitions that take from ports."""
        return tuple([_unmarked(arcs) for arcs in self.inputs])

    @cached_property
    def counted(self) -> frozenset[int]:
        """The places, ports apart, that some transition takes from which takes more than one token."""
        return frozenset(code for arcs in self.inputs if _unmarked(arcs) for code, _ in arcs if code >= 0)

    @cached_property
    def taking(self) -> Sequence[int]:
        """The transitions that take from ports."""
        return tuple([number for number, arcs in enumerate(self.inputs) if any(code < 0 for code, _ in arcs)])


def _unmarked(inputs: Sequence[tuple[int, int]]) -> int:
    """Return how many places a transition takes from; 0 if it takes one token from one place."""
    return 0 if len(inputs) == 1 and inputs[0][1] == 1 else len(inputs)


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
    """Its purpose, as text: prefix of its names; None for none."""
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

    def transition_name(self, number: int) -> str:
        """Return the name of one of its transitions, which are numbered from 0 here."""
        name = self.template.transitions[number]
        return name if self.title is None else f"{self.title} {name}"

    def all_at(self, codes: Iterable[int]) -> list[int]:
        """Return the places that have these codes in the template: its own by their numbers, those of ports by negative ones."""
        return [place for place, _ in self.arcs((code, 1) for code in codes)]

    def arcs(self, arcs: Iterable[tuple[int, int]]) -> NumberedArcs:
        """Return arcs of the template as they are in the net."""
        found: list[tuple[int, int]] = []
        for code, weight in arcs:
            if code >= 0:
                found.append((self.place + code, weight))
            else:
                found += [(place, weight) for place in self.ports[~code]]
        return found


AnyPlaced = TypeVar("AnyPlaced", bound=Placed)


class BlockNet(Generic[AnyPlaced]):
    """A net by number: its blocks, and the places between them. The mutable state is all of it, until the last block is placed.

    What it knows of a transition or a place is worked out when it is first asked for, and kept: most transitions never fire.
    """

    def __init__(self) -> None:
        self.placed: list[AnyPlaced] = []
        """In the order of their transitions."""
        self.segments: list[Segment] = []
        """In the order of their places."""
        self._first_transitions: list[int] = []
        self._first_places: list[int] = []
        self.count_places = self.count_transitions = 0
        # worked out so far
        self.inputs: Final[WhenAsked[int, NumberedArcs]] = WhenAsked(self, partial(BlockNet._arcs, of=attrgetter("inputs")))
        """For every transition, the places that it takes from, and how much of each."""
        self.outputs: Final[WhenAsked[int, NumberedArcs]] = WhenAsked(self, partial(BlockNet._arcs, of=attrgetter("outputs")))
        """The places that it gives to, and how much to each."""
        self.only_input: Final[WhenAsked[int, int | None]] = WhenAsked(
            self, lambda net, one: net.inputs[one][0][0] if net.inputs[one] and not net.unmarked[one] else None
        )
        """For every transition that takes one token from one place, that place."""
        self.consumers: Final = WhenAsked(self, BlockNet._consumers)
        """For every place, the transitions that take from it, in their order, and how much each does."""
        self.joins: Final[WhenAsked[int, NumberedArcs]] = WhenAsked(
            self, lambda net, place: [(one, weight) for one, weight in net.consumers[place] if net.unmarked[one]]
        )
        """Those of them that take more than one token."""

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

    # --- places and transitions -----------------------------------------------------------------

    def block_of(self, transition: int) -> AnyPlaced:
        """Return the block that the transition belongs to."""
        return self.placed[bisect_right(self._first_transitions, transition) - 1]

    def segment_of(self, place: int) -> Segment:
        """Return the stretch in which a place is."""
        return self.segments[bisect_right(self._first_places, place) - 1]

    def place_name(self, place: int) -> str:
        """Return the name of a place."""
        segment = self.segment_of(place)
        return segment.place_name(place - segment.place)

    def transition_name(self, transition: int) -> str:
        """Return the name of a transition."""
        block = self.block_of(transition)
        return block.transition_name(transition - block.transition)

    def _arcs(self, transition: int, of: Callable[[Template], Sequence[_Codes]]) -> NumberedArcs:
        block = self.block_of(transition)
        return block.arcs(of(block.template)[transition - block.transition])

    def _consumers(self, place: int) -> NumberedArcs:
        block, found = self.segment_of(place), list[tuple[int, int]]()
        if isinstance(block, Placed):
            found += [(block.transition + number, weight) for number, weight in block.template.consumers[place - block.place]]
        for reader, port in self.readers.get(place, ()):
            found += [(reader.transition + number, weight) for number, weight in reader.template.consumers[port]]
        return sorted(found) if len(found) > 1 else found

    @cached_property
    def unmarked(self) -> list[int]:
        """For every transition from how many places it takes; 0 for those that take one token from one place."""
        counts: list[int] = []
        for block in self.placed:
            template = block.template
            counts += template.unmarked
            for number in template.taking:
                counts[block.transition + number] = _unmarked(block.arcs(template.inputs[number]))
        return counts

    @cached_property
    def counted(self) -> bytearray:
        """For every place whether some transition takes from it which takes more than one token."""
        found = bytearray(self.count_places)
        for block in self.placed:
            template = block.template
            for code in template.counted:
                found[block.place + code] = True
            for number in template.taking:
                arcs = block.arcs(template.inputs[number])
                if _unmarked(arcs):
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


def block_net(net: PetriNet) -> BlockNet[Placed]:
    """Return a net as one block."""
    blocks = BlockNet[Placed]()
    blocks.place(Placed(Template.of(net), None, 0, 0, ()))
    return blocks


# --- firing ---------------------------------------------------------------------------------------


class Engine:
    """A net and its current marking.

    The mutable state is `tokens`, per place, and `missing`, per transition the number of places that hold too little; it stays at 0 for
    those that take one token.
    """

    def __init__(self, net: BlockNet[Any], marking: Mapping[int, int]) -> None:
        self.net, self._counted, self._joins = net, net.counted, net.joins
        self.tokens = [0] * net.count_places
        self.missing = net.unmarked.copy()
        # An initial marking is added like any other tokens.
        for place, count in marking.items():
            self._add(place, count)

    def put(self, tokens: Mapping[int, int]) -> None:
        """Have so many tokens on these places."""
        for place, count in tokens.items():
            self._add(place, count - self.tokens[place])

    def is_enabled(self, transition: int) -> bool:
        """Return whether the marking covers the transition's preset."""
        only = self.net.only_input[transition]
        return self.missing[transition] == 0 if only is None else self.tokens[only] > 0

    def lacking(self, transition: int) -> set[int]:
        """Return the places of the transition's preset that do not hold enough tokens."""
        return {place for place, weight in self.net.inputs[transition] if self.tokens[place] < weight}

    def fire(self, transition: int) -> None:
        """Fire the transition; raise `NotEnabled`, and change nothing, if the marking does not cover the preset."""
        net, taken = self.net, self.net.inputs[transition]
        if not self.is_enabled(transition):  # before any token moves, so that a refused firing leaves the marking as it was
            short = {net.place_name(place): weight - self.tokens[place] for place, weight in taken if self.tokens[place] < weight}
            raise NotEnabled(net.transition_name(transition), short)
        self.move(taken, net.outputs[transition])

    def move(self, taken: Sequence[tuple[int, int]], given: Sequence[tuple[int, int]]) -> None:
        """Fire a transition that is known to be enabled, and of which all arcs are given."""
        tokens, counted = self.tokens, self._counted
        # A place that is both input and output is first emptied and then filled: each change is small and keeps `missing` exact.
        for place, weight in taken:
            if counted[place]:
                self._add(place, -weight)
            else:
                tokens[place] -= weight
        for place, weight in given:
            if counted[place]:
                self._add(place, weight)
            else:
                tokens[place] += weight

    def _add(self, place: int, count: int) -> None:
        missing, before = self.missing, self.tokens[place]
        after = self.tokens[place] = before + count
        for transition, weight in self._joins[place]:
            # Only a change across the weight matters: the place begins, or ceases, to be covered for this consumer.
            if before < weight <= after:
                missing[transition] -= 1
            elif after < weight <= before:
                missing[transition] += 1

    def marking(self) -> Marking:
        """Return the current marking."""
        return Marking({self.net.place_name(place): count for place, count in enumerate(self.tokens) if count})


# --- values that are made when they are asked for, and kept: from then on, or for a while -------------


K = TypeVar("K")
V = TypeVar("V")
Owner = TypeVar("Owner")


class WhenAsked(dict[K, V]):
    """Values that their owner makes when they are first asked for, and keeps; they do not keep the owner."""

    def __init__(self, owner: Owner, make: Callable[[Owner, K], V]) -> None:
        super().__init__()
        self._owner, self._make = ref(owner), cast(Callable[[object, K], V], make)

    def __missing__(self, key: K) -> V:
        value = self[key] = self._make(self._owner(), key)
        return value


class Remembered(Generic[K, V]):
    """Values that were made once and may be needed again: when there are too many, all are forgotten.

    The mutable state is all of it.
    """

    def __init__(self, limit: int = 1000) -> None:
        self._limit, self._values = limit, dict[K, V]()

    def get(self, key: K) -> V | None:
        """Return the value under a key."""
        return self._values.get(key)

    def keep(self, key: K, value: V) -> V:
        """Keep a value, and return it; if another is kept under its key already, that one."""
        if len(self._values) >= self._limit:
            self.forget()
        return self._values.setdefault(key, value)

    def forget(self) -> None:
        """Forget all of them."""
        self._values = {}
