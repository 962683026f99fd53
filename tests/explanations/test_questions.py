"""A few random questions why per domain, and that the checks notice a false answer; `python -m tests.explanations` asks many."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.explanations.answer import Answer, Best, Claim, Fails, Known, NoSmallerChange, Solves, Unsolvable
from planner_bridge.model.plan import Plan
from planner_bridge.planning.solve import solve
from tests.support.pddl.explanations.checked_claims import Checked, smaller
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.explanations.questions import ask, domains, read
from tests.support.pddl.problems import matches

DOMAINS = domains()


@pytest.mark.parametrize("name", DOMAINS)
def test_no_answer_is_false(name: str) -> None:
    checked = Checked()
    for asked in ask(read(DOMAINS[name]), 2):
        for answer in asked.answers:
            checked.look(answer)
    assert checked.false == []


def plan() -> Plan:
    found = solve(house(""), improve=0.0).plan
    assert found
    return found


@pytest.mark.parametrize(
    ("known", "claim"),
    [
        (Known.SEARCH, Unsolvable(house(""))),
        (Known.SEARCH, Unsolvable(matches())),
        (Known.SEARCH, Solves(house(), plan())),
        (Known.SEARCH, Fails(house(""), plan())),
        (Known.SEARCH, Best(house(""), replace(plan(), steps=(*plan().steps, plan().steps[-1])))),
        (Known.SEARCH, NoSmallerChange(house(), 2)),
        (Known.NOT_PROVED, Solves(house(""), plan())),
    ],
)
def test_a_false_claim_is_noticed_and_one_that_is_called_not_proved(known: Known, claim: Claim) -> None:
    checked = Checked()
    checked.look(Answer("it is so", known, (), (claim,)))
    assert len(checked.false) == 1


def test_what_a_quantified_goal_asks_for_is_no_smaller_change() -> None:
    checked = Checked()
    every = house(goal="(forall (?c - cup) (has r1 ?c))")
    checked.look(Answer("it is so", Known.SEARCH, (), (NoSmallerChange(every, 1),)))
    changes = [change for change in smaller(every, 2) if change.init.get(("has", "r1", "cup")) is True]
    assert (checked.false, changes) == ([], [])
