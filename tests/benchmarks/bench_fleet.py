"""What the nodes of a fleet do at the same time, beside one node that has all robots, in processor time. Not a test.

usage: python -m tests.benchmarks.bench_fleet [ROBOTS [NODES [KILLS]]]

Each robot has a goal of three calls. The robots are simulated by one process, and PostgreSQL is on the same machine; both are left out of
the time of the nodes. Nodes on processor cores of their own are as fast as the busiest of them: that is the ratio on paper, which needs
no such machine. With kills, processes are killed besides, and it is checked that nothing is done twice or not at all.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import UUID

from pnm.tasks import Wanted
from tests.support.e2e.hosts.postgres import PostgresServer, postgres_server
from tests.support.pddl.problems import fleet
from tests.support.tasks.kills.parts import FleetScenario, FleetVerdict, fleet_judged

PLACES, ACTIVE = 8, 16
SECONDS = 3000.0


def carried_out(scenario: FleetScenario, server: PostgresServer) -> FleetVerdict:
    with TemporaryDirectory() as folder:
        verdict = fleet_judged(scenario, server.database(), Path(folder))
    if verdict.wrong:
        raise SystemExit("\n".join(verdict.wrong))
    return verdict


def main(robots: int = 100, nodes: int = 4, kills: int = 0) -> None:
    tasks = [Wanted(UUID(int=number + 1), f"(at r{number} a{(number + 3) % PLACES})") for number in range(robots)]
    several = FleetScenario(fleet(robots, 0, PLACES), tasks, nodes, speed=10.0, seconds=SECONDS, active=ACTIVE)
    with postgres_server() as server:
        one = carried_out(replace(several, parts=1, is_fleet=False), server)
        print(f"one node: {sum(one.used) / robots * 1000:.1f} ms a goal, {one.seconds:.0f} s", flush=True)
        parts = carried_out(several, server)
        print(f"{nodes} nodes: {sum(parts.used) / robots * 1000:.1f} ms a goal, {parts.seconds:.0f} s; tasks {parts.shared}")
        print(f"throughput: {max(one.used) / max(parts.used):.2f} x on paper, {one.seconds / parts.seconds:.2f} x here", flush=True)
        if kills:
            killed = carried_out(replace(several, kills=kills), server)
            print(f"{killed.kills} nodes killed: {killed.requests} calls, none twice, in {killed.seconds:.0f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
