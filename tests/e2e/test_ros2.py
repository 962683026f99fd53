"""From a goal in PDDL to action servers of ROS 2 in another process; that process knows what became of it."""

from __future__ import annotations

import pytest

from tests.e2e.processes import overlaps

SPEECH = ("describe_route", "describe_by_landmark")


@pytest.mark.parametrize("name", ["delivery/p01", "delivery/p02", "patrol/p01", "patrol/p02"])
def test_the_goal_is_reached_at_the_first_attempt(stage, name):
    story = stage(name).play()
    assert story.result["goal_reached"]
    assert (story.result["plans"], story.result["replans"], story.result["failures"]) == (1, 0, [])
    assert {call["outcome"] for call in story.result["calls"]} <= {"succeeded", "already true"}
    if name.startswith("delivery"):
        together = overlaps(story.events)
        assert any(("(r1," in first and "(r2," in second) or ("(r2," in first and "(r1," in second) for first, second in together), together


@pytest.mark.parametrize("name", ["mall_guide/p01", "mall_guide/p02"])
def test_the_robot_speaks_while_it_points(stage, name):
    story = stage(name, speed="10").play()
    assert story.result["goal_reached"]
    together = overlaps(story.events)
    assert any(first.startswith("point_at") and second.startswith(SPEECH) for first, second in together), together
