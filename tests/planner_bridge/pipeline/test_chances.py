"""Actions with several outcomes: the best that can be done, and what is done in a world that draws them."""

import json

import pytest

from planner_bridge.pipeline.loading import load
from planner_bridge.planning.policies.policy import policies
from tests.support.files import ROOT, SHARED
from tests.support.pddl.outcomes.optimum import optimum
from tests.support.pddl.outcomes.play import HANGS, Kept, Way, behind, fill, row, trial
from tests.support.pddl.outcomes.problem import Chance

CASES = ROOT / "tests" / "support" / "pddl" / "outcomes" / "cases"
MANIFEST = json.loads((CASES / "manifest.json").read_text())
KNOWN = {
    **{"interesting_climber": 1.0, "interesting_river": 0.65, "tireworld_p01": 0.329},
    **{f"forest_p_2_{number}": 1 / 3 for number in (1, 3)},
}
"""Optima of published problems that were found elsewhere."""


@pytest.mark.parametrize("case", MANIFEST, ids=lambda case: case["name"])
def test_the_best_that_can_be_done_is_what_can_be_worked_out_by_hand(case):
    best = optimum(Chance.read(CASES / case["name"]))
    assert (best.chance, best.steps) == (pytest.approx(case["chance"], abs=1e-6), pytest.approx(case["steps"], abs=1e-6))


@pytest.mark.skipif(not (SHARED / "fond").is_dir(), reason="the published problems are not here")
@pytest.mark.parametrize("name", KNOWN)
def test_the_best_in_published_problems_is_known(name):
    assert optimum(Chance.read(SHARED / "fond" / name)).chance == pytest.approx(KNOWN[name], abs=5e-4)


def test_a_door_that_may_be_locked_is_not_tried_before_the_battery_is_full():
    chance = Chance.read(CASES / "door")
    best, state = optimum(chance).best, chance.initial
    for name, arguments in (("drive", "dock lobby l4 l3"), ("drive", "lobby hall l3 l2"), ("try", "hall room l2 l1")):
        ends = chance.successors(chance.action(name, arguments.split()), state)
        _, state = ends[0]
    assert [best[after] for _, after in ends] == [1.0, 0.0]
    assert best[chance.initial] == 1.0


@pytest.mark.parametrize("case", MANIFEST, ids=lambda case: case["name"])
def test_what_can_be_had_is_planned(case):
    folder = CASES / case["name"]
    *_, best = policies(load(folder / "domain.pddl", folder / "problem.pddl"), 60.0)
    assert (best.chance, best.is_proved) == (pytest.approx(case["chance"]), case["chance"] == 1.0)
    assert not case["steps"] or case["steps"] - 1e-6 <= best.steps()[0].expected <= 1.1 * case["steps"]


@pytest.mark.parametrize("way", ["policy", "whole"])
@pytest.mark.parametrize("case", MANIFEST, ids=lambda case: case["name"])
def test_what_can_be_had_for_certain_is_reached_every_time_and_nothing_is_said_to_be_that_is_not(case, way):
    folder, kept = CASES / case["name"], Kept()
    chance, problem = Chance.read(folder), load(folder / "domain.pddl", folder / "problem.pddl")
    trials = [trial(chance, problem, Way(way, 1000, 60.0), seed, kept) for seed in range(10)]
    assert [one["claimed"] for one in trials] == [one["reached"] for one in trials]
    assert all(one["reached"] for one in trials) or case["chance"] < 1.0
    assert kept.searches == 1 or case["chance"] < 1.0


def test_too_many_states_have_no_optimum():
    assert optimum(Chance.read(CASES / "door"), most=10) is None


def test_trials_are_played_once_and_judged_by_the_world():
    found, pair = {}, {"name": "no_towel", "prp": {"succeeded": "100"}}
    list(fill(CASES / "no_towel", Way("replanner", 100, 60.0), 2, found))
    first = list(found["trials"])
    list(fill(CASES / "no_towel", Way("replanner", 100, 60.0), 4, found))
    trials = found["trials"]
    assert trials[:2] == first
    assert [one["seed"] for one in trials] == [0, 1, 2, 3]
    assert [one["claimed"] for one in trials] == [one["reached"] for one in trials]
    assert "/4 | 0.360 | 100 |" in row(pair, found)


def test_a_trial_of_too_many_actions_has_failed_and_one_without_an_end_hangs():
    found = {}
    list(fill(CASES / "latches", Way("replanner", 0, 60.0), 1, found))
    assert [(one["claimed"], one["reached"]) for one in found["trials"]] == [(False, False)]
    found = {"optimum": None}
    list(fill(CASES / "latches", Way("replanner", 100, 0.0), 9, found))
    assert [one["why"] for one in found["trials"]] == [HANGS] * 3
    assert behind({"name": "latches", "ffr": {"succeeded": "100"}}, found) == ["ffr"]
