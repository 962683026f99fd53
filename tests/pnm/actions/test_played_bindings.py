"""Bindings read backwards: the arguments of a goal message, and the result that a binding judges as it should."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from pnm.actions.bindings_file import read_bindings
from pnm.actions.simulated_robots import arguments_of, result_of
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Table, goal_data
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.message_fields import FieldValue, parse_field
from tests.support.files import written

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
