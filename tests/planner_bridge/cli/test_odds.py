"""`pnm odds` from outside."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.model.rates import Call, Counts, End, Rates, Times
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


def test_a_run_says_its_odds_and_does_not_begin_below_those_that_are_asked_for(slippery: str, tmp_path: Path) -> None:
    told = pnm("run", *PATROL, "--faults", slippery)
    assert "odds     31.6 %, 7.5 s" in told.stdout
    low = result(pnm("run", *PATROL, "--faults", slippery, "--replans", "0", "--odds", "0.5", "--json"))
    assert (low["goal_reached"], low["calls"]) == (False, [])
    assert low["reason"].startswith("no plan: one was found, and is not begun: its odds are 31.6 %, ")
    assert low["reason"].endswith(" of the runs, if nothing is planned anew; expected 50.0 % at least")
    enough = result(pnm("run", *PATROL, "--faults", slippery, "--replans", "0", "--odds", "0.3", "--json"))
    assert enough["calls"]
    assert enough["odds"]["chance"] == pytest.approx(0.75**4)
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN)
    refused = pnm("run", "--plan", str(plan), "--odds", "0.9")
    assert refused.returncode == 1
    assert refused.stderr.startswith("the plan is not begun: its odds are 81.0 %")
    assert pnm("run", "--plan", str(plan), "--odds", "0.8").returncode == 0


def test_learned_rates_beside_the_domain_are_used(tmp_path: Path) -> None:
    domain, problem = tmp_path / "domain.pddl", tmp_path / "problem.pddl"
    for file, text in ((domain, PATROL[0]), (problem, PATROL[1])):
        file.write_text(Path(text).read_text())
    assert "odds" not in result(pnm("plan", str(domain), str(problem), "--json"))
    assert result(pnm("odds", str(domain), str(problem), "--replans", "0", "--json"))["rests_on"] == {"assumed": ["move", "inspect"]}
    ends = {End.SUCCEEDED: 90, End.ABORTED: 10}
    rates = Rates({Call(action, action): Counts(ends, Times({50: 90}, 300_000)) for action in ("move", "inspect")}, {"0": 1})
    (tmp_path / "rates.yaml").write_text(rates.text())
    odds = result(pnm("plan", str(domain), str(problem), "--json"))["odds"]
    assert odds["rests_on"] == {"learned from 100 of move": ["move"], "learned from 100 of inspect": ["inspect"]}
    low, high = odds["alone"]["interval"]
    assert low < odds["chance"] < high
    assert f"odds     {100 * odds['chance']:.1f} %, " in pnm("plan", str(domain), str(problem)).stdout
    (tmp_path / "rates.yaml").write_text("journals: none\n")
    assert pnm("net", str(domain), str(problem)).returncode == 2, "its plan is that of pnm plan"
