"""Many seeds, on several processors: what breaks a law, with its seed."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

from tests.support.runs.simulation.course import simulate
from tests.support.runs.simulation.laws import broken_laws


class Verdict(NamedTuple):
    """What came of a seed: what is against the laws, and the digest of all that has happened."""

    seed: int
    wrong: tuple[str, ...]
    digest: str


def judged(seed: int) -> Verdict:
    """Simulate a seed and judge it."""
    try:
        story = simulate(seed)
        return Verdict(seed, tuple(broken_laws(story)), story.digest)
    except Exception:
        return Verdict(seed, (traceback.format_exc(),), "")


def sweep(seeds: Iterable[int], jobs: int) -> Iterator[Verdict]:
    """Simulate seeds, several at a time, and yield what has come of each, in their order."""
    if jobs == 1:
        yield from map(judged, seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(judged, seeds, chunksize=20)
