"""The gate: what must not become much slower, in turns of a plain loop that is measured beside it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from tests.support.benchmarks.executives.workers import Worker, our_worker, value_of

GATE: Final = (
    ("written", 100),
    ("written", 1_000),
    ("written-kept", 100),
    ("import", 459),
    ("help", 1),
    ("simulated", 1),
    ("engine-chain", 10_000),
    ("engine-fork", 10_000),
    ("run-chain", 1_000),
    ("call-inline", 300),
    ("call-known", 300),
    ("call-asynchronous", 300),
    ("calls-parallel", 300),
    ("machine", 100),
    ("machine", 1_000),
    ("change", 1_000),
    ("change-unread", 1_000),
    ("lamp", 1_000),
    ("lamp-unread", 1_000),
    ("report", 10_000),
    ("ways", 200),
    ("ways-first", 200),
    ("resource", 100),
    ("tasks-begin", 500),
    ("tasks-begin-timed", 100),
    ("tasks-next", 500),
    ("taken-up", 10_000),
    ("task-call", 100),
    ("task-call-kept", 100),
    ("plan-tiles", 4),
    ("needless", 1_000),
)
"""Measures, with a size, that may not become much slower."""
LIMITS: Final = Path(__file__).with_name("limits.json")
"""What each measure of the gate took when its limit was stored, in turns of the loop."""
MARGIN: Final = 3.0
"""How often as much is no reason to fail: processors differ in more than their speed, and share caches with others."""
_ROUNDS: Final = 2


def turns(worker: Worker, measures: Iterable[tuple[str, int]], rounds: int = _ROUNDS) -> dict[str, float]:
    """Return how many turns of the loop each takes: the least time of some rounds by that of the loop in the same rounds."""
    found: dict[str, float] = {}
    for name, size in measures:
        taken, loops = [], []
        for _ in range(rounds):
            loops.append(value_of(worker, "loop", 1))
            taken.append(value_of(worker, name, size))
        found[f"{name} {size}"] = min(taken) / min(loops)
    return found


def exceeded(limits: Mapping[str, float], found: Mapping[str, float]) -> list[str]:
    """Return in words what takes more than its limit allows, and what has none."""
    reasons = [f"{name} has no limit: --gate --write stores one" for name in found if name not in limits]
    slow = {name: (took, limits[name]) for name, took in found.items() if name in limits and took > limits[name] * MARGIN}
    reasons += [
        f"{name} takes {took:.0f} turns of a loop, {took / limit:.1f} times the {limit:.0f} that are stored"
        for name, (took, limit) in slow.items()
    ]
    return reasons


def compared() -> tuple[list[str], list[str]]:
    """Return what everything takes beside its limit, and what is too slow, which is measured again before it counts: others may be busy."""
    limits = stored()
    with our_worker() as worker:
        found = turns(worker, GATE)
        again = [(name, size) for name, size in GATE if exceeded(limits, {f"{name} {size}": found[f"{name} {size}"]})]
        found |= {name: min(found[name], took) for name, took in turns(worker, again).items()}
    return [f"{name:24} {took:10.0f} turns, stored {limits.get(name, 0.0):10.0f}" for name, took in found.items()], exceeded(limits, found)


def stored() -> dict[str, float]:
    """Return the stored limits."""
    limits: dict[str, float] = json.loads(LIMITS.read_text())
    return limits


def store() -> None:
    """Store what everything takes now."""
    with our_worker() as worker:
        found = {name: round(took, 1) for name, took in turns(worker, GATE).items()}
    LIMITS.write_text(json.dumps(found, indent=2) + "\n")
