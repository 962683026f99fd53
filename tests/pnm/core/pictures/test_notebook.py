"""What notebooks show of plans and machines: their pictures, unless these are too large for a browser."""

from __future__ import annotations

from pnm.core.machine.generate import generate
from pnm.core.pictures.net_picture import net_svg
from pnm.core.pictures.plan_picture import plan_svg
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
