"""Robots that vanish, restart or were never there."""

from __future__ import annotations

import pytest

ONCE = """
actions:
  move: {server: "/{robot}/move", timeout: 60, accept: 60, retries: 0}
"""
HANGING = "faults: [{action: move, do: hang}]"


@pytest.fixture(scope="module", autouse=True)
def waiting(deploy_for_module):
    """Begin the runs that mostly wait, so that they do so while others go on.

    One has no robots. Of two more the robots vanish, killed or in order, after both have begun to drive; the
    first began well before the second, so its goal is surely accepted.
    """
    runs = {"alone": deploy_for_module("patrol/p01").run()}
    for end in ("kill", "stop"):
        deployment = deploy_for_module("delivery/p01", faults=HANGING, bindings=ONCE)
        simulation = deployment.simulate().ready()
        run = deployment.run()
        simulation.happens("start", "move", 2)
        getattr(simulation, end)()
        runs[end] = run
    return runs


def test_robots_killed_and_restarted_are_noticed_and_the_goal_is_reached_from_what_is_then_sensed(deploy):
    deployment = deploy("patrol/p01", speed="5")
    killed = deployment.simulate().ready()
    run = deployment.run()
    killed.happens("start", "move", 2)
    killed.kill()
    finished = deployment.finish(run, deployment.simulate())
    assert finished.result["goal_reached"]
    assert finished.result["replans"] >= 1
    first = next(event["action"] for event in killed.objects() if event["event"] == "start")
    assert first in [event["action"] for event in finished.events if event["event"] == "start"], "the new world starts from the beginning"


def test_without_robots_every_call_tried_fails_by_the_name_of_its_server(waiting):
    status, result = waiting["alone"].result()
    assert (status, result["goal_reached"]) == (1, False)
    tried = [call["outcome"] for call in result["calls"] if call["attempts"]]
    assert tried
    assert set(tried) == {failure["cause"] for failure in result["failures"]} == {"unavailable"}
    assert all(failure["observed"].startswith("there is no action server /r1/move") for failure in result["failures"])


@pytest.mark.parametrize("end", ["stop", "kill"])  # the lease of what was killed lasts 20 s; a move may take a minute
def test_robots_that_vanish_are_lost(waiting, end):
    status, result = waiting[end].result()
    assert (status, result["goal_reached"]) == (1, False)
    assert "lost" in {failure["cause"] for failure in result["failures"]} <= {"lost", "unavailable", "precondition_false"}
    lost = next(failure for failure in result["failures"] if failure["cause"] == "lost")
    assert lost["observed"] in ("/r1/move went away", "/r2/move went away")
