"""Pictures of plans, drawn and as Graphviz text: everything is there once, in the order of time, and nothing lies over anything else.

`--write` with python -m tests.pnm.core.pictures.test_plan_picture renews the golden pictures.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import example, given

from pnm.core.logic.conditions import Holds
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph, WaitUntil
from pnm.core.pictures.net_picture import net_svg
from pnm.core.pictures.plan_picture import COLUMNS, laid_out, plan_dot, plan_svg
from pnm.core.pictures.timeline import timeline_svg
from tests.support.runs.plan_graphs import closure, nested_plan, plan, plans, two_robots

GOLDEN = Path(__file__).parent / "golden"
PICTURES: dict[str, Callable[[PlanGraph], str]] = {"plan.svg": plan_svg, "plan.dot": plan_dot}
SVG = "{http://www.w3.org/2000/svg}"


def boxes(svg: str) -> list[tuple[int, int]]:
    """The upper left corners of the boxes of steps."""
    rects = (rect for rect in ElementTree.fromstring(svg).iter(f"{SVG}rect") if rect.get("rx"))
    return [(int(rect.get("x", "")), int(rect.get("y", ""))) for rect in rects]


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_drawn_as_it_ever_was(name: str) -> None:
    assert PICTURES[name](two_robots()) == (GOLDEN / name).read_text(encoding="utf-8")


@given(plans(most=8))
def test_every_step_has_a_place_of_its_own_behind_what_it_waits_for(graph: PlanGraph) -> None:
    layout = laid_out(graph.flow)
    cells = layout.cells
    assert cells.keys() == {call.index for call in graph.calls}
    assert len({(cell.column, cell.row) for cell in cells.values()}) == len(cells)
    for one, other in combinations(cells.values(), 2):
        assert one.row != other.row or one.line == other.line, "a row belongs to one line of columns"
        assert one.line >= other.line or one.row < other.row, "later ones are below"
    for ordering in graph.orderings:
        if ordering.after.moment is Moment.START:
            before, after = cells[ordering.before.call], cells[ordering.after.call]
            assert (before.line, before.column) < (after.line, after.column)


@given(plans(most=8))
def test_the_arrows_say_all_that_the_orderings_do_and_none_follows_from_others(graph: PlanGraph) -> None:
    arrows = laid_out(graph.flow).arrows
    waits = {(arrow.before, arrow.after) for arrow in arrows if not arrow.is_for_the_end}
    asked = {(one.before.call, one.after.call) for one in graph.orderings if one.after.moment is Moment.START}
    assert closure(waits) == closure(asked)
    assert all(closure(waits - {pair}) != closure(waits) for pair in waits)
    at_end = {(one.before.call, one.after.call) for one in graph.orderings if one.after.moment is Moment.END}
    assert {(arrow.before, arrow.after) for arrow in arrows if arrow.is_for_the_end} == {pair for pair in at_end if pair[0] != pair[1]}


@given(plans(most=12))
def test_boxes_lie_side_by_side_inside_the_picture(graph: PlanGraph) -> None:
    svg = plan_svg(graph)
    root, corners = ElementTree.fromstring(svg), boxes(svg)
    assert len(corners) == len(graph.calls)
    assert all(abs(x1 - x2) > 196 or abs(y1 - y2) > 46 for (x1, y1), (x2, y2) in combinations(corners, 2))
    assert all(0 <= x <= int(root.get("width", "")) - 196 and 0 <= y <= int(root.get("height", "")) - 46 for x, y in corners)


def points(path: str) -> list[tuple[float, float]]:
    """Points of a path of moves, curves and horizontal lines."""
    found: list[tuple[float, float]] = []
    for command, text in re.findall(r"([MCH])([^MCH]+)", path):
        numbers = [float(number) for number in text.split()]
        if command == "M":
            found.append((numbers[0], numbers[1]))
        elif command == "H":
            found += [(found[-1][0] + (numbers[0] - found[-1][0]) * step / 50, found[-1][1]) for step in range(51)]
        else:
            corners = [found[-1], *zip(numbers[::2], numbers[1::2], strict=True)]
            for t in (step / 50 for step in range(51)):
                shares = ((1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t**2, t**3)
                x, y = (sum(share * corner[axis] for share, corner in zip(shares, corners, strict=True)) for axis in (0, 1))
                found.append((x, y))
    return found


@given(plans(most=12))
@example(plan(6, "0e<2s", "2e<4s", "1e<3s", "3e<5s", "0e<5s"))
@example(plan(9, "0e<2s", "2e<4s", "4e<6s", "1e<3s", "3e<5s", "5e<7s", "1e<6s", "0e<8s", "1e<8s"))
def test_no_arrow_goes_through_a_box(graph: PlanGraph) -> None:
    svg = plan_svg(graph)
    arrows = [path.get("d", "") for path in ElementTree.fromstring(svg).iter(f"{SVG}path") if path.get("marker-end")]
    for x, y in (point for arrow in arrows for point in points(arrow)):
        assert not any(left < x < left + 196 and top < y < top + 46 for left, top in boxes(svg))


def test_what_there_is_no_room_for_is_counted_where_arrows_end() -> None:
    calls = plan(7).calls
    orders = (Ordering(PlanEvent(number, Moment.END), PlanEvent(6, Moment.START), (("done", f"a{number}"),)) for number in range(6))
    svg = plan_svg(PlanGraph(calls, tuple(orders)))
    assert [text.text for text in ElementTree.fromstring(svg).iter(f"{SVG}text") if text.get("class") == "fact"] == [
        "(done a0)",
        "(done a1)",
        "(done a2)",
        "(done a3) +2",
    ]


def test_a_long_plan_goes_on_below_with_numbers_at_both_ends() -> None:
    graph = plan(COLUMNS + 1, *(f"{number}e<{number + 1}s" for number in range(COLUMNS)))
    svg = plan_svg(graph)
    assert f"→ #{COLUMNS}<" in svg
    assert f">#{COLUMNS - 1} →" in svg
    assert len({x for x, _ in boxes(svg)}) == COLUMNS


def test_an_end_that_waits_says_so() -> None:
    assert "ends after #1<" in plan_svg(plan(2, "0s<1s", "1e<0e"))


def test_what_loops_choices_and_recoveries_hold_is_drawn_below_them() -> None:
    svg = plan_svg(nested_plan())
    assert len(boxes(svg)) == 6
    for words in (
        "#4 is repeated while (on), 3 times at most",
        "#5 if (on)",
        "#5 otherwise",
        "#2 after aborted; then retry",
        "Hello &amp; &lt;bye&gt;",
    ):
        assert words in svg


# --- as Graphviz text ---


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


# --- in notebooks ---


def test_plans_and_machines_draw_themselves() -> None:
    graph = two_robots()
    assert graph._repr_svg_() == plan_svg(graph)
    machine = generate(graph)
    assert machine._repr_svg_() == net_svg(machine)


def test_a_machine_that_a_browser_takes_long_for_is_shown_as_text() -> None:
    graph = plan(51)
    assert generate(graph)._repr_svg_() is None
    assert graph._repr_svg_() == plan_svg(graph)


@pytest.mark.parametrize("svg", [plan_svg(two_robots()), net_svg(generate(plan(1))), timeline_svg()])
def test_the_looks_of_a_picture_are_for_pictures_of_its_kind_alone(svg: str) -> None:
    root = ElementTree.fromstring(svg)
    style = root.findtext("{http://www.w3.org/2000/svg}style") or ""
    selectors = [selector for rule in style.split("}") if rule for selector in rule.partition("{")[0].split(",")]
    assert selectors
    assert all(selector.startswith(f".{root.get('class')} ") for selector in selectors)


if __name__ == "__main__" and "--write" in sys.argv:
    for name, drawn in PICTURES.items():
        (GOLDEN / name).write_text(drawn(two_robots()), encoding="utf-8")
