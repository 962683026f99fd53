"""Objects that nobody knew, found by an action server over ROS 2: a new plan is about them, also in a process that goes on with it."""

from __future__ import annotations

import json
from collections import Counter

from tests.support.e2e.command_line import pnm
from tests.support.processes import Program
from tests.support.runs.files import FINDS, TIDY

CUPS = ("cup_7", "glass_2", "mug")


def test_a_run_that_is_killed_goes_on_with_what_it_has_found(deploy):
    deployment = deploy("tidy", texts=TIDY, bindings=FINDS, speed="2")
    finished = deployment.execute_killed("wash")
    assert (finished.status, finished.result["failures"]) == (0, []), finished.result
    assert finished.truth.objects(("cup",)) == CUPS
    starts = Counter(event["action"] for event in finished.events if event["event"] == "start")
    assert starts == Counter(["search(kitchen)", "search(hall)", *(f"wash({cup})" for cup in CUPS)]) + Counter(
        action for action in starts if action.startswith("pick")
    ), starts
    told = [json.loads(line) for line in pnm("replay", deployment.journal, "--json").stdout.splitlines()]
    assert "(exists mug cup)" in json.dumps(told)
    assert "(exists" in pnm("why", "--journal", deployment.journal, "--replan").output


def test_results_of_servers_of_somebody_else_are_enough(deploy):
    bindings = FINDS + "".join(f"  {name}: {{server: measure, goal: {{}}, retries: 0}}\n" for name in ("pick", "wash"))
    deployment = deploy("tidy", texts=TIDY, bindings=bindings, quick=True)
    servers = deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    servers.until(lambda: servers.out)
    status, result = deployment.run().result()
    assert (status, result["goal_reached"], result["failures"]) == (0, True, []), result
    washed = {call["arguments"][0] for call in result["calls"] if call["action"] == "wash"}
    assert washed == {"kitchen_cup", "hall_cup"}
