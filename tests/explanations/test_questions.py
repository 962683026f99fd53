"""A few random questions why per domain, and that the checks notice a false answer; `python -m tests.explanations` asks many."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import pytest

from planner_bridge.explanations.answer import Answer, Best, Claim, Fails, Known, NoSmallerChange, Solves, Unsolvable
from planner_bridge.model.plan import Plan
from planner_bridge.planning.solve import solve
from tests.support.pddl.explanations.checked_claims import Checked, smaller
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.explanations.questions import ask, domains, read
from tests.support.pddl.explanations.second_planner import Verdict, allowing_more, second_opinion
from tests.support.pddl.problems import matches, rooms, tanks

pytestmark = pytest.mark.skipif(find_spec("up_fast_downward") is None, reason="the second planner is not installed")
DOMAINS = domains()


@pytest.mark.parametrize("name", DOMAINS)
def test_no_answer_is_false(name: str) -> None:
    checked = Checked()
    for asked in ask(read(DOMAINS[name]), 3):
        for answer in asked.answers:
            checked.look(answer)
    assert checked.false == []


def plan() -> Plan:
    found = solve(house(""), improve=0.0).plan
    assert found
    return found


@pytest.mark.parametrize(
    "claim",
    [
        Unsolvable(house("")),
        Unsolvable(matches()),
        Solves(house(), plan()),
        Fails(house(""), plan()),
        Best(house(""), replace(plan(), steps=(*plan().steps, plan().steps[-1]))),
        NoSmallerChange(house(), 2),
    ],
    ids=lambda claim: type(claim).__name__,
)
def test_a_false_claim_is_noticed(claim: Claim) -> None:
    checked = Checked()
    checked.look(Answer("it is so", Known.SEARCH, (), (claim,)))
    assert len(checked.false) == 1


def test_what_claims_something_is_not_called_not_proved() -> None:
    checked = Checked()
    checked.look(Answer("perhaps", Known.NOT_PROVED, (), (Solves(house(""), plan()),)))
    assert len(checked.false) == 1


def test_the_second_planner_agrees_where_it_can() -> None:
    assert [second_opinion(problem) for problem in (house(), house(""), matches())] == [
        Verdict.NO_PLAN,
        Verdict.PLAN,
        Verdict.PLAN_OF_MORE,
    ]
    assert second_opinion(rooms(ways="ab", goal="(at r1 c)")) is Verdict.NO_PLAN
    assert allowing_more(tanks()) is not None


def test_what_a_quantified_goal_asks_for_is_no_smaller_change() -> None:
    checked = Checked()
    every = house(goal="(forall (?c - cup) (has r1 ?c))")
    checked.look(Answer("it is so", Known.SEARCH, (), (NoSmallerChange(every, 1),)))
    changes = [change for change in smaller(every, 2) if change.init.get(("has", "r1", "cup")) is True]
    assert (checked.false, changes) == ([], [])
