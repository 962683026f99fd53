"""The world that all tasks share, in texts: questions, changes, goals."""

from __future__ import annotations

import re

import pytest

from planner_bridge.explanations.goal_now import unpacked
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.node.world_queries import MAX_LENGTH, MAX_TEXTS, SharedWorld, read_goals
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.core.machine.bindings import NO_BINDINGS
from pnm.errors import InputError
from tests.support.runs.simulated import in_virtual_time
from tests.support.tasks.world import PROBLEM, served, updated, world


def answers(shared: SharedWorld, *questions: str) -> list[str]:
    return [answer for _, answer in shared.query(questions)]


# --- questions ---


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
    updated(shared, forget=["(charged a1)"])
    assert shared.query([question]) == [(question, answer)]


def test_without_a_question_everything_that_is_recorded_is_told():
    shared = world()
    updated(shared, add=["(dark)"], forget=["(at r1 kitchen)"])
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
        ("(dark", "1:6: the text ends here; expected ')'"),
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
            "1:1: the quantifiers range over 2176782336 choices of objects; expected 50000 at most",
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
        updated(world(), ["(dark)"] * (MAX_TEXTS + 1), ["(dark)"])


# --- changes ---


def test_changes_are_recorded_and_counted():
    shared = world()
    assert (
        updated(shared, ["(dark)", "(charged R1)", "(= (battery r2) .5)", "(= (location r1) dock)"], ["(at r1 kitchen)"], ["(charged r2)"])
        == 5
    )
    questions = ("(dark)", "(battery r2)", "(location r1)", "(at r1 kitchen)", "(charged r2)", "(ready r1)")
    assert answers(shared, *questions) == ["true", "0.5", "dock", "false", "unknown", "false"]
    assert updated(shared, ["(dark)"], ["(at r1 kitchen)"], ["(charged r2)"]) == 0


def test_what_a_sensor_reports_is_not_overruled():
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge)
    knowledge.update({("at", "r1", "kitchen"): True})
    knowledge.sense({"at"})
    with pytest.raises(InputError, match=re.escape("a sensor reports (not (at r1 hall)); only facts without a sensor, and unknown ones")):
        shared.record(shared.read_changes(["(dark)", "(at r1 hall)"]))
    with pytest.raises(InputError, match=re.escape("a sensor reports (at r1 kitchen)")):
        shared.record(shared.read_changes(forget=["(at r1 kitchen)"]))
    assert answers(shared, "(dark)", "(at r1 hall)", "(at r1 kitchen)") == ["false", "false", "true"]
    assert shared.record(shared.read_changes(["(at r1 kitchen)"])) == 0
    knowledge.update({("at", "r1", "kitchen"): UNKNOWN})  # as when the sensor has fallen silent
    assert shared.record(shared.read_changes(["(at r1 kitchen)"])) == 1


def test_a_function_loses_the_object_that_is_removed_and_no_other():
    shared = world()
    assert updated(shared, remove=["(= (location a1) kitchen)"]) == 0
    assert updated(shared, ["(= (location a1) kitchen)"], ["(= (location a1) hall)"]) == 1
    assert answers(shared, "(location a1)") == ["kitchen"]
    assert updated(shared, remove=["(= (location a1) kitchen)"]) == 1
    assert answers(shared, "(location a1)") == ["undefined"]


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        ("add", "(ready r1)", "1:1: 'ready' is a derived predicate; it follows from others and cannot be set"),
        ("forget", "(ready r1)", "1:1: 'ready' is a derived predicate"),
        ("add", "(battery r1)", "1:1: (battery ...) is a function; expected it with its value"),
        ("remove", "(= (battery r1) 3)", "1:1: (battery r1) always has a number; expected it among the added or forgotten facts"),
        ("add", "(= (battery r1) hall)", "1:17: expected a number, found 'hall'"),
        ("add", "(= (battery r1) 1e999)", "1:17: the number 1e999 is too large"),
        ("add", "(= (location r1) r2)", "1:18: 'R2' is of type robot; expected place"),
        ("add", "(= (location r1) (location a1))", "1:18: expected an object, found (location ...)"),
        ("add", "(= (batery r1) 3)", "1:5: unknown function 'batery'; did you mean 'battery'?"),
        ("add", "(not (dark))", "1:2: 'not' cannot stand here; expected a predicate"),
        ("add", "(and (dark))", "1:2: 'and' cannot stand here; expected a predicate"),
        ("remove", "(at r1 ?p)", "1:8: unknown variable '?p'"),
        ("add", "(at 3 (dark))", "1:5: unknown object '3'"),
        ("forget", "(charged r1)", "1:1: another change contradicts this one about (charged r1)"),
        ("remove", "(= (location r1) dock)", "1:1: another change contradicts this one about (location r1)"),
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
        updated(shared, **changes)
    assert said in str(caught.value)
    if "another" not in said:
        assert str(caught.value).startswith(f"{kind}[{len(changes[kind]) - 1}]:{said}")
    assert (knowledge.facts(), heard) == (before, [])


def test_changes_are_told_as_texts():
    knowledge = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, knowledge)
    told = []
    knowledge.listen(lambda batch: told.append(shared.changes(batch)))
    updated(
        shared,
        ["(dark)", "(= (battery r1) 3)", "(= (location a1) kitchen)", "(= (location r1) dock)"],
        ["(at r1 kitchen)"],
        ["(charged r1)"],
    )
    updated(shared, remove=["(= (location a1) kitchen)"], forget=["(location r1)", "(battery r1)"])
    updated(shared, ["(= (location r1) dock)", "(= (location a1) dock)"])
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


@in_virtual_time
async def test_the_object_that_a_function_no_longer_has_is_told_whatever_happened_before_anybody_followed():
    knowledge, told = initial_knowledge(PROBLEM), []
    node = served(knowledge)
    knowledge.update({("location", "a1"): "kitchen"})  # as sensors do while action servers are looked for
    stop = node.follow(lambda fields: told.append((fields["added"], fields["removed"], fields["unknown"])))
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


# --- goals ---


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


@in_virtual_time
async def test_the_problem_as_the_world_is_now_goes_to_another_process_with_what_is_unknown():
    knowledge = initial_knowledge(PROBLEM)
    node = served(knowledge, goals={"dark": "(dark)"})
    knowledge.update({("charged", "r1"): UNKNOWN, ("dark",): True})
    problem, bindings = unpacked(await node.pack("dark"))
    assert bindings == NO_BINDINGS
    assert str(problem.goal) == "(dark)"
    assert problem.init[("dark",)] is True
    assert ("charged", "r1") in problem.unknown
    with pytest.raises(InputError, match="did you mean 'dark'"):
        await node.pack("drak")
