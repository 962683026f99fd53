"""Values of a run between two events: a run that is made from them goes on as it does."""

from __future__ import annotations

import pytest

from tests.support.runs.held_run import hold_against_values


@pytest.mark.parametrize("number", range(60))
def test_a_run_that_is_made_from_its_values_goes_on_as_it_does(number: int) -> None:
    hold_against_values(number)
