"""What follows from a domain alone is found once for each."""

from __future__ import annotations

import gc
from dataclasses import replace

from planner_bridge.model.guards import ForbiddenCall, forbid
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, once_per_domain
from planner_bridge.planning.kairos import parse_for_kairos, validate
from tests.support.pddl.problems import rooms


def test_an_answer_is_found_once_for_a_domain_and_again_for_an_equal_one() -> None:
    asked: list[tuple[Domain, int]] = []

    @once_per_domain
    def answer(domain: Domain, number: int) -> list[int]:
        asked.append((domain, number))
        return [number]

    first, other = rooms().domain, rooms().domain
    assert first == other
    assert answer(first, 1) is answer(first, 1)
    assert answer(first, 1) is not answer(other, 1)
    assert answer(first, 2) == [2]
    assert [number for _, number in asked] == [1, 1, 2]


def test_answers_go_with_their_domain() -> None:
    answers = set[int]()

    class Answer:
        def __init__(self) -> None:
            answers.add(id(self))

        def __del__(self) -> None:
            answers.discard(id(self))

    answer = once_per_domain(lambda _: Answer())
    domain = rooms().domain
    answer(domain)
    gc.collect()
    assert answers
    del domain
    gc.collect()
    assert not answers


def test_a_domain_that_forbids_the_same_kind_of_call_is_made_once_and_its_facts_differ() -> None:
    problem = rooms()
    first, other = (forbid(problem, frozenset({ForbiddenCall("move", ("r1", "a", room))})) for room in "bd")
    assert first.domain is other.domain
    assert set(first.guards) ^ set(other.guards) == {("forbidden-move", "r1", "a", room) for room in "bd"}


def test_kairos_reads_problems_of_one_domain_apart() -> None:
    away = rooms()
    there = replace(rooms(init="(at r1 c) (at r2 c)"), domain=away.domain)
    assert [bool(validate(problem, Plan(()), parse_for_kairos(problem))) for problem in (away, there, away)] == [True, False, True]
