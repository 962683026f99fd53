"""What `pnm simulate` offers: servers of the types that bindings name, whose results say what bindings look for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.node.simulate import ServerModel, fitted, server_models
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.actions.bindings_file import read_bindings
from pnm.actions.simulated_robots import SimulatedWorld
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.errors import InputError
from tests.support.files import written

DOMAIN = "(define (domain d) (:predicates (held)) (:action pick :effect (held)) (:action place :effect (not (held))))"
PROBLEM = "(define (problem p) (:domain d) (:goal (held)))"
GRIP = "porter_msgs/action/Grip"


def models(folder: Path, bindings: str) -> list[ServerModel]:
    problem = parse_problem(PROBLEM, parse_domain(DOMAIN))
    world = cast("SimulatedWorld", SimpleNamespace(holds=lambda _: True, truth=initial_knowledge(problem)))
    return server_models(problem, read_bindings(written(folder / "bindings.yaml", bindings)), world)


def test_named_constants_of_the_result_are_played_by_their_values(tmp_path: Path) -> None:
    bindings = f"actions: {{pick: {{server: /gripper, type: {GRIP}, success: {{field: code, ne: SLIPPED}}, goal: {{close: true}}}},\n"
    bindings += "  place: {server: /gripper, success: {field: code, eq: NOT_HELD}, goal: {close: false}}}"
    (model,) = map(fitted, models(tmp_path, bindings))
    answers = [model.answer(GroundAction(name), Outcome(OutcomeKind.SUCCEEDED)) for name in ("pick", "place")]
    assert answers == [{}, {"code": 3}]


@pytest.mark.parametrize("first", ["pick", "place"])
def test_actions_of_one_server_share_the_type_that_one_of_them_names(tmp_path: Path, first: str) -> None:
    types = {name: f", type: {GRIP}" if name == first else "" for name in ("pick", "place")}
    bindings = ", ".join(f"{name}: {{server: /gripper{type_}}}" for name, type_ in types.items())
    (model,) = models(tmp_path, f"actions: {{{bindings}}}")
    assert model.type == GRIP


def test_bindings_that_do_not_fit_are_refused_with_their_place(tmp_path: Path) -> None:
    (model, _) = models(tmp_path, f"actions: {{pick: {{type: {GRIP}, success: {{field: code, eq: DNOE}}}}}}")
    with pytest.raises(InputError) as caught:
        fitted(model)
    assert str(caught.value).endswith("1:17: pick: code is a uint8, which cannot be compared with 'DNOE'; did you mean 'DONE'?")


def test_a_binding_without_a_type_is_told_what_it_is_played_as(tmp_path: Path) -> None:
    (model, _) = models(tmp_path, "actions: {pick: {goal: {close: true}}}")
    with pytest.raises(InputError) as caught:
        fitted(model)
    assert "without a 'type' in its binding, pick is played as a pnm_interfaces/action/GroundAction" in str(caught.value)
