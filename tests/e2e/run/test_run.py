"""From a goal in PDDL to action servers of ROS 2 in another process; that process knows what became of it."""

from __future__ import annotations

import signal

import pytest

from tests.support.e2e.processes import overlaps
from tests.support.e2e.scene import play_together


def at_first_attempt(*stories):
    """Check that every plan was carried out as it was made; return the stories."""
    for story in stories:
        assert story.result["goal_reached"]
        assert (story.result["plans"], story.result["replans"], story.result["failures"]) == (1, 0, [])
        assert {call["outcome"] for call in story.result["calls"]} == {"succeeded"}
    return stories


def test_robots_deliver_at_the_same_time(stage):
    for story in at_first_attempt(*play_together(stage("delivery/p01"), stage("delivery/p02"))):
        robots = [{action.split("(")[1].split(",")[0] for action in pair} for pair in overlaps(story.events)]
        assert {"r1", "r2"} in robots


def test_a_robot_speaks_while_it_points(stage):
    for story in play_together(stage("mall_guide/p01", speed="8"), stage("mall_guide/p02", speed="8")):
        assert story.result["goal_reached"]
        together = [(first.split("(")[0], second.split("(")[0]) for first, second in overlaps(story.events)]
        assert {("point_at", "describe_route"), ("point_at", "describe_by_landmark")} & set(together)


def test_a_robot_patrols(stage):
    at_first_attempt(*play_together(stage("patrol/p01"), stage("patrol/p02")))


@pytest.mark.parametrize("within", [(), ("sh", "-c", 'trap "" INT; exec "$@"', "sh")], ids=["foreground", "background"])
def test_ctrl_c_cancels_what_runs_and_still_tells_how_it_went(stage, within):
    scene = stage("delivery/p01", speed="0.1")
    simulation = scene.simulate().ready()
    run = scene.run(within=within)
    simulation.until(lambda: len([one for one in simulation.objects() if one["event"] == "start"]) == 2)
    run.process.send_signal(signal.SIGINT)
    story = scene.judge(run, simulation)
    assert (story.status, story.result["reason"]) == (1, "cancelled")
    assert [event["outcome"] for event in story.events if event["event"] == "end"] == ["canceled", "canceled"]
    assert [call["outcome"] for call in story.result["calls"] if call["attempts"]] == ["canceled", "canceled"]
    assert story.result["failures"] == []
