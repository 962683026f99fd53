"""Chances of outcomes: learned from journals, and used where none are declared."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.explanations.learning import learn
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Call, Counts, End, Rates
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.roll_outs import odds_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, Faults
from pnm.core.machine.bindings import Bindings
from tests.support.e2e.command_line import pnm, result as result_of
from tests.support.files import written

SNATCH = "(:action snatch :precondition (free) :effect (and (not (free)) (oneof (held) (broken))))"
GRAB = "(:action grab :precondition (free) :effect (and (not (free)) (probabilistic 0.7 (held) 0.3 (broken))))"
DOMAIN = f"""(define (domain cup) (:requirements :strips :non-deterministic :probabilistic-effects)
  (:predicates (free) (held) (broken)) {SNATCH} {GRAB})"""
PROBLEM = "(define (problem p) (:domain cup) (:init (free)) (:goal (held)))"


def cup(domain: str = DOMAIN) -> Problem:
    return parse_problem(PROBLEM, parse_domain(domain))


def snatched(folder: Path, *outcomes: str, bindings: Bindings = Bindings()) -> Rates:
    """What is learned from runs in which there is no other way than to snatch the cup."""
    rates = NO_RATES
    for number, outcome in enumerate(outcomes):
        faults, journal = Faults((Fault("snatch", outcome=outcome),)), folder / str(number)
        achieve(None, cup(DOMAIN.replace(GRAB, "")), faults=faults, journal=journal, settings=Settings(bindings=bindings))
        rates = learn(journal, rates)
    return rates


def test_a_policy_takes_the_way_that_has_turned_out_well(tmp_path: Path) -> None:
    rates = snatched(tmp_path, "1", "1", "1", "2", "1", "1", "1", "1", "1")
    assert rates.calls[Call("snatch", "snatch")].outcomes == {"1": 8, "2": 1}
    for learned, first, chance in ((NO_RATES, "grab", 0.7), (rates, "snatch", 0.85)):
        result = solve(cup(), learned=learned, improve=0.0)
        assert result.plan is not None
        assert result.policy is not None
        assert result.plan.steps[0].action == first
        assert result.policy.chance == pytest.approx(chance)
    odds = odds_of_goal(cup(), result.plan, Settings(learned=rates), NO_FAULTS, policy=result.policy, seconds=600.0, most=150)
    assert odds.alone is not None
    assert odds.rolled is not None
    assert odds.alone.chance == pytest.approx(0.85, abs=0.01)
    assert odds.rolled.chance == pytest.approx(0.85, abs=0.12), "robots of roll-outs draw from what was learned"
    low, high = odds.alone.interval
    assert low < 0.65 < 0.95 < high, "nine times say little"
    assert odds.rests == {"learned from 9 of snatch": ["snatch"], "outcomes learned from 9 of snatch": ["snatch"]}


def test_outcomes_that_nothing_tells_apart_are_not_counted(tmp_path: Path) -> None:
    rates = snatched(tmp_path, "1", "2", bindings=Bindings(assumed=frozenset({"held", "broken"})))
    assert rates.calls[Call("snatch", "snatch")] == Counts({End.SUCCEEDED: 2}, rates.calls[Call("snatch", "snatch")].took)


def test_commands_count_outcomes_and_say_what_chances_rest_on(tmp_path: Path) -> None:
    texts = {"domain.pddl": DOMAIN.replace(GRAB, ""), "problem.pddl": PROBLEM, "faults.yaml": 'faults: [{action: snatch, outcome: "1"}]'}
    domain, problem, faults = (str(written(tmp_path / name, text)) for name, text in texts.items())
    for _ in range(3):
        assert pnm("run", domain, problem, "--faults", faults, "--learn", "-q").returncode == 0
    rates = (tmp_path / "rates.yaml").read_text()
    assert "# outcomes of snatch: 1 100.0%" in rates
    assert 'outcomes: {"1": 3}' in rates
    assert "reaches the goal with a chance of 87.5%" in pnm("plan", domain, problem).stdout
    assert "chances  outcomes learned from 3 of snatch: snatch\n" in pnm("odds", domain, problem, "--replans", "0").stdout


def test_new_plans_in_roll_outs_count_with_what_was_learned_as_those_of_runs_do(tmp_path: Path) -> None:
    ask = "(:action ask :precondition (free) :effect (and (not (free)) (held)))"
    never, always = Counts.of(End.ABORTED_FOR_GOOD, 1.0), Counts.of(End.SUCCEEDED, 1.0, "1")
    rates = NO_RATES.grown("j", 1, [*[(Call("ask", "ask"), never)] * 60, *[(Call("snatch", "snatch"), always)] * 60])
    texts = {"domain.pddl": DOMAIN.replace(GRAB, GRAB + ask), "problem.pddl": PROBLEM, "rates.yaml": rates.text()}
    domain, problem, _ = (str(written(tmp_path / name, text)) for name, text in texts.items())
    found = result_of(pnm("odds", domain, problem, "--json"))
    assert found["alone"]["chance"] < 0.1
    assert found["with_new_plans"]["chance"] > 0.85, "to snatch, and not to grab with 0.7"
