"""Whatever people do to many tasks while things go wrong, all of them end, once, and with the truth."""

from __future__ import annotations

import pytest

from tests.support.tasks.random_scenarios import run_scenario

BROKEN = {
    75: "paused right after it was cancelled",
    76: "over while it was told to make way",
    175: "what is under way does not fit into the plan that was found",
    243: "what made way for another was let go before that one was over",
    272: "what a pause lets come to its end was not seen by others",
    630: "something was being cancelled when the next machine was ready",
    10875: "paused right after it was resumed",
}
"""Scripts that went wrong once."""


@pytest.mark.parametrize("number", [*BROKEN, *range(60)])
def test_a_random_script_is_played_to_its_end(number: int):
    run_scenario(number)
