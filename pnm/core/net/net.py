"""Place/transition nets N = (P, T, A) with arc weights W, markings (sparse multisets of places), the firing rule; orders of graphs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heapify, heappop, heappush
from itertools import count
from typing import TypeAlias

from pnm.errors import NotEnabled, PnmError

Weights: TypeAlias = Mapping[str, int]
"""Places and the weights of the arcs that connect them to one transition."""


class NetError(PnmError):
    """A net is not one: a name is used twice, an arc leads nowhere or weighs less than one."""


@dataclass(frozen=True, slots=True)
class Arc:
    """Leads from a place to a transition or from a transition to a place."""

    source: str
    target: str
    weight: int = 1


@dataclass(frozen=True)
class PetriNet:
    """Places and transitions by name, in the order in which they were added, and the arcs between them."""

    places: Sequence[str]
    inputs: Mapping[str, Weights]
    """For every transition, the weights of the arcs from its places."""
    outputs: Mapping[str, Weights]
    """For every transition, the weights of the arcs to its places."""

    @cached_property
    def transitions(self) -> tuple[str, ...]:
        """The transitions, in the order in which they were added."""
        return tuple(self.inputs)

    @cached_property
    def place_numbers(self) -> Mapping[str, int]:
        """The number of every place, in the order in which they were added."""
        return {place: number for number, place in enumerate(self.places)}

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """Every arc, ordered by transition."""
        return tuple(
            arc
            for transition in self.inputs
            for arc in (
                *(Arc(place, transition, weight) for place, weight in self.inputs[transition].items()),
                *(Arc(transition, place, weight) for place, weight in self.outputs[transition].items()),
            )
        )

    def preset(self, node: str) -> tuple[str, ...]:
        """Return the nodes with an arc to this one."""
        return tuple(self.inputs[node]) if node in self.inputs else self._around[node][0]

    def postset(self, node: str) -> tuple[str, ...]:
        """Return the nodes with an arc from this one."""
        return tuple(self.outputs[node]) if node in self.outputs else self._around[node][1]

    @cached_property
    def _around(self) -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
        """For every place, the transitions that give to it, and those that take from it."""
        found: dict[str, tuple[list[str], list[str]]] = {place: ([], []) for place in self.places}
        for number, arcs in enumerate((self.outputs, self.inputs)):
            for transition, connected in arcs.items():
                for place in connected:
                    found[place][number].append(transition)
        return {place: (tuple(giving), tuple(taking)) for place, (giving, taking) in found.items()}

    def __repr__(self) -> str:
        return f"<PetriNet {len(self.places)} places, {len(self.inputs)} transitions>"


@dataclass
class NetBuilder:
    """Collects places and transitions, then builds the frozen net. A name that is used twice raises NetError, and adds nothing."""

    _places: dict[str, None] = field(default_factory=dict)
    _inputs: dict[str, Weights] = field(default_factory=dict)
    _outputs: dict[str, Weights] = field(default_factory=dict)

    def place(self, name: str) -> str:
        """Add a place and return its name."""
        if name in self._places or name in self._inputs:
            raise NetError(f"the name {name!r} is used twice")
        self._places[name] = None
        return name

    def transition(self, name: str, inputs: Weights | Iterable[str], outputs: Weights | Iterable[str]) -> str:
        """Add a transition with its arcs and return its name; each name alone is an arc, of weight one, and arcs of one place add up."""
        if name in self._places or name in self._inputs:
            raise NetError(f"the name {name!r} is used twice")
        # Both are checked before either is stored: a transition that is refused leaves no half of itself behind.
        self._inputs[name], self._outputs[name] = self._weights(name, inputs), self._weights(name, outputs)
        return name

    def _weights(self, name: str, connected: Weights | Iterable[str]) -> Weights:
        # lists first: to ask whether something is a mapping takes long, as does counting
        if not isinstance(connected, list) and isinstance(connected, Mapping | str):
            if isinstance(connected, str):
                raise NetError(f"expected a list of places to connect {name!r} to, found {connected!r}")
            weights = dict(connected)
        else:
            arcs = [*connected]
            weights = dict.fromkeys(arcs, 1)
            weights = weights if len(weights) == len(arcs) else dict(Counter(arcs))
        for place, weight in weights.items():
            if place not in self._places:
                raise NetError(f"{name!r} is connected to {place!r}, which is not a place")
            if not isinstance(weight, int) or weight < 1:
                raise NetError(f"the arc between {name!r} and {place!r} weighs {weight}; a whole number of at least 1 expected")
        return weights

    def build(self) -> PetriNet:
        """Return the net collected so far."""
        return PetriNet(tuple(self._places), dict(self._inputs), dict(self._outputs))


class Marking(Mapping[str, int]):
    """The number of tokens on each place; places without tokens are absent, asking for them gives 0.

    Immutable and hashable: equal counts, equal markings.

    >>> Marking({"p": 2, "q": 0})
    Marking(p: 2)
    """

    __slots__ = ("_tokens",)

    def __init__(self, tokens: Mapping[str, int] | Iterable[str] = ()) -> None:
        if isinstance(tokens, Mapping):
            # Zeros are left out, so that equal markings are equal dictionaries, and have the same hash.
            counts = {place: count for place, count in tokens.items() if count}
        else:
            counts = {}
            for place in tokens:
                counts[place] = counts.get(place, 0) + 1
        if any(count < 0 for count in counts.values()):
            raise ValueError(f"a marking cannot be negative: {counts}")
        self._tokens = counts

    def __getitem__(self, place: str) -> int:
        return self._tokens.get(place, 0)

    def __iter__(self) -> Iterator[str]:
        return iter(self._tokens)

    def __len__(self) -> int:
        return len(self._tokens)

    def __contains__(self, place: object) -> bool:
        return place in self._tokens

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Marking) and self._tokens == other._tokens

    def __hash__(self) -> int:
        return hash(frozenset(self._tokens.items()))

    def __repr__(self) -> str:
        return f"Marking({', '.join(f'{place}: {count}' for place, count in sorted(self._tokens.items()))})"

    def covers(self, weights: Mapping[str, int], times: int = 1) -> bool:
        """Return whether there are at least `times` as many tokens as the weights ask for."""
        return all(self[place] >= weight * times for place, weight in weights.items())


def is_enabled(net: PetriNet, marking: Marking, transition: str, times: int = 1) -> bool:
    """Return whether the marking covers the transition's preset, `times` over."""
    return marking.covers(net.inputs[transition], times)


def enabled(net: PetriNet, marking: Marking) -> tuple[str, ...]:
    """Return the enabled transitions, in the net's order."""
    return tuple(transition for transition in net.inputs if is_enabled(net, marking, transition))


def fire(net: PetriNet, marking: Marking, transition: str, times: int = 1) -> Marking:
    """Return the marking after the transition has fired `times` at once: m' = T̄·D + m.

    Raises:
        NotEnabled: the marking does not cover the preset; nothing has changed.
    """
    inputs, outputs = net.inputs[transition], net.outputs[transition]
    missing = {place: weight * times - marking[place] for place, weight in inputs.items() if marking[place] < weight * times}
    if missing:  # the whole preset is checked before anything is taken: a firing is atomic
        raise NotEnabled(transition, missing)
    tokens = dict(marking)
    for place, weight in inputs.items():
        tokens[place] -= weight * times
    for place, weight in outputs.items():
        tokens[place] = tokens.get(place, 0) + weight * times
    return Marking(tokens)


# --- orders of places, and of any graph -----------------------------------------------------------


def topological_order(preceding: Sequence[Sequence[int]], rank: Callable[[int], float] | None = None) -> list[int]:
    """Return the numbers in an order in which each comes after all that precede it; those that precede each other are left out.

    Args:
        preceding: for every number, those that come before it, directly.
        rank: of those that may be next, that of the least rank comes first; without ranks that which may be next for the longest time,
            at first that which is mentioned first.
    """
    missing = [*map(len, preceding)]
    following: list[list[int]] = [[] for _ in preceding]
    first: dict[int, None] = {}
    for number, earlier in enumerate(preceding):
        for one in earlier:
            following[one].append(number)
            if not missing[one]:
                first[one] = None
        if not earlier:
            first[number] = None
    turns = count()
    rank = rank or (lambda _: next(turns))
    ready = [(rank(number), number) for number in first]
    heapify(ready)
    in_order: list[int] = []
    while ready:
        _, next_one = heappop(ready)
        in_order.append(next_one)
        for number in following[next_one]:
            missing[number] -= 1
            if not missing[number]:
                heappush(ready, (rank(number), number))
    return in_order


def reduced(size: int, edges: Iterable[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Return, for elements numbered in an order that fits, those that come directly before each: the transitive reduction."""
    before: list[set[int]] = [set() for _ in range(size)]
    for first, second in edges:
        before[second].add(first)
    earlier = closure(before)
    return [tuple(sorted(element for element in own if not any(earlier[other] >> element & 1 for other in own))) for own in before]


def closure(before: Sequence[Iterable[int]]) -> list[int]:
    """Return, for elements numbered in an order that fits, the set of all that come before each."""
    earlier: list[int] = []
    for own in before:
        ancestors = 0
        for element in own:
            ancestors |= earlier[element] | 1 << element
        earlier.append(ancestors)
    return earlier


def places(bits: int) -> Iterator[int]:
    """Yield the places of the bits that are set, the lowest first: the elements of a set that is a number, as in `closure`."""
    while bits:
        low = bits & -bits
        yield low.bit_length() - 1
        bits ^= low


@dataclass(frozen=True, slots=True)
class TimeOrder:
    """Order of time of a net."""

    when: Mapping[str, int]
    """The position of every place: behind all from which tokens come to it, but for arcs that lead back; those aside come last."""
    back: frozenset[tuple[str, str]]
    """Transitions and places: the arcs between them that lead back. Without them there is no cycle."""


def time_order(net: PetriNet, begin: str, aside: Collection[str]) -> TimeOrder:
    """Return the order of time of a net whose token begins at a place.

    Places aside, such as counters and resources, order nothing: no token passes through them.
    """
    left: list[str] = []
    """Places and transitions that were left, last ones first: whatever a node leads to is left before it."""
    entered: set[str] = {begin}
    on_the_way: dict[str, Iterator[str]] = {begin: iter(net.postset(begin))}
    back: set[tuple[str, str]] = set()
    while on_the_way:
        node, following = next(reversed(on_the_way.items()))
        after = next(following, None)
        if after is None:
            left.append(node)
            del on_the_way[node]
        elif after in on_the_way:
            back.add((node, after))
        elif after not in entered and after not in aside:
            entered.add(after)
            on_the_way[after] = iter(net.postset(after))
    passed = (node for node in reversed(left) if node not in net.inputs)
    places = (*passed, *(place for place in net.places if place not in entered))
    return TimeOrder({place: position for position, place in enumerate(places)}, frozenset(back))
