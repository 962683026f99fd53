"""Tasks of a node in simulation: how tests are run with them, and what their actions need."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import update_wrapper
from inspect import Signature, signature
from typing import Any, Concatenate, ParamSpec
from uuid import UUID

from planner_bridge.model.problem import Problem
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import OnChange, Settings
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.knowledge.source import Asker
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

P = ParamSpec("P")
CALLS = ("move", "pick", "drop")


def everything_needs(resource: str, **bindings: Binding) -> Settings:
    """Whatever a robot does needs this resource, and nothing is tried twice."""
    usual = {name: Binding(resources=(resource,), retries=0) for name in CALLS}
    return replace(EAGER, bindings=Bindings({**usual, **bindings}))


EAGER = Settings(on_change=OnChange.EAGER, on_failure=OnFailure.CONTINUE_OTHERS, limits=Limits(seconds=2000.0))
USUAL = everything_needs("{r}")
LAZY = replace(USUAL, on_change=OnChange.LAZY)


class SlowPerson:
    """Answers everything after a minute."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        if question.layer is not Layer.PERSON:
            return MISSING
        await asyncio.sleep(60.0)
        return "yes"

    async def update(self, question: Question, value: object, asker: Asker, /) -> None: ...

    async def close(self) -> None: ...


def simulated(
    problem: Problem | None = None, *, chosen: Settings = USUAL, **how: Any
) -> Callable[[Callable[Concatenate[TaskSimulation, P], Awaitable[None]]], Callable[P, None]]:
    """Run a test with the tasks of such a node, in simulation; a person that the test is given is asked for help, an approver for a yes."""

    def wrap(scenario: Callable[Concatenate[TaskSimulation, P], Awaitable[None]]) -> Callable[P, None]:
        def test(*args: P.args, **kwargs: P.kwargs) -> None:
            helped = {"helper": kwargs["person"]} if "person" in kwargs else {}
            helped |= {"source": kwargs["approver"]} if "approver" in kwargs else {}
            simulate_tasks(lambda simulation: scenario(simulation, *args, **kwargs), problem, chosen=chosen, **how, **helped)

        _, *others = signature(scenario).parameters.values()
        update_wrapper(test, scenario)
        test.__signature__ = Signature(others)  # type: ignore[attr-defined]  # by which pytest knows what a test is given
        return test

    return wrap


def carry(simulation: TaskSimulation, robot: str, origin: str, place: str) -> None:
    """Have somebody carry a robot from one place to another."""
    simulation.backend.robots.world.change({("at", robot, origin): False, ("at", robot, place): True})


def robots_of(simulation: TaskSimulation, task: UUID) -> set[str]:
    """Return the robots that have done something for a task."""
    return {call.split("(")[1].split(",")[0] for call in simulation.sent(task)}
