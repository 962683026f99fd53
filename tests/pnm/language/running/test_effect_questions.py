"""Effects that only somebody outside of the run knows: they are asked for after the call, and missing if the answer is not so."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.carry_out import carry_out
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import All, Computed, Condition
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from tests.support.runs.direct import Trace, drive

OUTSIDE = [Layer.ALL, Layer.GLOBAL, Layer.PERSON]


def rung(layer: Layer, name: str = "bell") -> Condition:
    return Computed(Operation("eq", (Query(Literal.of(name), layer), Literal.of("rung"))))


def ring(expected: Condition, known: dict[str, object]) -> Trace:
    bindings = Bindings({"ring": Binding(retries=1)})
    return drive(PlanGraph((ActionCall(0, GroundAction("ring", expected=expected)),)), known=known, bindings=bindings)


@pytest.mark.parametrize("layer", OUTSIDE)
@pytest.mark.parametrize("answer", ["silent", None])
def test_an_effect_that_is_not_so_outside_is_missing(layer: Layer, answer: object) -> None:
    trace = ring(rung(layer), {"bell": answer})
    assert not trace.result.goal
    assert trace.actions == ["ring", "ring"]
    (failure,) = trace.result.failures
    assert failure.cause == "effects_missing"
    assert failure.expected == str(rung(layer))


@pytest.mark.parametrize("layer", OUTSIDE)
def test_an_effect_that_is_so_outside_is_asked_for_after_the_call(layer: Layer) -> None:
    early = ActionCall(0, GroundAction("look"))
    assert ring(rung(layer), {"bell": "rung"}).actions == []  # so already
    trace = drive(PlanGraph((early, ActionCall(1, GroundAction("ring", end_condition=rung(layer))))), known={"bell": "rung"})
    assert trace.result.goal
    assert trace.actions == ["look", "ring"]
    assert [question.name for question in trace.asked] == ["bell"]


def test_every_part_of_an_effect_is_asked_for() -> None:
    trace = ring(All((rung(Layer.GLOBAL), rung(Layer.GLOBAL, "door"))), {"bell": "rung", "door": "closed"})
    (failure,) = trace.result.failures
    assert failure.expected == str(rung(Layer.GLOBAL, "door"))


@pytest.mark.parametrize("query", ["RemoteQuery", "Query"])
def test_a_hand_written_plan_does_not_believe_what_nobody_confirms(tmp_path: Path, query: str) -> None:
    effects = f"{{Comparison: [eq, [{query}: bell, rung]]}}"
    (tmp_path / "p.yaml").write_text(f"knowledge: memory\nactions: {{ring: {{effects: {effects}}}}}\nplan: [ring:]\n")
    result = carry_out(tmp_path / "p.yaml")
    assert not result.goal_reached
    assert [call.attempts for call in result.calls] == [4]
    assert "effects_missing" in result.reason


def test_a_goal_that_is_false_outside_is_explained_with_the_answer() -> None:
    trace = drive(PlanGraph((), goal=rung(Layer.GLOBAL)), known={"bell": "silent"})
    assert trace.result.reason.endswith('expected eq(global[bell], "rung"); observed global[bell] is "silent"')
