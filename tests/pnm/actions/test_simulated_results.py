"""What simulated servers return: as the key `simulated` of an action says, or as its binding judges results and reads goals backwards."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.result import TASKS, PlanResult
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.actions.simulated_robots import arguments_of, result_of
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Table, goal_data
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import Comparison, FieldValue, parse_field
from pnm.errors import InputError
from pnm.journal.resume import replayed
from tests.support.files import written


def carry_out_text(folder: Path, text: str, faults: Faults = Faults()) -> PlanResult:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return carry_out(path, faults=faults)


def returns(folder: Path, simulated: str, step: str = "- look: {x: 3}", rest: str = "") -> PlanResult:
    return carry_out_text(folder, f"actions:\n  look:\n    params: [x]\n    simulated: {simulated}\n{rest}plan:\n  {step}\n")


@pytest.mark.parametrize(
    ("simulated", "stored"),
    [
        ('{y: "?x"}', 3),
        ("{y: 7}", 7),
        ('{y: {Operation: ["+", ["?x", 1]]}}', 4),
        ('{y: {seen: ["?x", cup]}}', {"seen": [3, "cup"]}),
        ("{y: (battery r1)}", 80.0),
        ("{y: (at r1 hall)}", True),
    ],
)
def test_results_are_computed_from_the_goal_and_the_world(tmp_path: Path, simulated: str, stored: object) -> None:
    result = returns(tmp_path, simulated, rest='facts: ["(= (battery r1) 80)", (at r1 hall)]\n')
    assert result.goal_reached
    assert result.variables == {"y": stored}


def test_facts_are_those_of_the_goal_s_objects_after_the_effects(tmp_path: Path) -> None:
    result = carry_out_text(
        tmp_path,
        """
predicates: ["(at ?r ?p)"]
actions:
  go:
    params: [r, p]
    effects: ["(at ?r ?p)"]
    simulated: {arrived: "(at ?r ?p)", elsewhere: "(at ?r hall)"}
plan:
  - go: {r: r1, p: kitchen}
""",
    )
    assert result.variables == {"arrived": True, "elsewhere": False}


def test_what_has_no_value_is_not_returned(tmp_path: Path) -> None:
    assert returns(tmp_path, "{y: (battery r1), z: 1}").variables == {"z": 1}


def test_results_go_where_the_step_says(tmp_path: Path) -> None:
    assert returns(tmp_path, '{y: "?x"}', "- look: {x: 3}\n    store: {y: seen}").variables == {"seen": 3}


def test_what_cannot_be_computed_fails_by_name(tmp_path: Path) -> None:
    result = returns(tmp_path, '{y: {Operation: ["+", ["?x", 1]]}}', "- look: {x: three}")
    assert not result.goal_reached
    assert result.variables == {}
    assert "the result of look(three) cannot be computed: add('three', 1)" in result.reason


def test_an_action_without_effect_returns_nothing(tmp_path: Path) -> None:
    faults = Faults((Fault("look", FaultKind.NO_EFFECT),))
    text = "actions: {look: {params: [x], simulated: {y: 1}}}\nplan: [{look: {x: 3}}]"
    assert carry_out_text(tmp_path, text, faults).variables == {}


@pytest.mark.parametrize(
    ("simulated", "message"),
    [
        (
            "{y: {LocalQuery: x}}",
            r"plan.yaml:4:20: a simulated server knows its goal, not the variables of the run; expected something like",
        ),
        ('{y: "?xx"}', r"there is no parameter '\?xx' here; did you mean '\?x'\?"),
        ("3", "expected a mapping"),
    ],
)
def test_what_is_malformed_is_refused(tmp_path: Path, simulated: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        returns(tmp_path, simulated)


def test_the_world_leaves_to_the_run_what_only_variables_tell(tmp_path: Path) -> None:
    text = """
actions:
  look:
    preconditions: {and: [{Exists: [Query: x]}, {not: {Comparison: [eq, [Query: x, 4]]}}, {or: [(dark), {imply: [(dark), {Query: x}]}]}]}
initial_knowledge: {x: 3}
plan: [{look: {}}]
"""
    assert carry_out_text(tmp_path, text).goal_reached
    denied = carry_out_text(tmp_path, text.replace("x: 3", "x: 4"))
    assert not denied.goal_reached
    assert "precondition_false" in denied.reason


# --- bindings read backwards: the arguments of a goal message, and a result that the binding judges as it should ---


POSES = Table("?to", {"hall": {"x": 1.0, "theta": 0.0}, "lab": {"x": 2.5, "theta": 0.5}})
GOAL = {"pose": POSES, "task": {"type": "navigate", "robot": "?robot"}, "speed": "(speed ?robot)", "tags": ["fast", "?to"], "tries": 3}
MESSAGE = {
    "pose": {"x": 2.5000001, "theta": 0.5, "frame": ""},
    "task": {"type": "navigate", "robot": "r1", "object": ""},
    "speed": 0.7,
    "tags": ["fast", "lab"],
    "tries": 3,
}


def changed(**fields: object) -> dict[str, object]:
    return {**MESSAGE, **fields}


@pytest.mark.parametrize(
    "message",
    [
        changed(task={"type": "pick", "robot": "r1"}),
        changed(pose={"x": 9.0, "theta": 0.0}),
        changed(tags=["fast", "hall"]),
        changed(tags=["fast"]),
        changed(tags="fast"),
        changed(task=3),
        changed(tries=4),
        {name: value for name, value in MESSAGE.items() if name != "task"},
    ],
)
def test_a_goal_of_another_action_is_not_taken_for_this_one(message) -> None:
    assert arguments_of(GOAL, message) is None


def test_arguments_are_found_in_nested_fields_lists_and_tables() -> None:
    assert arguments_of(GOAL, MESSAGE) == {"robot": "r1", "to": "lab"}


@given(robot=st.sampled_from(["r1", "r2"]), to=st.sampled_from(["hall", "lab"]))
def test_what_a_binding_has_filled_is_read_back(robot: str, to: str) -> None:
    action = GroundAction("move", (robot, to), ("robot", "to"))
    knowledge = Layered(KnowledgeBase({("speed", robot): 0.7}))

    class Known:
        """What goals are filled from."""

        value = staticmethod(knowledge.value)
        given = staticmethod(dict)
        variable = find = staticmethod(lambda name: None)

    filled, missing = goal_data(action, Binding(goal=GOAL), tuple(GOAL), Known())  # type: ignore[arg-type]
    assert not missing
    assert arguments_of(GOAL, filled) == {"robot": robot, "to": to}


@pytest.mark.parametrize(
    "success",
    [
        "success: {field: done}",
        "success: {field: status.is_good}",
        "success: {field: status.code, eq: 7}",
        "success: {all: [{field: done}, {field: status.code, eq: 7}]}",
        "success: {any: [{field: status.code, eq: 7}, {field: done}]}",
    ],
)
def test_a_result_of_a_success_is_judged_as_one(tmp_path, success) -> None:
    binding = read_bindings(written(tmp_path / "bindings.yaml", f"actions: {{move: {{{success}}}}}")).of("move")
    outcome = Outcome(OutcomeKind.SUCCEEDED)
    judged = binding.judged(Outcome(OutcomeKind.SUCCEEDED, result_of(binding, outcome)))
    assert judged.kind is OutcomeKind.SUCCEEDED


@pytest.mark.parametrize(("message", "code"), [("it has slipped", 2), ("the action failed", 1), ("", 1)])
def test_a_number_that_stands_for_a_reason_is_one_of_the_table(message: str, code: int) -> None:
    binding = Binding(reason=FieldValue(parse_field("code"), {"1": "out of reach", "2": "it has slipped"}))
    result = result_of(binding, Outcome(OutcomeKind.ABORTED, message=message))
    assert result == {"code": code}
    assert result_of(binding, Outcome(OutcomeKind.CANCELED, message=message)) == {}
    assert binding.judged(Outcome(OutcomeKind.ABORTED, result)).message == ("it has slipped" if code == 2 else "out of reach")


def test_a_failure_has_its_reason_where_the_binding_looks_for_it() -> None:
    binding = Binding(reason=FieldValue(parse_field("status.text")))
    assert result_of(binding, Outcome(OutcomeKind.ABORTED, message="no path")) == {"status": {"text": "no path"}}


# --- outcomes as bindings judge them: a server that reports success may say in its result that it has failed ---


STATUS = parse_field("execution_result.status")
SUCCESS = Comparison(STATUS, "eq", 0)
WORDS = Binding(success=SUCCESS, reason=FieldValue(STATUS, {"1": "the path is blocked", "2": "the battery is empty"}))
BARE = Binding(success=SUCCESS)
FINAL = Binding(success=SUCCESS, final=Comparison(STATUS, "eq", 1))
SUCCEEDED, ABORTED, FOR_GOOD, CANCELED, LOST = (
    *(OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED, OutcomeKind.ABORTED_FOR_GOOD),
    *(OutcomeKind.CANCELED, OutcomeKind.LOST),
)
NOT_TOLD = "its result does not tell whether it succeeded: there is no execution_result.status"


@pytest.mark.parametrize(
    ("binding", "kind", "status", "said", "judged", "message"),
    [
        (WORDS, SUCCEEDED, 0, "", SUCCEEDED, ""),
        (WORDS, SUCCEEDED, 1, "", ABORTED, "the path is blocked"),
        (WORDS, ABORTED, 2, "", ABORTED, "the battery is empty"),
        (WORDS, ABORTED, 0, "", ABORTED, "execution_result.status is 0, which is not in the table (1, 2)"),
        (WORDS, ABORTED, 7, "the door is shut", ABORTED, "the door is shut"),
        (WORDS, CANCELED, 2, "", CANCELED, "the battery is empty"),
        (WORDS, LOST, None, "", LOST, ""),
        (BARE, SUCCEEDED, None, "", ABORTED, NOT_TOLD),
        (BARE, SUCCEEDED, 3, "", ABORTED, "its result has execution_result.status = 3"),
        (BARE, ABORTED, 3, "", ABORTED, "its result has execution_result.status = 3"),
        (FINAL, SUCCEEDED, 0, "", SUCCEEDED, ""),
        (FINAL, SUCCEEDED, 1, "", FOR_GOOD, "its result has execution_result.status = 1"),
        (FINAL, SUCCEEDED, 2, "", ABORTED, "its result has execution_result.status = 2"),
        (FINAL, ABORTED, 1, "", FOR_GOOD, "its result has execution_result.status = 1"),
        (FINAL, ABORTED, None, "", ABORTED, ""),
        (FINAL, CANCELED, 1, "", CANCELED, ""),
        (Binding(), ABORTED, 3, "no", ABORTED, "no"),
    ],
)
def test_the_result_decides(binding: Binding, kind: OutcomeKind, status: object, said: str, judged: OutcomeKind, message: str) -> None:
    outcome = binding.judged(Outcome(kind, {} if status is None else {"execution_result": {"status": status}}, said))
    assert (outcome.kind, outcome.message) == (judged, message)


MEASURE = """
types: tank
functions: ["(temperature ?t - tank)"]
problem: {objects: t1 t2 - tank}
actions:
  measure:
    params: "?t - tank"
    simulated: {degrees: SHOWN}
    store: {degrees: "(temperature ?t)"}
goal: {Comparison: [">", ["(temperature t1)", 20]]}
plan:
  - measure: {t: t1}
"""


@pytest.mark.parametrize(("shown", "is_reached"), [("21.5", True), ("21", True), ("19", False), ("true", False), ("hot", False)])
def test_a_result_sets_a_fluent(tmp_path: Path, shown: str, is_reached: bool) -> None:
    result = carry_out_text(tmp_path, MEASURE.replace("SHOWN", shown))
    assert result.goal_reached is is_reached
    assert result.variables == {}


def test_a_replay_sets_the_same_fluent(tmp_path: Path) -> None:
    journal = tmp_path / "run.journal"
    assert carry_out(written(tmp_path, MEASURE.replace("SHOWN", "21.5")), journal=journal).goal_reached
    assert replayed(journal, TASKS).world.value(("temperature", "t1")) == 21.5


def test_a_step_says_which_fluent_its_result_sets(tmp_path: Path) -> None:
    other = MEASURE.replace("SHOWN", "21").replace("- measure: {t: t1}", "- {measure: {t: t2}, store: {degrees: (temperature t1)}}")
    assert carry_out_text(tmp_path, other).goal_reached


def test_simulated_robots_measure_what_is_true(tmp_path: Path) -> None:
    text = MEASURE.replace("    simulated: {degrees: SHOWN}\n", "").replace("goal:", 'facts: ["(= (temperature t1) 25)"]\ngoal:')
    hidden = Faults(changes=(HiddenChange({("temperature", "t1"): 15.0}, 0.5),))
    assert carry_out_text(tmp_path, text).goal_reached
    assert not carry_out_text(tmp_path, text, hidden).goal_reached
