"""Deterministic simulation: our processes, their disk, the network and a fake fleet, with everything that goes wrong drawn from a seed.

usage: python -m tests.simulation [--seeds 1000] [--first 0] [--jobs 2] [--stop] [--digest] [--show]

The same seed is the same simulation, bit for bit. The exit status is 1 if a law is broken, and every seed that breaks one is printed.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time

from tests.support.runs.simulation.course import simulate
from tests.support.runs.simulation.sweep import sweep


def main() -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=1000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first one")
    parser.add_argument("--jobs", type=int, default=2, help="how many are simulated at the same time")
    parser.add_argument("--stop", action="store_true", help="stop at the first seed that breaks a law")
    parser.add_argument("--digest", action="store_true", help="print the digest of all that has happened")
    parser.add_argument("--show", action="store_true", help="print all that happens")
    given = parser.parse_args()
    began, wrong, digest = time.monotonic(), 0, hashlib.sha256()
    seeds = range(given.first, given.first + given.seeds)
    for seed in seeds if given.show else ():
        print(*simulate(seed).moments, sep="\n")
    for verdict in sweep(seeds, given.jobs):
        digest.update(verdict.digest.encode())
        if verdict.wrong:
            wrong += 1
            print(f"seed {verdict.seed}", *verdict.wrong, sep="\n  ", flush=True)
            if given.stop:
                break
    seconds = time.monotonic() - began
    print(f"{given.seeds} seeds: {wrong} break a law; {seconds:.0f} s, {1000 * seconds / given.seeds:.1f} ms a seed")
    if given.digest:
        print(f"digest {digest.hexdigest()}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
