"""Readers of knowledge: who reads which fluents, so that a change concerns only those who read what has changed."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Generic, TypeVar

from pnm.core.logic.expressions import Fluent
from pnm.core.logic.rules import Reads

Reader = TypeVar("Reader", bound=Hashable)


class Readers(Generic[Reader]):
    """An index from fluents, and names of fluents, to those who read them. The mutable state is what the constructor sets."""

    def __init__(self) -> None:
        self.reads: dict[Reader, Reads] = {}
        """What each of them reads."""
        self._of: dict[Fluent | str, set[Reader]] = {}
        self._of_all: set[Reader] = set()

    def __len__(self) -> int:
        return len(self.reads)

    def add(self, reader: Reader, reads: Reads) -> None:
        """Have changes of what it reads concern a reader; of everything, if it is not known what that is. Only the first time counts."""
        if reader in self.reads:
            return
        self.reads[reader] = reads
        if reads is None:
            self._of_all.add(reader)
        else:
            for read in reads:
                self._of.setdefault(read, set()).add(reader)

    def remove(self, reader: Reader) -> None:
        """Have no change concern a reader."""
        self._of_all.discard(reader)
        for read in self.reads.pop(reader, None) or ():
            readers = self._of[read]
            readers.discard(reader)
            if not readers:
                del self._of[read]

    def concerned(self, changed: Iterable[Fluent]) -> set[Reader]:
        """Return whom changes of these fluents concern."""
        found = self._of_all.copy()
        for fluent in changed:
            found.update(self._of.get(fluent, ()), self._of.get(fluent[0], ()))
        return found
