"""The world that all tasks share, in texts: answers, changes, goals, and problems that are saved."""

from __future__ import annotations

import os
import resource
from contextlib import contextmanager
from math import inf, nan
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planner_bridge.loading import load
from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.node.problem_service import LoadedProblem, ServedProblem, load_texts, write_inside
from planner_bridge.node.world_queries import MAX_LENGTH, MAX_TEXTS, SharedWorld, read_goals
from planner_bridge.pddl import parse_domain, parse_problem, read_problem
from planner_bridge.tasks.settings import Settings
from pnm.clock import run_async
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, fluent_text
from pnm.errors import InputError
from tests.support.files import ROOT

DOMAIN = parse_domain(
    """(define (domain d) (:requirements :adl :fluents :derived-predicates)
    (:types robot place - object arm - robot)
    (:constants dock - place)
    (:predicates (charged ?r - robot) (at ?r - robot ?p - place) (ready ?r - robot) (dark))
    (:functions (battery ?r - robot) - number (location ?r - robot) - place)
    (:derived (ready ?r - robot) (and (charged ?r) (not (dark))))
    (:action wait :parameters (?r - robot) :effect (dark)))"""
)
PROBLEM = parse_problem(
    """(define (problem p) (:domain d) (:objects r1 R2 - robot a1 - arm kitchen hall - place)
    (:init (at r1 kitchen) (charged r1) (= (battery r1) 0.5) (= (location a1) hall) (at 5 (dark))) (:goal (at r1 hall)))""",
    DOMAIN,
)
GOALS = {"home": "(forall (?r - robot) (at ?r dock))", "dark": "(dark)"}


def world() -> SharedWorld:
    return SharedWorld(PROBLEM, initial_knowledge(PROBLEM), GOALS)


def answers(shared: SharedWorld, *questions: str) -> list[str]:
    return [answer for _, answer in shared.query(questions)]


# --- questions -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("(at r1 kitchen)", "true"),
        ("( AT R1 Kitchen )", "true"),
        ("(at r2 kitchen)", "false"),
        ("(charged a1)", "unknown"),
        ("(and (charged a1) (dark))", "false"),
        ("(or (charged a1) (not (dark)))", "true"),
        ("(exists (?r - robot) (at ?r kitchen))", "true"),
        ("(forall (?r - robot) (charged ?r))", "false"),
        ("(imply (dark) (charged a1))", "true"),
        ("(ready r1)", "true"),
        ("(ready a1)", "unknown"),
        ("(battery r1)", "0.5"),
        ("(battery r2)", "unknown"),
        ("(>= (battery r1) 0.5)", "true"),
        ("(>= (battery r2) 0.5)", "unknown"),
        ("(location a1)", "hall"),
        ("(location r1)", "undefined"),
        ("(= (location a1) hall)", "true"),
        ("(at r1 (location a1))", "false"),
        ("()", "true"),
    ],
)
def test_a_question_has_an_answer(question, answer):
    shared = world()
    shared.update(forget=["(charged a1)"])
    assert shared.query([question]) == [(question, answer)]


def test_without_a_question_everything_that_is_recorded_is_told():
    shared = world()
    shared.update(add=["(dark)"], forget=["(at r1 kitchen)"])
    assert set(shared.query([])) == {
        ("(at r1 kitchen)", "unknown"),
        ("(charged r1)", "true"),
        ("(dark)", "true"),
        ("(battery r1)", "0.5"),
        ("(location a1)", "hall"),
    }


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("", "1:1: the text is empty; expected something such as (at r1 kitchen)"),
        ("dark", "1:1: expected something in parentheses, such as (at r1 kitchen), found 'dark'"),
        ("(dark) (dark)", "1:8: expected the end of the text, found (dark)"),
        ("(dark", "1:1: this '(' is never closed"),
        ("(drak)", "1:2: unknown predicate 'drak'; did you mean 'dark'?"),
        ("(at r1\n kichen)", "2:2: unknown object 'kichen'; did you mean 'kitchen'?"),
        ("(at kitchen r1)", "1:5: 'kitchen' is of type place; expected robot"),
        ("(at r1)", "1:1: (at ?r - robot ?p - place) takes 2 arguments, found 1"),
        ("(at ?r hall)", "1:5: unknown variable '?r'"),
        ("(exists (?r - robto) (dark))", "1:15: unknown type 'robto'; did you mean 'robot'?"),
        ("(battery)", "1:1: (battery ?r - robot) takes 1 argument, found 0"),
        ("(" * 200 + ")" * 200, "1:101: nested deeper than 100 lists"),
        (f"({'x' * MAX_LENGTH})", f"1:1: {MAX_LENGTH + 2} characters; expected {MAX_LENGTH} at most"),
        (
            f"(exists ({' '.join(f'?x{number}' for number in range(12))}) (dark))",
            "1:1: its quantifiers range over more than 1000000 choices",
        ),
    ],
    ids=lambda text: text[:40],
)
def test_a_question_that_cannot_be_read_is_refused_with_its_place(question, said):
    with pytest.raises(InputError) as caught:
        world().query(["(dark)", question])
    assert str(caught.value).startswith(f"questions[1]:{said}")


def test_too_much_at_once_is_refused():
    with pytest.raises(InputError, match="10001 questions at once; expected 10000 at most"):
        world().query(["(dark)"] * (MAX_TEXTS + 1))
    with pytest.raises(InputError, match="10002 changes at once"):
        world().update(["(dark)"] * (MAX_TEXTS + 1), ["(dark)"])


# --- changes -------------------------------------------------------------------------------


def test_changes_are_recorded_and_counted():
    shared = world()
    assert (
        shared.update(["(dark)", "(charged R1)", "(= (battery r2) .5)", "(= (location r1) dock)"], ["(at r1 kitchen)"], ["(charged r2)"])
        == 5
    )
    questions = ("(dark)", "(battery r2)", "(location r1)", "(at r1 kitchen)", "(charged r2)", "(ready r1)")
    assert answers(shared, *questions) == ["true", "0.5", "dock", "false", "unknown", "false"]
    assert shared.update(["(dark)"], ["(at r1 kitchen)"], ["(charged r2)"]) == 0


def test_a_function_loses_the_object_that_is_removed_and_no_other():
    shared = world()
    assert shared.update(remove=["(= (location a1) kitchen)"]) == 0
    assert shared.update(["(= (location a1) kitchen)"], ["(= (location a1) hall)"]) == 1
    assert answers(shared, "(location a1)") == ["kitchen"]
    assert shared.update(remove=["(= (location a1) kitchen)"]) == 1
    assert answers(shared, "(location a1)") == ["undefined"]


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        ("add", "(ready r1)", "1:1: 'ready' is a derived predicate; it follows from others and cannot be set"),
        ("forget", "(ready r1)", "1:1: 'ready' is a derived predicate"),
        ("add", "(battery r1)", "1:1: (battery ...) is a function; expected it with its value"),
        ("remove", "(= (battery r1) 3)", "1:1: (battery r1) always has a number; expected it among what is added or forgotten"),
        ("add", "(= (battery r1) hall)", "1:17: expected a number, found 'hall'"),
        ("add", "(= (battery r1) 1e999)", "1:17: the number 1e999 is too large"),
        ("add", "(= (location r1) r2)", "1:18: 'R2' is of type robot; expected place"),
        ("add", "(= (location r1) (location a1))", "1:18: expected an object, found (location ...)"),
        ("add", "(= (batery r1) 3)", "1:5: unknown function 'batery'; did you mean 'battery'?"),
        ("add", "(not (dark))", "1:2: 'not' cannot stand here; expected a predicate"),
        ("add", "(and (dark))", "1:2: 'and' cannot stand here; expected a predicate"),
        ("remove", "(at r1 ?p)", "1:8: unknown variable '?p'"),
        ("add", "(at 3 (dark))", "1:5: unknown object '3'"),
        ("forget", "(charged r1)", "1:1: another one of the changes says something else of (charged r1)"),
        ("remove", "(= (location r1) dock)", "1:1: another one of the changes says something else of (location r1)"),
    ],
)
def test_a_change_that_is_refused_changes_nothing(kind, text, said):
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge)
    before = knowledge.facts()
    heard = []
    knowledge.listen(heard.append)
    changes = {"add": ["(dark)", "(charged r1)", "(= (location r1) dock)"], "remove": ["(at r1 kitchen)"], "forget": ["(charged a1)"]}
    changes[kind].append(text)
    with pytest.raises(InputError) as caught:
        shared.update(**changes)
    assert said in str(caught.value)
    if "another" not in said:
        assert str(caught.value).startswith(f"{kind}[{len(changes[kind]) - 1}]:{said}")
    assert (knowledge.facts(), heard) == (before, [])


def test_changes_are_told_as_texts():
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge)
    told = []
    knowledge.listen(lambda batch: told.append(shared.changes(batch)))
    shared.update(
        ["(dark)", "(= (battery r1) 3)", "(= (location a1) kitchen)", "(= (location r1) dock)"], ["(at r1 kitchen)"], ["(charged r1)"]
    )
    shared.update(remove=["(= (location a1) kitchen)"], forget=["(location r1)", "(battery r1)"])
    shared.update(["(= (location r1) dock)", "(= (location a1) dock)"])
    knowledge.store({"x": 1})
    assert told == [
        {
            "added": ["(dark)", "(= (location a1) kitchen)", "(= (location r1) dock)"],
            "removed": ["(= (location a1) hall)", "(at r1 kitchen)"],
            "unknown": ["(charged r1)"],
            "fluents": ["(battery r1)"],
            "values": [3.0],
        },
        {"added": [], "removed": ["(= (location a1) kitchen)"], "unknown": ["(location r1)", "(battery r1)"], "fluents": [], "values": []},
        {"added": ["(= (location r1) dock)", "(= (location a1) dock)"], "removed": [], "unknown": [], "fluents": [], "values": []},
        {"added": [], "removed": [], "unknown": [], "fluents": [], "values": []},
    ]


def test_the_object_that_a_function_no_longer_has_is_told_whatever_happened_before_anybody_followed():
    async def scene() -> None:
        knowledge, told = initial_knowledge(PROBLEM), []
        served = ServedProblem(LoadedProblem(PROBLEM, knowledge, {}, Settings()), Path(), lambda _: None)
        knowledge.update({("location", "a1"): "kitchen"})  # as sensors do while action servers are looked for
        stop = served.follow(lambda fields: told.append((fields["added"], fields["removed"], fields["unknown"])))
        for value in ("dock", UNKNOWN, UNDEFINED, "hall", UNDEFINED):
            knowledge.update({("location", "a1"): value})
        knowledge.store({"x": 1})
        stop()
        knowledge.update({("location", "a1"): "hall"})
        at = "(= (location a1) {})".format
        assert told == [
            ([at("dock")], [at("kitchen")], []),
            ([], [], ["(location a1)"]),
            ([at("undefined")], [], []),
            ([at("hall")], [], []),
            ([], [at("hall")], []),
        ]

    run_async(scene(), virtual=True)


# --- goals ---------------------------------------------------------------------------------


def test_goals_are_conditions_or_names():
    shared = world()
    assert shared.read_goal(" ") == PROBLEM.goal
    assert shared.read_goal("dark") == shared.read_goal(" (DARK) ; here") == shared.read_goal("; this\n(dark)")
    assert str(shared.read_goal("home")) == "(forall (?r - robot) (at ?r dock))"
    assert shared.read_goal("()") == TRUE


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hoem", "goal:1:1: there is no goal 'hoem'; did you mean 'home'?"),
        ("x", "goal:1:1: there is no goal 'x'; expected one of home, dark, or a condition"),
        ("(and (dark)\n  (at r1 hal))", "goal:2:10: unknown object 'hal'; did you mean 'hall'?"),
        ("(battery r1)", "goal:1:2: 'battery' is a function; expected a predicate"),
        (";", "goal:1:1: the text is empty"),
    ],
)
def test_a_goal_that_cannot_be_read_is_refused(text, said):
    with pytest.raises(InputError) as caught:
        world().read_goal(text)
    assert str(caught.value).startswith(said)


def test_a_named_goal_that_cannot_be_read_is_refused_at_once():
    with pytest.raises(InputError, match=r"goal home:1:2: unknown predicate 'drak'"):
        SharedWorld(PROBLEM, initial_knowledge(PROBLEM), {"home": "(drak)"})
    with pytest.raises(InputError, match="there is no goal 'x'; expected a condition such as"):
        SharedWorld(PROBLEM, initial_knowledge(PROBLEM)).read_goal("x")


def test_goals_are_read_from_a_file(tmp_path):
    file = tmp_path / "goals.yaml"
    file.write_text("goals:\n  home: (dark)\n  all at home: >\n    (forall (?r - robot)\n      (at ?r dock))\n")
    goals = read_goals(file)
    assert goals == {"home": "(dark)", "all at home": "(forall (?r - robot)\n  (at ?r dock))\n"}
    SharedWorld(PROBLEM, initial_knowledge(PROBLEM), goals)
    for text, said in {
        "goal: {}": "1:1: unknown key 'goal'; did you mean 'goals'?",
        "goals: {(dark): (dark)}": "1:9: '(dark)' cannot name a goal; expected a word",
        "goals: {home: 3}": "1:15: expected a condition as a text for home",
        "goals: [home]": "1:8: expected a mapping",
    }.items():
        file.write_text(text)
        with pytest.raises(InputError) as caught:
            read_goals(file)
        assert str(caught.value).startswith(f"{file}:{said}")


# --- files ---------------------------------------------------------------------------------


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


# --- laws ----------------------------------------------------------------------------------

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
        [written(fluent, value) for fluent, value in told.items() if value is not UNKNOWN and value is not False],
        [fluent_text(fluent) for fluent, value in told.items() if value is False],
        [fluent_text(fluent) for fluent, value in told.items() if value is UNKNOWN],
    )
    for fluent, (_, answer) in zip(told, shared.query([*map(fluent_text, told)]) if told else (), strict=True):
        value = told[fluent]
        if isinstance(value, float):
            assert float(answer) == value
        else:
            assert answer == ("unknown" if value is UNKNOWN else str(value).lower() if isinstance(value, bool) else value)


def written(fluent, value):
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
