"""A change of a fact costs a task what reads it, however many calls are under way: counted in calls of Python functions."""

from __future__ import annotations

import pytest

from planner_bridge.tasks.settings import OnChange
from pnm.core.logic.expressions import Fluent
from tests.support.benchmarks.waiting import CHARGE, OTHER, UnderWay, fleet
from tests.support.runs.timing import functions_called


async def called_by(robots: UnderWay, fluent: Fluent) -> int:
    """Return how many functions a change of the fact calls; what is worked out once was before."""
    await robots.change(fluent, 8.0)
    with functions_called() as called:
        await robots.change(fluent, 7.0)
    return called()


@pytest.mark.parametrize(("on_change", "fluent"), [(OnChange.LAZY, OTHER), (OnChange.LAZY, CHARGE), (OnChange.EAGER, OTHER)])
def test_a_change_of_a_fact_concerns_only_the_calls_that_read_it(on_change: OnChange, fluent: Fluent) -> None:
    few, many = (UnderWay(fleet(count)).under_way(on_change, lambda robots: called_by(robots, fluent)) for count in (4, 40))
    assert 0 < many < 2 * few
