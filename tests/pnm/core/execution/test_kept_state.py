"""Values of a run between two events: a run that is made from them goes on as it does, and nothing that changes is forgotten."""

from __future__ import annotations

from random import Random
from typing import Final

import pytest

from tests.support.runs.held_run import KeptRun, drive, hold_against_values

FOLLOWS: Final = {
    "Agenda": {"_index", "_local", "_readers", "_reads", "_rules", "_world", "begins_to_listen", "places"},
    "Questions": set[str](),
    "Calls": {"_closed", "_contexts", "_goal_fields", "_knowledge", "_plan", "asks", "bindings", "identity", "world"},
    "CallResults": {"_calls", "_plan"},
    "RunState": {"engine", "index", "marked_at", "results"},
    "RunClaims": {"_priority", "_task", "resources"},
    "Guards": {"_calls", "_claims", "_questions", "state"},
    "Resources": {"_capacities", "_holders", "_lines", "_listeners"},
}
"""The attributes of the parts of a run that follow from others, or that it is made with."""


@pytest.mark.parametrize("number", range(60))
def test_a_run_that_is_made_from_its_values_goes_on_as_it_does(number: int) -> None:
    hold_against_values(number)


def test_every_attribute_is_kept_or_follows_from_others() -> None:
    run = drive(Random(1), KeptRun)
    for part in (run.resources, *run._parts.values()):
        name, attributes = type(part).__name__, vars(part).keys() - {"__orig_class__"}
        assert attributes == FOLLOWS[name] | set(part.KEPT), name
