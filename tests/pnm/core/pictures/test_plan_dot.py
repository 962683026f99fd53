"""Pictures of plans as Graphviz text: every step once, in the order of time, and every ordering that does not follow from others.

`--write` with python -m tests.pnm.core.pictures.test_plan_dot renews the golden picture.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from hypothesis import given

from pnm.core.logic.conditions import Holds
from pnm.core.machine.plan_graph import PlanGraph, WaitUntil
from pnm.core.pictures.plan_picture import laid_out, plan_dot
from tests.support.runs.plan_graphs import nested_plan, plan, plans, two_robots

GOLDEN = Path(__file__).parent / "golden" / "plan.dot"


def test_a_picture_is_drawn_as_it_ever_was() -> None:
    assert plan_dot(two_robots()) == GOLDEN.read_text(encoding="utf-8")


@given(plans(most=8))
def test_every_step_and_every_arrow_is_there_once(graph: PlanGraph) -> None:
    text = plan_dot(graph)
    assert sorted(map(int, re.findall(r"^ +(\d+) \[label", text, re.M))) == [call.index for call in graph.calls]
    arrows = [(int(before), int(after)) for before, after in re.findall(r"(\d+) -> (\d+)", text)]
    assert sorted(arrows) == sorted((arrow.before, arrow.after) for arrow in laid_out(graph.flow).arrows)


def test_the_end_that_waits_is_dashed_and_moves_nothing() -> None:
    assert '1 -> 0 [label="ends after", style=dashed, constraint=false];' in plan_dot(plan(2, "0s<1s", "1e<0e"))


def test_what_a_step_holds_stands_in_a_frame() -> None:
    text = plan_dot(nested_plan())
    assert text.count("subgraph cluster_") == 4
    assert re.findall(r"(\d) -> (\d) \[style=dotted\]", text) == [("4", "0"), ("5", "1"), ("5", "2"), ("2", "3")]
    assert "Hello & <bye>" in text


def test_a_wait_says_what_for_and_how_long() -> None:
    text = plan_dot(PlanGraph((WaitUntil(0, Holds(("open", "door")), 5.0),)))
    assert '[label="wait until  #0\\n(open door)", tooltip="wait_until((open door))#0, 5 s at most"]' in text


if __name__ == "__main__" and "--write" in sys.argv:
    GOLDEN.write_text(plan_dot(two_robots()), encoding="utf-8")
