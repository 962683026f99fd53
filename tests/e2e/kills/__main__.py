"""Processes that are killed by SIGKILL, again and again, while the tasks that they care for go on.

usage: python -m tests.e2e.kills [--kills 2000] [--first 0] [--jobs 2] [random] [commits] [nodes]

random: scenarios drawn from numbers, until so many processes were killed, at commits, messages and moments left to chance. commits: one
scenario, killed just before and just after every commit. nodes: `pnm serve` over ROS 2, with three goals under way; a tenth of the kills
unless it is alone. All by default. The exit status is 1 if anything is wrong, and each failure is printed with its number.
"""

from __future__ import annotations

import argparse
import os
import sys
import time

from tests.support.tasks.kills.campaign import Campaign, kills_at_every_commit, random_kills
from tests.support.tasks.kills.nodes import node_kills

KINDS = ("random", "commits", "nodes")


def campaign_of(kind: str, kills: int, first: int, jobs: int) -> Campaign:
    """Return what came of a campaign."""
    match kind:
        case "random":
            return random_kills(kills, jobs, first)
        case "nodes":
            return node_kills(kills, 2 * jobs, first)
        case _:
            return kills_at_every_commit(jobs)


def main() -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.e2e.kills", description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], metavar="KIND", help=f"{', '.join(KINDS)}; all without one")
    parser.add_argument("--kills", type=int, default=2000, help="how many processes are killed")
    parser.add_argument("--first", type=int, default=0, help="the number of the first scenario")
    parser.add_argument("--jobs", type=int, default=2, help="how many scenarios are carried out at the same time")
    given = parser.parse_args()
    is_wrong = False
    kinds = given.kinds or KINDS
    for kind in kinds:
        began = time.monotonic()
        kills = given.kills // 10 if kind == "nodes" and len(kinds) > 1 else given.kills
        campaign = campaign_of(kind, kills, given.first, given.jobs)
        took = time.monotonic() - began
        print(*campaign.wrong, sep="\n", end="\n" if campaign.wrong else "")
        rate = f"{60 * campaign.kills / took:.0f} a minute, load of the machine {os.getloadavg()[0]:.1f}"
        print(f"{kind}: {campaign.kills} kills in {campaign.scenarios} scenarios, {len(campaign.wrong)} wrong; {took:.0f} s, {rate}")
        is_wrong |= bool(campaign.wrong)
    return int(is_wrong)


if __name__ == "__main__":
    sys.exit(main())
