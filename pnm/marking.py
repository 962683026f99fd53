"""Markings: sparse multisets of places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping


class Marking(Mapping[str, int]):
    """How many tokens each place holds; places without tokens are absent, asking for them gives 0.

    Immutable and hashable: equal counts, equal markings.

    >>> Marking({"p": 2, "q": 0})
    Marking(p: 2)
    """

    __slots__ = ("_tokens",)

    def __init__(self, tokens: Mapping[str, int] | Iterable[str] = ()) -> None:
        if isinstance(tokens, Mapping):
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
        """Tell whether there are at least `times` as many tokens as the weights ask for."""
        return all(self[place] >= weight * times for place, weight in weights.items())
