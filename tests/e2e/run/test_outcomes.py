"""Actions that turn out in several ways, over ROS 2: results or sensors tell which it was, also to a process that goes on with it."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from tests.support.e2e.command_line import pnm
from tests.support.runs.files import CUPS, DROPS, TOLD

ASSUMED = "assumed: [held, floor, table]\n"
WENT = ["pick: 2", "lift: succeeded", "pick: 3", "pick: 1"]


@pytest.mark.parametrize("bindings", [f"{TOLD}{ASSUMED}", "actions: {}\n"], ids=["by its code", "by sensors alone"])
def test_what_follows_goes_by_the_outcome_that_was_told_or_reported(deploy, bindings):
    finished = deploy("cups", texts=CUPS, faults=DROPS, bindings=bindings).execute()
    result = finished.result
    assert (finished.status, result["goal_reached"], result["replans"], result["failures"]) == (0, True, 0, []), result
    assert [f"{call['action']}: {call['outcome']}" for call in result["calls"]] == WENT
    assert [call["attempts"] for call in result["calls"]] == [1, 1, 1, 1]


def test_a_run_that_is_killed_goes_on_from_what_came_about(deploy):
    deployment = deploy("cups", texts=CUPS, faults=DROPS, bindings=f"{TOLD}{ASSUMED}", speed="2")
    finished = deployment.execute_killed("lift")
    assert (finished.status, finished.result["plans"], finished.result["replans"]) == (0, 1, 0), finished.result
    assert [f"{call['action']}: {call['outcome']}" for call in finished.result["calls"]] == WENT
    starts = Counter(event["action"] for event in finished.events if event["event"] == "start")
    assert starts == {"pick(mug)": 3, "lift(mug)": 1}
    (task,) = [json.loads(line) for line in pnm("history", deployment.journal, "--json").stdout.splitlines()]
    assert task["code"] == "goal_reached"
    told = pnm("why", "--journal", deployment.journal, "--replan").output
    assert "pick(mug): 2" in told, told
    again = pnm("resume", deployment.journal)
    assert (again.returncode, "goal_reached" in again.stdout) == (0, True)
