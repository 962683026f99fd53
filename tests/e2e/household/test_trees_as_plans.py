"""Behaviour trees as plans by hand: what the workshop's and our own do in the simulator, as the simulator sees it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Final
from uuid import UUID

import pytest
from pyrobosim.core import World

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.result import PlanResult
from planner_bridge.tasks.settings import Settings
from planner_bridge.yaml.trees import read_tree
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from tests.support.e2e.household.simulator import asked, has_reached, load_world, perform, without_waiting
from tests.support.e2e.household.workshop_tree import ACTIONS, WorkshopTree
from tests.support.files import ROOT

WORKSHOP: Final = ROOT.parent / "roscon24-workshop/technologies/BehaviorTree.CPP/pyrobosim_btcpp/trees/solution"

FETCH: Final = """<root BTCPP_format="4">
  <BehaviorTree ID="MainTree">
    <Sequence>
      <Navigate name="there" target="pantry"/>
      <IfThenElse>
        <DetectObject object="snacks0"/>
        <SubTree ID="Bring" thing="snacks0" to="table"/>
        <Navigate target="table"/>
      </IfThenElse>
    </Sequence>
  </BehaviorTree>
  <BehaviorTree ID="Bring">
    <Sequence>
      <RetryUntilSuccessful num_attempts="3"><PickObject object="{thing}"/></RetryUntilSuccessful>
      <Navigate target="{to}"/>
      <PlaceObject object="{thing}"/>
    </Sequence>
  </BehaviorTree>
</root>"""
SHUT: Final = """<root BTCPP_format="4"><BehaviorTree ID="MainTree"><Fallback>
  <RetryUntilSuccessful num_attempts="3"><Navigate target="dumpster"/></RetryUntilSuccessful>
  <Sequence><Navigate target="hall_dining_trash"/><Open target="hall_dining_trash"/><Navigate target="dumpster"/></Sequence>
</Fallback></BehaviorTree></root>"""


class Robots:
    """An action client: robots of a world, which act at once. The mutable state is what they were told to do."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.done: list[str] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        asyncio.get_running_loop().call_soon(self._perform, request, report)

    def cancel(self, request: UUID, /) -> None:
        pass

    def _perform(self, request: Request, report: Reporter) -> None:
        report(Accepted(request.id))
        kind, port = ACTIONS[request.action.name]
        self.done.append(kind)
        result = perform(self.world, asked(self.world.robots[0], kind, str(request.goal[port])))
        end = OutcomeKind.SUCCEEDED if result.is_success() else OutcomeKind.ABORTED
        asyncio.get_running_loop().call_soon(report, Ended(request.id, Outcome(end, {}, result.message or "")))


def carried_out(text: str, world: World, folder: Path) -> tuple[PlanResult, Robots]:
    file, robots = folder / "plan.yaml", Robots(world)
    file.write_text(read_tree(text, "tree.xml"), encoding="utf-8")
    with without_waiting():
        return carry_out(file, "MainTree", actions=robots, settings=Settings()), robots


def test_a_tree_with_a_choice_and_a_tree_inside_fetches_something(tmp_path: Path) -> None:
    world = load_world(1, seed=1)
    result, robots = carried_out(FETCH, world, tmp_path)
    assert result.goal_reached, result.reason
    assert robots.done == ["navigate", "detect", "pick", "navigate", "place"]
    assert has_reached(world, 1)


def test_what_fails_is_tried_so_often_and_then_the_next_child(tmp_path: Path) -> None:
    world = load_world(2, seed=1)
    result, robots = carried_out(SHUT, world, tmp_path)
    assert result.goal_reached, result.reason
    assert robots.done == ["navigate"] * 3 + ["navigate", "open", "navigate"]
    assert world.robots[0].location.parent.name == "dumpster"


def test_a_tree_that_fails_is_a_plan_that_fails(tmp_path: Path) -> None:
    result, robots = carried_out(SHUT.replace("<Open ", "<Close "), load_world(2, seed=1), tmp_path)
    assert not result.goal_reached
    assert robots.done == ["navigate"] * 3 + ["navigate", "close", "navigate"]  # which finds no way through the door


@pytest.mark.skipif(not WORKSHOP.is_dir(), reason="the workshop's repository is not here")
@pytest.mark.parametrize("problem", [1, 2, 3])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_workshops_own_tree_leaves_the_world_as_its_interpreter_does(problem: int, seed: int, tmp_path: Path) -> None:
    file, world, other = WORKSHOP / f"problem{problem}.xml", load_world(problem, seed), load_world(problem, seed)
    result, _ = carried_out(file.read_text(encoding="utf-8"), world, tmp_path)
    with without_waiting():
        assert WorkshopTree(other, file).run() is result.goal_reached is True
    states = [
        ({thing.name: thing.parent.name for thing in one.objects}, {place.name: place.is_open for place in (*one.locations, *one.hallways)})
        for one in (world, other)
    ]
    assert states[0] == states[1]
    assert has_reached(world, problem) or problem == 2  # whose tree leaves the dumpster open
    assert all(world.get_object_by_name(waste).parent.name == "dumpster_disposal" for waste in ("waste0", "waste1")[: 2 * (problem == 2)])
