"""The household with mishaps: doors prove to be locked, grasps drop things out of sight; and its domain with all outcomes declared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyrobosim.core import World
from pyrobosim.planning.actions import ExecutionResult, ExecutionStatus

from planner_bridge.model.problem import Problem
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Alternative, OneOf, Set
from pnm.core.logic.expressions import Constant, is_number
from pnm.core.machine.bindings import Bindings
from pnm.core.message_fields import Comparison, parse_field
from tests.support.e2e.household.in_process import SimulatorBackend, problem_of
from tests.support.e2e.household.simulator import CHANCES_AND_USAGES, load_world

LOCKED: Final = 0.15
"""The chance that a shut door is locked: who tries it finds that out."""
DROPPED: Final = 0.1
"""The chance that a grasp drops its thing where it is: it has to be detected then."""
_DROP: Final = "it has dropped"
_KINDS: Final = {"open_hallway": "open", "close_hallway": "close", "charge": "navigate"}
_USES: Final = {"navigation_use": "navigate", "grasp_use": "pick", "door_use": "open"}
_MISHAPS: Final = {
    "open_hallway": Alternative((Set(("locked", "?hallway"), Constant(True)),), LOCKED, "locked"),
    "pick": Alternative((Set(("hidden", "?item"), Constant(True)), Set(("seen", "?item"), Constant(False))), DROPPED, "dropped"),
}
_STATUS: Final = parse_field("execution_result.status")
_TESTS: Final = {
    "done": Comparison(_STATUS, "eq", int(ExecutionStatus.SUCCESS)),
    "locked": Comparison(_STATUS, "eq", int(ExecutionStatus.PRECONDITION_FAILURE)),
    "dropped": Comparison(parse_field("execution_result.message"), "eq", _DROP),
    "nothing": Comparison(_STATUS, "eq", int(ExecutionStatus.EXECUTION_FAILURE)),
}


def declared(problem: Problem) -> Problem:
    """Return a problem that says what may come of its actions, and what an attempt of each uses of the battery, whatever comes of it."""
    actions = {}
    for name, schema in problem.domain.actions.items():
        chance = CHANCES_AND_USAGES[_KINDS.get(name, name)][0]
        used = tuple(one for one in schema.end_effects if isinstance(one, Set) and one.operation == "decrease")
        more = [_MISHAPS[name]] if name in _MISHAPS else []
        taken = sum(way.chance or 0.0 for way in more)
        done = Alternative(tuple(one for one in schema.end_effects if one not in used), chance * (1.0 - taken), "done")
        nothing = Alternative((), (1.0 - chance) * (1.0 - taken), "nothing")
        actions[name] = replace(schema, end_effects=(*used, OneOf((done, *more, nothing))))
    init = dict(problem.init)
    for use, kind in _USES.items():
        mean = init[use,]
        assert is_number(mean)
        init[use,] = round(mean * CHANCES_AND_USAGES[kind][0])  # where a number has too many values, there are only proved policies
    return replace(problem, domain=replace(problem.domain, actions=actions), init=init)


def told(problem: Problem, bindings: Bindings) -> Bindings:
    """Return bindings that tell the outcomes of the problem by the status and the message of a result."""
    actions = {}
    for name in problem.domain.actions:
        ways = {way.name for way in problem.outcomes(name)}
        actions[name] = replace(bindings.of(name), outcomes={way: test for way, test in _TESTS.items() if way in ways})
    return replace(bindings, actions=actions)


class Mishaps(SimulatorBackend):
    """Robots to which mishaps happen, by the seed. The mutable state is what is locked and what lies out of sight.

    Args:
        is_declared: whether the domain and the bindings say what may come about.
    """

    def __init__(self, world: World, problem: Problem, seed: int, *, is_declared: bool) -> None:
        super().__init__(world, declared(problem) if is_declared else problem)
        if is_declared:
            self.bindings = told(self.problem, self.bindings)
        self._random = np.random.default_rng([seed, 100])
        shut = sorted(hallway.name for hallway in world.hallways if not hallway.is_open)
        self.locked = {name for name in shut if self._random.random() < LOCKED}
        self._dropped = set[str]()

    def act(self, action: Mapping[str, Any]) -> ExecutionResult:
        """Perform an action, or have a mishap with it."""
        kind, what, robot = action["type"], action.get("object", ""), self.world.get_robot_by_name(action["robot"])
        if kind == "open" and what in self.locked:
            self.locked.discard(what)
            self.world.lock_location(what)
        if kind == "pick" and what in self._dropped:
            return self._counted(ExecutionResult(ExecutionStatus.PRECONDITION_FAILURE, f"{what} is out of sight"))
        if kind == "pick" and self._random.random() < DROPPED:
            self._dropped.add(what)
            usage = robot.action_execution_options["pick"].battery_usage if robot.action_execution_options else 0.0
            robot.battery_level = max(0.0, robot.battery_level - usage)
            return self._counted(ExecutionResult(ExecutionStatus.EXECUTION_FAILURE, _DROP))
        result = super().act(action)
        if kind == "detect" and result.is_success():
            self._dropped.discard(what)
        return result

    def _counted(self, result: ExecutionResult) -> ExecutionResult:
        self.work.actions += 1
        return result

    def report(self, knowledge: KnowledgeBase) -> None:
        """Report what lies out of sight, besides."""
        super().report(knowledge)
        hidden = {("hidden", item.name): item.name in self._dropped for item in self.world.objects}
        knowledge.update(hidden | {("seen", item): False for item in self._dropped})


def with_mishaps(number: int, seed: int, folder: Path | None = None, *, is_declared: bool) -> Mishaps:
    """Return the robots of a problem's world, to which mishaps happen; see `load_world`."""
    return Mishaps(load_world(number, seed, folder), problem_of(number), seed, is_declared=is_declared)
