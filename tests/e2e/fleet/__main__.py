"""Many rounds with a fleet of two nodes: kill, cut off or stop the one that serves, and see the other one go on.

usage: python -m tests.e2e.fleet [--rounds 50] [--seed 0] [--lease 3]

Root may run it: hosts are network namespaces. The exit status is 1 if anything is done twice or not at all, or if a take-over takes
longer than the lease and 2 s.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.support.e2e.hosts.nodes import fleet
from tests.support.e2e.hosts.rounds import Rounds

GRACE = 2.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lease", type=float, default=3.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, fleet(Path(folder), lease=given.lease) as deployment:
        rounds = Rounds(deployment, given.seed)
        played = []
        for _ in range(given.rounds):
            played.append(rounds.play())
            print(played[-1], flush=True)
        rounds.check()
    late = [one for one in played if one.took > given.lease + GRACE]
    slowest = max(one.took for one in played)
    print(f"{len(played)} rounds, nothing twice, nothing lost; take-over in at most {slowest:.2f} s, {len(late)} of them late")
    return 1 if late else 0


sys.exit(main())
