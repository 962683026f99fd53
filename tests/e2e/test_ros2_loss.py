"""Robots that vanish, restart or were never there, and a person who presses Ctrl-C."""

from __future__ import annotations

import signal
from time import monotonic

import pytest

from tests.e2e.processes import LIMIT

ONCE = """
actions:
  move: {server: "/{robot}/move", timeout: 60, retries: 0}
  return_home: {server: "/{robot}/move", retries: 0}
assumed: [effort]
"""
HANGING = "faults: [{action: move, do: hang, after: 1}]"


@pytest.fixture(scope="module", autouse=True)
def waiting(stage_of_module):
    """Begin the two runs that mostly wait, so that they do so while the other tests go on."""
    alone = stage_of_module("delivery/p01").run()
    scene = stage_of_module("patrol/p01", faults=HANGING, bindings=ONCE)
    simulation = scene.simulate().ready()
    run = scene.run()
    simulation.happens("start", "move", 2)
    simulation.kill()
    return alone, run, monotonic()


def test_robots_killed_and_restarted_are_noticed_and_the_goal_is_reached_from_what_is_then_sensed(stage):
    scene = stage("patrol/p01", speed="5")
    killed = scene.simulate().ready()
    run = scene.run()
    killed.happens("start", "move", 2)
    killed.kill()
    story = scene.judge(run, scene.simulate())
    assert story.result["goal_reached"]
    assert story.result["replans"] >= 1
    first = [event["action"] for event in killed.objects() if event["event"] == "start"]
    assert first[0] in [event["action"] for event in story.events if event["event"] == "start"], "the new world starts from the beginning"


def test_robots_that_shut_down_in_order_are_lost_within_seconds(stage):
    scene = stage("patrol/p01", faults=HANGING, bindings=ONCE)
    simulation = scene.simulate().ready()
    run = scene.run()
    simulation.happens("start", "move", 2)
    simulation.stop()
    status, result = run.result()
    assert (status, result["goal_reached"]) == (1, False)
    assert {failure["cause"] for failure in result["failures"]} <= {"lost", "unavailable"}
    assert result["failures"][0]["observed"].startswith("/r1/move went away")


def test_ctrl_c_cancels_what_runs_and_still_tells_how_it_went(stage):
    scene = stage("delivery/p01", speed="0.1")
    simulation = scene.simulate().ready()
    run = scene.run()
    simulation.until(lambda: len([one for one in simulation.objects() if one["event"] == "start"]) == 2)
    run.process.send_signal(signal.SIGINT)
    story = scene.judge(run, simulation)
    assert (story.status, story.result["reason"]) == (1, "cancelled")
    ends = [event["outcome"] for event in story.events if event["event"] == "end"]
    assert ends == ["canceled", "canceled"]
    assert [call["outcome"] for call in story.result["calls"] if call["attempts"]] == ["canceled", "canceled"]
    assert story.result["failures"] == []


def test_without_robots_every_call_tried_fails_by_the_name_of_its_server(waiting):
    status, result = waiting[0].result(LIMIT)
    assert (status, result["goal_reached"]) == (1, False)
    assert {failure["cause"] for failure in result["failures"]} == {"unavailable"}
    tried = [call for call in result["calls"] if call["attempts"]]
    assert tried
    assert {call["outcome"] for call in tried} == {"unavailable"}
    for failure in result["failures"]:
        action, first = failure["call"].split("(")[0], failure["call"].split("(")[1].split(",")[0]
        server = "/store/load" if action == "load" else f"/{first}/{action}"
        assert failure["observed"].startswith(f"there is no action server {server}")


def test_killed_robots_are_lost_once_their_lease_is_over(waiting):
    _, run, since = waiting
    status, result = run.result(since + LIMIT - monotonic())
    assert (status, result["goal_reached"]) == (1, False)
    assert {failure["cause"] for failure in result["failures"]} <= {"lost", "unavailable"}
    assert result["failures"][0]["observed"].startswith("/r1/move went away")
