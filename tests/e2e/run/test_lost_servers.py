"""Robots that vanish, or restart."""

from __future__ import annotations

ONCE = """
actions:
  move: {server: "/{robot}/move", timeout: 60, accept: 60, retries: 0}
"""
HANGING = "faults: [{action: move, do: hang}]"


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


def test_robots_that_vanish_are_lost(deploy):
    deployment = deploy("delivery/p01", faults=HANGING, bindings=ONCE)
    simulation = deployment.simulate().ready()
    run = deployment.run()
    simulation.happens("start", "move", 2)
    simulation.stop()
    status, result = run.result()
    assert (status, result["goal_reached"]) == (1, False)
    assert "lost" in {failure["cause"] for failure in result["failures"]} <= {"lost", "unavailable", "precondition_false"}
    lost = next(failure for failure in result["failures"] if failure["cause"] == "lost")
    assert lost["observed"] in ("/r1/move went away", "/r2/move went away")
