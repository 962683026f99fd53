"""Pictures of whole machines: every place and every transition once, nothing over anything else, and in the order of time.

`--write` with python -m tests.pnm.core.pictures.test_net_picture renews the golden picture.
"""

from __future__ import annotations

import sys
from collections import Counter
from functools import cache
from itertools import combinations, groupby, pairwise
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.pictures.net_picture import Crossing, block_layouts, net_svg
from tests.support.runs.control_flow import LARGE, SHAPES
from tests.support.runs.plan_graphs import nested_plan, plan, two_robots

GOLDEN = Path(__file__).parent / "golden" / "net.svg"
SVG = "{http://www.w3.org/2000/svg}"
ARM = Bindings({"move": Binding(resources=("{robot}/base", "lift"))})


@cache
def machines() -> dict[str, PetriNetMachine]:
    return {
        "two robots": generate(two_robots(), ARM),
        "nested": generate(nested_plan()),
        "nothing": generate(PlanGraph(())),
        "side by side": generate(plan(30)),
        "ends that wait": generate(plan(3, "0s<1s", "1e<0e", "2s<0e")),
        **{name: generate(graph) for name, graph in (SHAPES | LARGE).items()},
    }


def groups(svg: str) -> list[ElementTree.Element]:
    return [*ElementTree.fromstring(svg).iter(f"{SVG}g")]


def title(group: ElementTree.Element) -> str:
    return group.findtext(f"{SVG}title") or ""


def boxes(svg: str) -> list[tuple[float, float, float, float]]:
    """The edges of the boxes of blocks: left, upper, right, lower."""
    found = []
    for group in groups(svg):
        rect = group.find(f"{SVG}rect[@class='box']")
        if rect is not None:
            x, y = map(float, group.get("transform", "").removeprefix("translate(").removesuffix(")").split())
            found.append((x, y, x + float(rect.get("width", "")), y + float(rect.get("height", ""))))
    return found


@pytest.mark.parametrize("name", machines())
def test_every_place_and_transition_is_there_once_in_boxes_that_do_not_overlap(name: str) -> None:
    machine = machines()[name]
    svg = net_svg(machine)
    everything = groups(svg)
    assert Counter(title(group) for group in everything if group.find(f"{SVG}circle") is not None) == Counter(machine.net.places)
    drawn = Counter(title(group).partition("\n")[0] for group in everything if group.get("class") == "transition")
    assert drawn == Counter(machine.net.transitions)
    root = ElementTree.fromstring(svg)
    edges = boxes(svg)
    assert len(edges) == len(machine.plan.every_step) + 2
    assert all(
        min(x, y) >= 0 and right <= float(root.get("width", "")) and lower <= float(root.get("height", "")) for x, y, right, lower in edges
    )
    for one, other in combinations(edges, 2):
        assert one[0] >= other[2] or other[0] >= one[2] or one[1] >= other[3] or other[1] >= one[3]


@pytest.mark.parametrize("name", machines())
def test_in_a_block_arcs_lead_to_all_that_a_transition_is_connected_to_and_share_no_row(name: str) -> None:
    machine = machines()[name]
    for layout in block_layouts(machine).values():
        xs = [column.x for column in layout.columns]
        assert xs == sorted(set(xs))
        line = {place: column.x for column in layout.columns for place in column.places}
        for crossing in layout.crossings:
            inputs = machine.net.inputs[crossing.transition].keys() - machine.resource_places
            outputs = machine.net.outputs[crossing.transition].keys() - machine.resource_places
            assert [x for x, _ in crossing.inputs] == sorted(line[place] for place in inputs)
            assert {*crossing.outputs, *crossing.back} == {line[place] for place in outputs}
            assert max((*crossing.back, 0)) < crossing.bar < min((*crossing.outputs, layout.width))
        for _, beside in groupby(sorted(layout.crossings, key=lambda crossing: crossing.row), key=lambda crossing: crossing.row):
            spans = sorted(span(crossing) for crossing in beside)
            assert all(one[1] <= other[0] for one, other in pairwise(spans))


def span(crossing: Crossing) -> tuple[float, float]:
    reached = [x for x, _ in crossing.inputs] + [*crossing.outputs, *crossing.back, crossing.bar]
    return min(reached), max(reached)


def test_resources_are_words_at_the_transitions_that_take_and_give_them() -> None:
    svg = net_svg(machines()["two robots"])
    assert ">start −r1/base −lift<" in svg
    assert ">effects_hold +r1/base +lift<" in svg


def test_a_picture_grows_as_its_plan_does() -> None:
    def elements(calls: int) -> int:
        chain = plan(calls, *(f"{number}e<{number + 1}s" for number in range(calls - 1)))
        return len([*ElementTree.fromstring(net_svg(generate(chain))).iter()])

    ten, twenty, forty = map(elements, (10, 20, 40))
    assert forty - twenty == 2 * (twenty - ten)


def test_a_picture_is_drawn_as_it_ever_was() -> None:
    assert net_svg(generate(plan(2, "0e<1s"))) == GOLDEN.read_text(encoding="utf-8")


if __name__ == "__main__" and "--write" in sys.argv:
    GOLDEN.write_text(net_svg(generate(plan(2, "0e<1s"))), encoding="utf-8")
