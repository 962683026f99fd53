"""What notebooks show of plans and machines: their pictures, unless these are too large for a browser."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from pnm.core.machine.generate import generate
from pnm.core.pictures.net_picture import net_svg
from pnm.core.pictures.plan_picture import plan_svg
from pnm.core.pictures.timeline import timeline_svg
from tests.support.runs.plan_graphs import plan, two_robots


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
