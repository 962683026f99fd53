"""Measured rows: what each subject takes in rounds in which all have their turn, and ratios within these rounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any

from tests.support.benchmarks.executives.table import LARGE, Row, Subject

Ask = Callable[[Subject, int], Mapping[str, Any]]
"""Measures a subject once at a size; see `tests.support.benchmarks.peers.worker`."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What one subject has taken in each round; or why it has taken no part."""

    subject: Subject
    values: tuple[float, ...] = ()
    absent: str = ""

    @property
    def median(self) -> float:
        return median(self.values)

    def times(self, other: Taken) -> float | None:
        """Return how often as long as the other this has taken, the median of all rounds; None if one of them was not there."""
        ratios = [mine / its for mine, its in zip(self.values, other.values, strict=False) if its > 0.0]
        return median(ratios) if ratios else None


@dataclass(frozen=True, slots=True)
class MeasuredRow:
    """A row at one size; ours comes first."""

    row: Row
    size: int
    taken: tuple[Taken, ...]

    @property
    def slower(self) -> Iterator[tuple[str, float, str]]:
        """What of ours takes longer than a peer, how often as long, and which peer; floors do less, and do not count."""
        rivals = [taken for taken in self.taken if not (taken.subject.does_less or taken.subject.is_ours)]
        for ours in (taken for taken in self.taken if taken.subject.is_ours):
            for rival in rivals:
                ratio = ours.times(rival)
                if ratio is not None and ratio > 1.0:
                    yield ours.subject.label, ratio, rival.subject.label

    def as_json(self) -> dict[str, Any]:
        subjects = []
        for taken in self.taken:
            entry: dict[str, Any] = {"subject": taken.subject.label, "measure": taken.subject.measure}
            if taken.values:
                entry |= {"median": taken.median, "low": min(taken.values), "high": max(taken.values), "rounds": list(taken.values)}
                entry |= {"ours/this": self.taken[0].times(taken)}
            else:
                entry |= {"absent": taken.absent}
            subjects.append(entry)
        return {"what": self.row.what, "unit": self.row.unit, "size": self.size, "item": self.row.item, "subjects": subjects}


def measure(row: Row, size: int, ask: Ask, rounds: int) -> MeasuredRow:
    """Measure all subjects of a row at a size in turn, round by round; one that cannot take part is not asked again."""
    values: dict[Subject, list[float]] = {subject: [] for subject in row.subjects}
    absent = {subject: "not at this size" for subject in row.subjects if size > subject.largest}
    for _ in range(1 if size >= LARGE else min(rounds, row.rounds)):
        for subject in (subject for subject in row.subjects if subject not in absent):
            answer = ask(subject, size)
            if "value" in answer:
                values[subject].append(answer["value"])
            else:
                absent[subject] = str(answer.get("missing") or answer["error"])
    return MeasuredRow(row, size, tuple(Taken(subject, tuple(values[subject]), absent.get(subject, "")) for subject in row.subjects))
