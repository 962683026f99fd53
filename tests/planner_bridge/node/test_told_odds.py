"""The odds that a node tells of its tasks while it carries out a policy."""

from __future__ import annotations

from random import Random
from uuid import UUID

import pytest

from planner_bridge.node.spare_time import Foreteller
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.odds import KnownRobots
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.plan_graph import GroundAction
from pnm.tasks import TaskListener
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation

RIVER = parse_domain("""(define (domain river) (:requirements :strips :non-deterministic) (:predicates (near) (far) (island))
  (:action wade :precondition (near) :effect (and (not (near)) (oneof (far) (and) (island) (island))))
  (:action swim :precondition (island) :effect (and (not (island)) (probabilistic 0.8 (far)))))""")
PROBLEM = parse_problem("(define (problem p) (:domain river) (:init (near)) (:goal (far)))", RIVER)
KNOWN = KnownRobots(faults=Faults((Fault("wade", FaultKind.ABORT, chance=0.0), Fault("swim", FaultKind.ABORT, chance=0.0))))


def to_the_island(action: GroundAction, _: Random) -> Fault:
    return Fault(action.name, outcome="3" if action.name == "wade" else "1")


class Told(TaskListener):
    """Writes down the odds of tasks. The mutable state is these."""

    def __init__(self, simulation: TaskSimulation) -> None:
        self.simulation, self.odds = simulation, list[float]()

    def changed(self, task: UUID) -> None:
        for status in self.simulation.master.status():
            if status.odds and (not self.odds or self.odds[-1] != status.odds.chance):
                self.odds.append(status.odds.chance)


@simulated(PROBLEM, chosen=Settings(), faults=Faults(drawn=to_the_island))
async def test_odds_count_with_what_the_policy_has_after_each_outcome(simulation: TaskSimulation):
    told, foreteller = Told(simulation), Foreteller(simulation.master, KNOWN, simulation.knowledge)
    simulation.master.listen(foreteller)
    simulation.master.listen(told)
    await simulation.reaches(simulation.want("(far)"))
    await foreteller.close()
    assert told.odds == [pytest.approx(0.65), pytest.approx(0.8)]
