"""`pnm odds` from outside."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT

PATROL = (str(ROOT / "domains/patrol/domain.pddl"), str(ROOT / "problems/patrol/p01.pddl"))
PLAN = """
actions:
  go: {params: [place]}
plan: [{go: {place: a}}, {go: {place: b}}]
"""


@pytest.fixture
def slippery(tmp_path: Path) -> str:
    file = tmp_path / "slippery.yaml"
    file.write_text("faults: [{action: move, do: abort, chance: 0.5}]\n")
    return str(file)


def test_odds_of_a_plan_are_its_chance_its_time_its_numbers_and_what_would_help(slippery: str) -> None:
    odds = result(pnm("odds", *PATROL, "--faults", slippery, "--replans", "0", "--json"))
    moves = [call for call in odds["weakest"] if call["call"].startswith("move(")]
    assert {call["chance_of_attempt"] for call in moves} == {0.5}
    assert {call["rests_on"] for call in moves} == {"declared"}
    chance = 1.0
    for call in moves:
        chance *= 1.0 - 0.5 ** call["attempts"]
    assert odds["chance"] == odds["alone"]["chance"] == pytest.approx(chance)
    assert odds["with_new_plans"] is None
    assert odds["alone"]["seconds"]["median"] <= odds["alone"]["seconds"]["ninety_percent"]
    assert "battery" in str(odds["alone"]["numbers"])
    (gain,) = odds["retries"]
    assert chance < gain["chances"][0] < gain["chances"][1] < 1.0


def test_new_plans_are_rolled_out(slippery: str) -> None:
    odds = result(pnm("odds", *PATROL, "--faults", slippery, "--seconds", "0.5", "--json"))
    low, high = odds["with_new_plans"]["interval"]
    assert low <= odds["chance"] == odds["with_new_plans"]["chance"] <= high
    assert odds["with_new_plans"]["runs"] > 1
    assert odds["chance"] > odds["alone"]["chance"]


def test_a_plan_by_hand_has_odds_too(tmp_path: Path) -> None:
    plan, faults = tmp_path / "plan.yaml", tmp_path / "faults.yaml"
    plan.write_text(PLAN)
    faults.write_text("faults: [{call: 'go(a)', do: abort, chance: 0.5}, {call: 'go(b)', do: reject, chance: 0.5}]\n")
    odds = result(pnm("odds", "--plan", str(plan), "--faults", str(faults), "--json"))
    assert odds["chance"] == odds["alone"]["chance"] == 0.5 * 0.5
    faults.write_text("faults: [{call: 'go(a)', do: abort, times: 1}, {call: 'go(b)', do: abort, times: 2}]\n")
    odds = result(pnm("odds", "--plan", str(plan), "--faults", str(faults), "--seconds", "0.2", "--json"))
    assert odds["alone"] is None
    assert odds["chance"] == 0.0


def test_no_plan_has_no_odds_and_options_of_the_other_kind_are_refused(tmp_path: Path) -> None:
    assert pnm("odds", *PATROL, "--name", "x").returncode == 2
    problem = tmp_path / "p.pddl"
    problem.write_text(Path(PATROL[1]).read_text().replace("(:goal", "(:goal (at r1 nowhere))\n(:ignored"))
    assert pnm("odds", PATROL[0], str(problem)).returncode != 0
