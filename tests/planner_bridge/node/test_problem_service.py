"""The problem that is served: its laws, plans that are only looked for, and the folder, with all that may not be read or written."""

from __future__ import annotations

import os
import resource
from contextlib import contextmanager
from dataclasses import replace
from math import inf, nan

import pytest
from hypothesis import example, given, strategies as st

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.node.options import PARAMETERS, Options
from planner_bridge.node.problem_service import ProblemFolder, load_texts
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.pddl import parse_domain, parse_problem, read_problem
from planner_bridge.pipeline.loading import load
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, fluent_text
from pnm.errors import InputError
from pnm.tasks import Code, StepState
from tests.support.files import ROOT
from tests.support.pddl.problems import rooms
from tests.support.runs.simulated import in_virtual_time
from tests.support.tasks.world import DOMAIN, PROBLEM, served, updated, world

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


# --- a plan is only looked for ---

ROOMS = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")


@in_virtual_time
async def test_a_plan_is_looked_for_from_the_world_as_it_is():
    knowledge = initial_knowledge(ROOMS)
    knowledge.update({("at", "r1", "a"): False, ("at", "r1", "b"): True})
    node = served(knowledge, ROOMS)
    made = await node.make("", "", None)
    assert (made.code, [(step.arguments, step.state) for step in made.steps]) == (
        Code.GOAL_REACHED,
        [(("r1", "b", "c"), StepState.WAITING)],
    )
    assert (await node.make("(at r1 b)", "", 5.0)).steps == ()
    assert (await node.make("(at r1 a)", "", 5.0)).code is Code.NO_PLAN
    for goal, planner, said in (("", "kairoz", "kairoz"), ("(flies r1)", "", "goal:1:2: unknown predicate")):
        with pytest.raises(InputError, match=said):
            await node.make(goal, planner, 5.0)


# --- the folder of problems ---


def test_a_problem_is_saved_as_it_is_now(tmp_path):
    knowledge, folder = initial_knowledge(PROBLEM), ProblemFolder(tmp_path)
    shared = SharedWorld(PROBLEM, knowledge, elapsed=lambda: 2.0)
    updated(shared, ["(= (battery r2) 0.1)"], ["(at r1 kitchen)"], ["(charged r1)"])
    (tmp_path / "today").mkdir()
    path = folder.write("today/p.pddl", shared.problem_text())
    assert path == (tmp_path / "today" / "p.pddl").resolve()
    saved = read_problem(path, DOMAIN)
    assert saved == replace(problem_now(PROBLEM, knowledge, 2.0), unknown=frozenset()), "PDDL does not say what is unknown"
    assert [change.time for change in saved.timed] == [3.0]
    assert saved.init == {("battery", "r1"): 0.5, ("battery", "R2"): 0.1, ("location", "a1"): "hall"}
    nothing = parse_domain("(define (domain nothing))")
    assert load_texts("", "today/p.pddl", folder, DOMAIN) == saved
    assert load_texts(shared.domain_text(), shared.problem_text(), folder, nothing) == saved
    (tmp_path / "d.pddl").write_text(shared.domain_text())
    assert load_texts("d.pddl", f"; saved\n{shared.problem_text()}", folder, nothing) == saved


OUTSIDE = ["../p.pddl", "/etc/p.pddl", "a/../../p.pddl", "", " ", ".", "out/p.pddl", "a\0b.pddl", "x" * 5000, "x" * 5000 + ".pddl"]
HIDDEN = [".p.pddl", ".ssh/p.pddl", "a/.b/p.pddl", "link.pddl", ".bashrc", ".pddl"]
OTHERS = ["p", "p.yaml", "bindings.yaml", "p.pddl.txt"]


@pytest.mark.parametrize("name", [*OUTSIDE, *HIDDEN, *OTHERS])
def test_only_pddl_files_in_the_folder_that_are_not_hidden_are_written_or_read(tmp_path, name):
    root = tmp_path / "problems"
    (root / ".ssh").mkdir(parents=True)
    (root / "a" / ".b").mkdir(parents=True)
    (root / "out").symlink_to(tmp_path)
    (root / "link.pddl").symlink_to(root / ".ssh" / "keys")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError):
        ProblemFolder(root).write(name, world().problem_text())
    with pytest.raises(InputError):
        load_texts("", name, ProblemFolder(root), DOMAIN)
    assert sorted(tmp_path.rglob("*")) == before


def test_only_problems_are_overwritten_and_never_the_one_that_the_node_begins_with(tmp_path):
    folder, text = ProblemFolder(tmp_path, tmp_path / "first.pddl"), world().problem_text()
    contents = {
        "domain.pddl": world().domain_text(),
        "notes.pddl": "; (define (problem p)\n",
        "empty.pddl": "",
        "latin.pddl": "password",
        "first.pddl": "; Grüße\n(DEFINE (problem first))",
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content, encoding="latin-1")
        with pytest.raises(InputError, match=rf"{name}: cannot be written: "):
            folder.write(name, text)
        assert (tmp_path / name).read_text(encoding="latin-1") == content
    (tmp_path / "again.pddl").symlink_to(tmp_path / "first.pddl")
    with pytest.raises(InputError, match="the node begins with this problem"):
        folder.write("again.pddl", text)
    os.mkfifo(tmp_path / "fifo.pddl")
    with pytest.raises(InputError, match="it is not a regular file"):
        folder.write("fifo.pddl", text)
    (tmp_path / "other.pddl").write_text("; from yesterday\n\n(Define\n(problem p))")
    assert folder.write("other.pddl", text).read_text() == text
    assert folder.write("other.pddl", text).read_text() == text


def test_a_node_has_no_folder_for_problems_unless_it_is_given_one(tmp_path):
    usual = {parameter.name: parameter.default for parameter in PARAMETERS}
    options = Options.of({**usual, "world": "world.yaml"})
    folder = ProblemFolder(options.problems, options.problem)
    for use in (lambda: folder.write("p.pddl", "x"), lambda: load_texts("", "p.pddl", folder, DOMAIN)):
        with pytest.raises(InputError, match="the node has no folder for problems; expected one in its parameter 'problems'"):
            use()
    assert load_texts("", world().problem_text(), folder, DOMAIN).name == PROBLEM.name
    with pytest.raises(InputError, match=r"there is no folder '.*nowhere' for problems"):
        ProblemFolder(tmp_path / "nowhere")


@contextmanager
def no_file_larger_than(size: int):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_what_cannot_be_written_whole_is_not_written_at_all(tmp_path):
    folder, before = ProblemFolder(tmp_path), "(define (problem before))"
    path = folder.write("p.pddl", before)
    with no_file_larger_than(100), pytest.raises(InputError, match=r"p\.pddl: cannot be written: File too large"):
        folder.write("p.pddl", "x" * 1000)
    assert (path.read_text(), os.listdir(tmp_path)) == (before, ["p.pddl"])
    (tmp_path / "folder.pddl").mkdir()
    with pytest.raises(InputError, match="this is a folder"):
        folder.write("folder.pddl", "x")
    for name in ("p.pddl/q.pddl", "nowhere/q.pddl"):
        with pytest.raises(InputError, match="cannot be written: "):
            folder.write(name, "x")
