"""Real robot problems, where their folder is present beside the project: each ends as it should."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from planner_bridge.loading import load
from planner_bridge.pipeline import Stopwatch, pursue
from planner_bridge.sites import SimulatedSite
from planner_bridge.tasks import Settings, TaskObserver
from pnm.clock import run_async
from pnm.conditions import evaluate
from pnm.errors import InputError

FOLDER = Path(__file__).parents[2] / "shared" / "pddl" / "robots"

SOLVED: Final = [
    "amazon",
    "charging",
    "delivery_deadline_w6_m3_g3",
    "delivery_deadline_w6_m4_g3",
    "delivery_w4_m3_g2",
    "delivery_w4_m3_g3",
    "delivery_w4_m4_g3",
    "delivery_w5_m3_g2",
    "delivery_w5_m4_g3",
    "delivery_w5_m5_g3",
    "delivery_w6_m3_g3",
    "delivery_w6_m5_g3",
    "elevators_netbenefit",
    "lights",
    "match_cellar",
    "road_trip",
    "rosplan_test",
    "simple_1",
    "test_2",
    "turtlebot",
]
NO_PLAN: Final = ("rosplan_test_no_solution", "simple_2")
REFUSED: Final = {
    "rosplan_test_invalid": "problem.pddl:1:2: expected 'define', found 'defie'",
    "simple_3": "problem.pddl:1:1: ",
    "blocks_observe": "domain.pddl:11:4: ",
}
present = pytest.mark.parametrize if FOLDER.is_dir() else lambda names, values: pytest.mark.parametrize(names, [])


def pair(name: str) -> tuple[Path, Path]:
    return FOLDER / name / "domain.pddl", FOLDER / name / "problem.pddl"


@present("name", SOLVED)
def test_solved_pairs_reach_their_goal_in_the_world(name: str) -> None:
    problem = load(*pair(name))
    settings = Settings()
    site = SimulatedSite(problem, settings.bindings)
    result = run_async(pursue(problem, site, settings, TaskObserver(), Stopwatch()), virtual=True)
    assert result.goal_reached, result.reason
    assert evaluate(problem.goal, site.robots.world.truth) is True
    assert result.replans == 0


@present("name", NO_PLAN)
def test_unsolvable_pairs_are_said_to_be(name: str) -> None:
    problem = load(*pair(name))
    result = run_async(pursue(problem, SimulatedSite(problem, Settings().bindings), Settings(), TaskObserver(), Stopwatch()), virtual=True)
    assert not result.goal_reached
    assert result.reason.startswith("no plan: proved unsolvable")
    assert result.calls == ()


@present("name", REFUSED)
def test_what_cannot_be_understood_is_refused_with_its_position(name: str) -> None:
    with pytest.raises(InputError) as refusal:
        load(*pair(name))
    assert REFUSED[name] in str(refusal.value)


@present("folder", [FOLDER])
def test_the_list_is_complete(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir() if path.is_dir()) == sorted([*SOLVED, *NO_PLAN, *REFUSED])
