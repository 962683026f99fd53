"""Place/transition nets: N = (P, T, A) with arc weights W. Frozen; a marking lives elsewhere.

Markings: sparse multisets of places.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeAlias, TypeVar

from pnm.core.net.when_asked import ByName, Made, Names, NamesOf
from pnm.errors import PnmError

V = TypeVar("V")
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


class Arcs(Protocol):
    """Arcs of a net by number: its places and transitions are numbered in the order in which they were added."""

    def inputs(self, transition: int) -> Sequence[tuple[int, int]]:
        """Return the places that the transition takes from, and how much of each."""

    def outputs(self, transition: int) -> Sequence[tuple[int, int]]:
        """Return the places that it gives to, and how much to each."""

    def consumers(self, place: int) -> Sequence[tuple[int, int]]:
        """Return the transitions that take from the place, in their order, and how much each does."""

    def unmarked(self) -> list[int]:
        """Return for every transition from how many places it takes; 0 for those that take one token from one place."""

    def counted(self) -> bytearray:
        """Return for every place whether some transition takes from it which takes more than one token."""


def unmarked_at_first(inputs: Sequence[tuple[int, int]]) -> int:
    """Return how many places a transition takes from, given by number and weight; 0 if it takes one token from one place."""
    return 0 if len(inputs) == 1 and inputs[0][1] == 1 else len(inputs)


@dataclass(frozen=True)
class PetriNet:
    """Places and transitions by name, in the order in which they were added, and the arcs between them."""

    places: Sequence[str]
    inputs: Mapping[str, Weights]
    """For every transition, the weights of the arcs from its places."""
    outputs: Mapping[str, Weights]
    """For every transition, the weights of the arcs to its places."""

    @property
    def transitions(self) -> Sequence[str]:
        """The transitions, in the order in which they were added."""
        return self.inputs.names if isinstance(self.inputs, ByName) else tuple(self.inputs)

    @cached_property
    def arcs_by_number(self) -> Arcs:
        """Its arcs by number."""
        inputs, outputs = self.inputs, self.outputs
        if isinstance(inputs, ArcsByName) and isinstance(outputs, ArcsByName) and inputs.source is outputs.source:
            return inputs.source
        return _NamedArcs(self)

    def numbered(self, found: Mapping[str, V]) -> Mapping[int, V]:
        """Return what is known of some places by their numbers."""
        by_name: Mapping[str, V] = found.by_name if isinstance(found, NumberedMarking) else found  # type: ignore[assignment]
        if isinstance(by_name, ByName) and by_name.names is self.places:
            return by_name.by_number
        return {self.place_numbers[place]: value for place, value in by_name.items()}

    def numbers(self, found: Iterable[str]) -> Collection[int]:
        """Return the numbers of some places."""
        if isinstance(found, NamesOf) and found.names is self.places:
            return found.by_number
        return [self.place_numbers[place] for place in found]

    @cached_property
    def place_numbers(self) -> Mapping[str, int]:
        """The number of every place."""
        return self.places.numbers if isinstance(self.places, Names) else {place: number for number, place in enumerate(self.places)}

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
        return tuple(self.inputs[node]) if node in self.inputs else self._producers[node]

    def postset(self, node: str) -> tuple[str, ...]:
        """Return the nodes with an arc from this one."""
        return tuple(self.outputs[node]) if node in self.outputs else self._consumers[node]

    @cached_property
    def _producers(self) -> dict[str, tuple[str, ...]]:
        return _neighbours(self.places, self.outputs)

    @cached_property
    def _consumers(self) -> dict[str, tuple[str, ...]]:
        return _neighbours(self.places, self.inputs)

    def incidence(self) -> tuple[tuple[int, ...], ...]:
        """Return D = D⁺ - D⁻, a row per transition and a column per place: what one firing of each transition changes.

        Dense, so for small nets: with it the state equation m' = T·D + m of the paper (equation 2) is the oracle of firing.
        """
        return tuple(
            tuple(self.outputs[transition].get(place, 0) - self.inputs[transition].get(place, 0) for place in self.places)
            for transition in self.inputs
        )

    def __repr__(self) -> str:
        return f"<PetriNet {len(self.places)} places, {len(self.inputs)} transitions>"


def _neighbours(places: Iterable[str], weights: Mapping[str, Weights]) -> dict[str, tuple[str, ...]]:
    by_place: dict[str, list[str]] = {place: [] for place in places}
    for transition, connected in weights.items():
        for place in connected:
            by_place[place].append(transition)
    return {place: tuple(transitions) for place, transitions in by_place.items()}


class ArcsByName(ByName[Weights]):
    """The inputs, or the outputs, of the transitions of a net that knows its arcs by number."""

    def __init__(self, source: Arcs, transitions: Names, places: Names, of: Callable[[int], Sequence[tuple[int, int]]]) -> None:
        named = Made(range(len(transitions)), lambda transition: {places[place]: weight for place, weight in of(transition)})
        super().__init__(transitions, lambda: named)
        self.source = source


class _NamedArcs:
    """Arcs by number of a net that has them by name."""

    def __init__(self, net: PetriNet) -> None:
        ids = net.place_numbers
        self._inputs, self._outputs = (
            [[(ids[place], weight) for place, weight in connected.items()] for connected in arcs.values()]
            for arcs in (net.inputs, {transition: net.outputs[transition] for transition in net.inputs})
        )
        self._consumers: list[list[tuple[int, int]]] = [[] for _ in net.places]
        for transition, inputs in enumerate(self._inputs):
            for place, weight in inputs:
                self._consumers[place].append((transition, weight))

    def inputs(self, transition: int) -> Sequence[tuple[int, int]]:
        return self._inputs[transition]

    def outputs(self, transition: int) -> Sequence[tuple[int, int]]:
        return self._outputs[transition]

    def consumers(self, place: int) -> Sequence[tuple[int, int]]:
        return self._consumers[place]

    def unmarked(self) -> list[int]:
        return [*map(unmarked_at_first, self._inputs)]

    def counted(self) -> bytearray:
        found = bytearray(len(self._consumers))
        for inputs in filter(unmarked_at_first, self._inputs):
            for place, _ in inputs:
                found[place] = True
        return found


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
    """How many tokens each place holds; places without tokens are absent, asking for them gives 0.

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


class NumberedMarking(Marking):
    """A marking that is known by number; its names are made when they are asked for."""

    def __init__(self, by_name: ByName[int]) -> None:
        self.by_name = by_name

    @cached_property
    def _tokens(self) -> Mapping[str, int]:  # type: ignore[override]
        return dict(self.by_name)
