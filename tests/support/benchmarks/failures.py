"""Simulated robots that fail by chance, and the time from each failure to the begin of the next plan."""

from __future__ import annotations

from dataclasses import replace

from planner_bridge.model.problem import Problem
from planner_bridge.model.simulation import robots_of
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from tests.support.runs.timing import FailureClock

SEEDS = range(8)
SPEED = 50.0


def measured(problem: Problem, bindings: Bindings, seeds: range = SEEDS) -> list[tuple[float, float]]:
    """Pursue the goal once for every seed; one request in five is aborted."""
    found: list[tuple[float, float]] = []
    bindings = replace(bindings, actions={name: replace(one, retries=0) for name, one in bindings.actions.items()})
    for seed in seeds:
        faults = Faults(tuple(Fault(name, FaultKind.ABORT, chance=0.2) for name in problem.domain.actions), seed=seed)
        clock = FailureClock()
        backend = SimulatedBackend(robots_of(problem, bindings, faults, speed=SPEED), bindings.assumed)
        limits = Limits(replans=30, seconds=60.0, forbid_after=1, backoff=0.0)
        settings = Settings(
            improve=0.0, bindings=bindings, limits=limits, on_failure=OnFailure.CONTINUE_OTHERS, on_change=OnChange.EAGER
        )  # which is measured by itself
        run_async(achieve_at(backend, problem, settings, clock), virtual=False)
        found += clock.found
    return found
