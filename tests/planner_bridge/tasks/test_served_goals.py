"""What comes in with a goal for a plan, and what goes out: without ROS 2."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from pnm.errors import InputError
from pnm.language.plan import read_plans
from pnm.ros.tasks.task_messages import read_parameters, result_fields

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "expected a mapping such as {shop: bakery} as parameters, found '3'"),
        ("[a]", "expected a mapping such as {shop: bakery} as parameters, found '[a]'"),
        ("shop", "expected a mapping"),
        ("{shop: bakery", "parameters:1:"),
        ("{a: 1}\n---\n{b: 2}\n", "parameters:3:1: a second document begins here"),
        ("{a: 1, a: 2}", "parameters:1:8: "),
        ("? [a]\n: 1", "parameters:1:"),
        ("a: !!python/name:os.system", "parameters:1:4: "),
        ("[" * 100_000, "parameters:1:"),
        ("{a: &a [1], b: &b [*a, *a, *a], c: [*b, *b, *b, *d]}", "parameters:1:"),
    ],
    ids=lambda value: value[:20],
)
def test_what_is_no_mapping_is_no_parameters(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        read_parameters(text)
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["", "  \n", "{}"])
def test_nothing_is_no_parameters(text: str) -> None:
    assert read_parameters(text) == {}


def test_yaml_will_do() -> None:
    assert read_parameters("shop: bakery\nfloors: [1, 2.5]\nopen: true\n") == {"shop": "bakery", "floors": [1, 2.5], "open": True}


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_parameters_written_as_json_come_in_as_they_were(parameters: dict[str, object]) -> None:
    assert read_parameters(json.dumps(parameters)) == parameters


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_results_are_json(results: dict[str, object]) -> None:
    fields = result_fields(True, "goal", "done", results)
    assert json.loads(str(fields["results"])) == results
    assert fields["message"] == "done"


def test_a_result_that_json_cannot_say_is_told_of() -> None:
    fields = result_fields(True, "goal", "done\x1b", {"a": float("nan"), "b": 1})
    assert fields["results"] == '{"b": 1}'
    assert str(fields["message"]).startswith("done\N{REPLACEMENT CHARACTER}; a is left out: JSON cannot say nan")


def test_a_world_begins_as_all_of_its_plans_say(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(open door1), (= (n) 2)], plan: []}\n")
    assert initial_knowledge(*read_plans(file).values()).facts() == {("open", "door1"): True, ("n",): 2.0}
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(not (open door1))], plan: []}\n")
    with pytest.raises(InputError, match=r"one and two begin with different values of \(open door1\): True, False"):
        initial_knowledge(*read_plans(file).values())
