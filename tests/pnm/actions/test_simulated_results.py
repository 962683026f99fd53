"""What simulated servers return: the key `simulated` of an action."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.result import PlanResult
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.errors import InputError


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
