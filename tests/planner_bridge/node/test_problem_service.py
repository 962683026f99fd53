"""The problem that is served: loaded, saved, and its laws."""

from __future__ import annotations

import os
import resource
from contextlib import contextmanager
from math import inf, nan

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planner_bridge.loading import load
from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.node.problem_service import load_texts, write_inside
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.pddl import parse_domain, parse_problem, read_problem
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, fluent_text
from pnm.errors import InputError
from tests.support.files import ROOT
from tests.support.tasks.world import DOMAIN, PROBLEM, world

# --- files ---


def test_a_problem_is_saved_as_it_is_now(tmp_path):
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge, elapsed=lambda: 2.0)
    shared.update(["(= (battery r2) 0.1)"], ["(at r1 kitchen)"], ["(charged r1)"])
    path = write_inside(tmp_path, "today/p.pddl", shared.problem_text())
    assert path == (tmp_path / "today" / "p.pddl").resolve()
    saved = read_problem(path, DOMAIN)
    assert saved == problem_now(PROBLEM, knowledge, 2.0)
    assert [change.time for change in saved.timed] == [3.0]
    assert saved.init == {("battery", "r1"): 0.5, ("battery", "R2"): 0.1, ("location", "a1"): "hall"}
    assert load_texts("", "today/p.pddl", tmp_path, DOMAIN) == saved
    assert load_texts(shared.domain_text(), shared.problem_text(), tmp_path, read_nothing()) == saved
    (tmp_path / "d.pddl").write_text(shared.domain_text())
    assert load_texts("d.pddl", f"; saved\n{shared.problem_text()}", tmp_path, read_nothing()) == saved


def read_nothing():
    return parse_domain("(define (domain nothing))")


@pytest.mark.parametrize("name", ["../p.pddl", "/etc/p.pddl", "a/../../p.pddl", "", " ", ".", "out/p.pddl", "a\0b", "x" * 5000])
def test_nothing_is_written_or_read_outside_of_the_folder(tmp_path, name):
    folder = tmp_path / "problems"
    folder.mkdir()
    (folder / "out").symlink_to(tmp_path)
    with pytest.raises(InputError):
        write_inside(folder, name, world().problem_text())
    with pytest.raises(InputError):
        load_texts("", name, folder, DOMAIN)
    assert [*tmp_path.rglob("*.pddl")] == []


@contextmanager
def no_file_larger_than(size: int):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_what_cannot_be_written_whole_is_not_written_at_all(tmp_path):
    path = write_inside(tmp_path, "p.pddl", "before")
    with no_file_larger_than(100), pytest.raises(InputError, match=r"p\.pddl: cannot be written: File too large"):
        write_inside(tmp_path, "p.pddl", "x" * 1000)
    assert (path.read_text(), os.listdir(tmp_path)) == ("before", ["p.pddl"])
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written: it is a folder"):
        write_inside(tmp_path, "folder", "x")
    with pytest.raises(InputError, match="cannot be written: "):
        write_inside(tmp_path, "p.pddl/q.pddl", "x")


ROBOTS, PLACES = ("r1", "R2", "a1"), ("kitchen", "hall", "dock")
robots, places = st.sampled_from(ROBOTS), st.sampled_from(PLACES)
facts = st.one_of(st.tuples(st.just("at"), robots, places), st.tuples(st.just("charged"), robots), st.just(("dark",)))
numbers = st.floats(allow_nan=False, allow_infinity=False)
states = st.dictionaries(
    st.one_of(facts, st.tuples(st.sampled_from(["at", "battery", "location", "spam", "dark"]), st.sampled_from([*ROBOTS, *PLACES, "x"]))),
    st.one_of(st.booleans(), st.floats(), st.sampled_from([*PLACES, "r1", "spam", UNDEFINED, UNKNOWN])),
    max_size=12,
)


# --- laws ---


@given(states, st.floats(0, 10))
@example({("battery", "r1"): inf, ("battery", "R2"): nan, ("location", "r1"): "r1"}, 0.0)
def test_the_problem_that_is_written_reads_back_equal_whatever_was_reported(reported, elapsed):
    knowledge = initial_knowledge(PROBLEM)
    knowledge.update(reported)
    shared = SharedWorld(PROBLEM, knowledge, elapsed=lambda: elapsed)
    domain = parse_domain(shared.domain_text())
    assert domain == DOMAIN
    assert parse_problem(shared.problem_text(), domain) == problem_now(PROBLEM, knowledge, elapsed)


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
    shared.update(
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
    for use in (lambda: shared.query(texts or ["x"]), lambda: shared.update(texts), lambda: shared.update([], texts, texts)):
        before = knowledge.facts()
        try:
            use()
        except InputError:
            assert knowledge.facts() == before
