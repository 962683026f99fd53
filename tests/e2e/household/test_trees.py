"""Solutions of others, beside which ours is measured: the interpreter of the workshop's behaviour trees, on trees of our own."""

from __future__ import annotations

from pathlib import Path

import pytest
from pyrobosim.core import World

from tests.support.e2e.household.simulator import Work, counted, load_world, without_waiting
from tests.support.e2e.household.workshop_tree import WorkshopTree

GUARDED = """
<Fallback>
  <ReactiveSequence>
    <IsBatteryFull full_threshold="99.5"/>
    <RetryUntilSuccessful num_attempts="10"><Navigate target="pantry"/></RetryUntilSuccessful>
  </ReactiveSequence>
  <RetryUntilSuccessful num_attempts="20"><Navigate target="{elsewhere}"/></RetryUntilSuccessful>
</Fallback>"""


def run(tmp_path: Path, node: str, problem: int) -> tuple[bool, World, Work]:
    file = tmp_path / "tree.xml"
    main = """<SubTree ID="Way" elsewhere="table"/>"""
    trees = f"""<BehaviorTree ID="MainTree">{main}</BehaviorTree><BehaviorTree ID="Way">{node}</BehaviorTree>"""
    file.write_text(f"""<root BTCPP_format="4">{trees}</root>""")
    world = load_world(problem, seed=1)
    work = counted(world)
    with without_waiting():
        return WorkshopTree(world, file).run(), world, work


def test_a_drive_is_halted_when_what_it_needs_is_no_longer_so(tmp_path: Path) -> None:
    succeeds, world, work = run(tmp_path, GUARDED, 4)
    assert succeeds
    assert world.robots[0].location.parent.name == "table"
    assert work.battery < 99.5


def test_what_fails_is_tried_so_often_and_then_the_next_child(tmp_path: Path) -> None:
    shut = """<RetryUntilSuccessful num_attempts="3"><Navigate target="dumpster"/></RetryUntilSuccessful>"""
    succeeds, world, work = run(tmp_path, f"""<Fallback>{shut}<Sequence>{shut}</Sequence><Navigate target="pantry"/></Fallback>""", 2)
    assert succeeds
    assert world.robots[0].location.parent.name == "pantry"
    assert work.actions == 3 + 3 + 1


def test_a_place_that_is_stored_is_gone_back_to(tmp_path: Path) -> None:
    nodes = ("""<Navigate target="pantry"/>""", """<GetCurrentLocation location="{start}"/>""", """<Navigate target="table"/>""")
    succeeds, world, work = run(tmp_path, f"""<Sequence>{"".join(nodes)}<Navigate target="{{start}}"/></Sequence>""", 1)
    assert succeeds
    assert world.robots[0].location.parent.name == "pantry"
    assert (work.actions, work.driving > 5) == (3, True)


def test_a_node_that_is_not_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a node Parallel, which"):
        run(tmp_path, "<Parallel/>", 1)
