"""Servers that are lost are noticed and got over; the world itself says so."""

from __future__ import annotations


def test_what_a_lost_server_did_is_done_by_another_robot(deploy):
    faults = "faults: [{action: move, do: lose_server, times: 1}]"
    finished = deploy("delivery/p01", quick=True, faults=faults).execute()
    lost = next(event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "lost")
    robot = lost[len("move(") :].split(",")[0]
    gone = [failure for failure in finished.result["failures"] if failure["cause"] in ("lost", "unavailable")]
    assert gone
    assert all(f"/{robot}/move" in failure["observed"] for failure in gone)
    assert finished.result["goal_reached"]
    moved = [event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "succeeded"]
    assert not any(action.startswith(f"move({robot},") for action in moved)


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
