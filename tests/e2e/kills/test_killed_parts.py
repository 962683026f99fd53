"""Processes of a fleet of three parts that are killed while goals are shared that any part may carry out."""

from __future__ import annotations

from pathlib import Path
from uuid import UUID

from pnm.tasks import Wanted
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.pddl.problems import fleet
from tests.support.tasks.kills.parts import FleetScenario, fleet_judged

ROBOTS, PARCELS, PLACES = 9, 12, 8
KILLS = 12


def test_goals_of_a_fleet_survive_many_kills_of_its_nodes(postgres: PostgresServer, tmp_path: Path) -> None:
    problem = fleet(ROBOTS, PARCELS, PLACES)
    tasks = [Wanted(UUID(int=number + 1), f"(in p{number} a{(number + 3) % PLACES})") for number in range(PARCELS)]
    scenario = FleetScenario(problem, tasks, parts=3, kills=KILLS, speed=2.0)
    verdict = fleet_judged(scenario, postgres.database(), tmp_path)
    assert not verdict.wrong, "\n".join(verdict.wrong)
    assert verdict.kills > KILLS // 2
