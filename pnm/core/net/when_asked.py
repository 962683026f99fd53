"""Values that are made when they are asked for: kept from then on, kept for a while, or made anew each time; names of numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from functools import cached_property
from typing import Generic, TypeVar, overload

K = TypeVar("K")
V = TypeVar("V")


class WhenAsked(dict[K, V]):
    """Values that are made when they are first asked for, and kept."""

    def __init__(self, make: Callable[[K], V]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, key: K) -> V:
        value = self[key] = self._make(key)
        return value


class Remembered(Generic[K, V]):
    """Values that were made once and may be needed again: when there are too many, all are forgotten.

    The mutable state is all of it.
    """

    def __init__(self, limit: int = 1000) -> None:
        self._limit, self._values = limit, dict[K, V]()

    def get(self, key: K) -> V | None:
        """Return what was kept under a key."""
        return self._values.get(key)

    def keep(self, key: K, value: V) -> V:
        """Keep a value, and return it; if another is kept under its key already, that one."""
        if len(self._values) >= self._limit:
            self.forget()
        return self._values.setdefault(key, value)

    def forget(self) -> None:
        """Forget all of them."""
        self._values = {}


class Made(Mapping[K, V]):
    """Values by key, each made anew whenever it is asked for."""

    def __init__(self, keys: Collection[K], make: Callable[[K], V]) -> None:
        self._keys, self._make = keys, make

    def __getitem__(self, key: K) -> V:
        if key not in self._keys:
            raise KeyError(key)
        return self._make(key)

    def __iter__(self) -> Iterator[K]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)


class Names(Sequence[str]):
    """Names of what is numbered from 0. None is kept, unless the number of one is asked for: then all are."""

    def __init__(self, count: int, make: Callable[[int], str]) -> None:
        self._count, self._make = count, make

    @overload
    def __getitem__(self, number: int) -> str: ...
    @overload
    def __getitem__(self, number: slice) -> tuple[str, ...]: ...

    def __getitem__(self, number: int | slice) -> str | tuple[str, ...]:
        numbers = range(self._count)[number]
        return self._make(numbers) if isinstance(numbers, int) else tuple(map(self._make, numbers))

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[str]:
        return map(self._make, range(self._count))

    def __contains__(self, name: object) -> bool:
        return name in self.numbers

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    @cached_property
    def numbers(self) -> Mapping[str, int]:
        """The number of every name."""
        return {name: number for number, name in enumerate(self)}


class ByName(Mapping[str, V]):
    """Values of what has names and is known by number: those of all, or of some."""

    def __init__(self, names: Names, values: Callable[[], Mapping[int, V]]) -> None:
        self.names, self._values = names, values

    @cached_property
    def by_number(self) -> Mapping[int, V]:
        """The same by number."""
        return self._values()

    def __getitem__(self, name: str) -> V:
        return self.by_number[self.names.numbers[name]]

    def __contains__(self, name: object) -> bool:
        return name in self.names.numbers and self.names.numbers[name] in self.by_number  # type: ignore[index]

    def __iter__(self) -> Iterator[str]:
        return map(self.names.__getitem__, self.by_number)

    def __len__(self) -> int:
        return len(self.by_number)


class NamesOf(Set[str]):
    """Names of some of what is known by number."""

    def __init__(self, names: Names, chosen: Callable[[], Collection[int]]) -> None:
        self.names, self._chosen = names, chosen

    @classmethod
    def _from_iterable(cls, found: Iterable[V]) -> frozenset[V]:
        return frozenset(found)

    @cached_property
    def by_number(self) -> Collection[int]:
        """The same by number."""
        return self._chosen()

    @cached_property
    def _named(self) -> frozenset[str]:
        return frozenset(map(self.names.__getitem__, self.by_number))

    def __contains__(self, name: object) -> bool:
        return name in self._named

    def __iter__(self) -> Iterator[str]:
        return iter(self._named)

    def __len__(self) -> int:
        return len(self.by_number)
