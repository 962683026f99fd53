"""The laws of the problem that is served."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest
from hypothesis import example, given, strategies as st

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.loading import load
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, fluent_text
from pnm.errors import InputError
from tests.support.files import ROOT
from tests.support.tasks.world import DOMAIN, PROBLEM, updated, world

ROBOTS, PLACES = ("r1", "R2", "a1"), ("kitchen", "hall", "dock")
robots, places = st.sampled_from(ROBOTS), st.sampled_from(PLACES)
facts = st.one_of(st.tuples(st.just("at"), robots, places), st.tuples(st.just("charged"), robots), st.just(("dark",)))
numbers = st.floats(allow_nan=False, allow_infinity=False)
states = st.dictionaries(
    st.one_of(facts, st.tuples(st.sampled_from(["at", "battery", "location", "spam", "dark"]), st.sampled_from([*ROBOTS, *PLACES, "x"]))),
    st.one_of(st.booleans(), st.floats(), st.sampled_from([*PLACES, "r1", "spam", UNDEFINED, UNKNOWN])),
    max_size=12,
)


@given(states, st.floats(0, 10))
@example({("battery", "r1"): inf, ("battery", "R2"): nan, ("location", "r1"): "r1"}, 0.0)
def test_the_problem_that_is_written_reads_back_equal_whatever_was_reported(reported, elapsed):
    knowledge = initial_knowledge(PROBLEM)
    knowledge.update(reported)
    shared = SharedWorld(PROBLEM, knowledge, elapsed=lambda: elapsed)
    domain = parse_domain(shared.domain_text())
    assert domain == DOMAIN
    now = replace(problem_now(PROBLEM, knowledge, elapsed), unknown=frozenset())  # PDDL does not say what is unknown
    assert parse_problem(shared.problem_text(), domain) == now


@pytest.mark.parametrize("name", ["delivery/p01", "mall_guide/p01", "patrol/p01"])
def test_the_problems_of_the_project_read_back_equal(name):
    domain, number = name.split("/")
    problem = load(ROOT / "domains" / domain / "domain.pddl", ROOT / "problems" / domain / f"{number}.pddl")
    shared = SharedWorld(problem, initial_knowledge(problem))
    assert parse_problem(shared.problem_text(), parse_domain(shared.domain_text())) == problem
    assert all(answer != "unknown" for _, answer in shared.query([]))


@given(
    st.dictionaries(facts, st.sampled_from([True, False, UNKNOWN])),
    st.dictionaries(st.tuples(st.just("battery"), robots), st.one_of(numbers, st.just(UNKNOWN))),
    st.dictionaries(st.tuples(st.just("location"), robots), st.one_of(places, st.just(UNKNOWN))),
)
def test_what_is_told_is_what_is_answered(truths, battery, location):
    shared = world()
    told = {**truths, **battery, **location}
    updated(
        shared,
        [as_text(fluent, value) for fluent, value in told.items() if value is not UNKNOWN and value is not False],
        [fluent_text(fluent) for fluent, value in told.items() if value is False],
        [fluent_text(fluent) for fluent, value in told.items() if value is UNKNOWN],
    )
    for fluent, (_, answer) in zip(told, shared.query([*map(fluent_text, told)]) if told else (), strict=True):
        value = told[fluent]
        if isinstance(value, float):
            assert float(answer) == value
        else:
            assert answer == ("unknown" if value is UNKNOWN else str(value).lower() if isinstance(value, bool) else value)


def as_text(fluent, value):
    return f"(= {fluent_text(fluent)} {value!r})" if isinstance(value, float) else statement_text(fluent, value)


@given(st.lists(st.one_of(st.text(max_size=30), st.text("()= atr1dkhl?0.", max_size=20)), max_size=3))
def test_no_text_does_more_than_be_refused(texts):
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge)
    for use in (lambda: shared.query(texts or ["x"]), lambda: updated(shared, texts), lambda: updated(shared, [], texts, texts)):
        before = knowledge.facts()
        try:
            use()
        except InputError:
            assert knowledge.facts() == before
