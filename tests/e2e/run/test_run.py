"""From a goal in PDDL to action servers of ROS 2 in another process; that process knows what became of it."""

from __future__ import annotations

import signal

import pytest

from tests.support.processes import overlaps


def at_first_attempt(deployment):
    """Return what came of a problem whose plan is carried out as it was made."""
    finished = deployment.execute()
    assert finished.result["goal_reached"]
    assert (finished.result["plans"], finished.result["replans"], finished.result["failures"]) == (1, 0, [])
    assert {call["outcome"] for call in finished.result["calls"]} == {"succeeded"}
    return finished


def test_robots_deliver_at_the_same_time(deploy):
    finished = at_first_attempt(deploy("delivery/p01"))
    assert {"r1", "r2"} in [{action.split("(")[1].split(",")[0] for action in pair} for pair in overlaps(finished.events)]


def test_a_robot_speaks_while_it_points(deploy):
    finished = deploy("mall_guide/p01", speed="8").execute()
    assert finished.result["goal_reached"]
    together = [(first.split("(")[0], second.split("(")[0]) for first, second in overlaps(finished.events)]
    assert {("point_at", "describe_route"), ("point_at", "describe_by_landmark")} & set(together)


def test_a_robot_patrols(deploy):
    at_first_attempt(deploy("patrol/p01"))


IN_BACKGROUND = ("sh", "-c", 'trap "" INT; exec "$@"', "sh")
TWICE = (signal.SIGTERM, signal.SIGTERM)  # as some supervisors send it: to the process and to its group


@pytest.mark.parametrize(
    ("signals", "within"),
    [((signal.SIGINT,), IN_BACKGROUND), (TWICE, ()), ((signal.SIGHUP,), ())],
    ids=["INT in the background", "TERM twice at once", "terminal closed"],
)
def test_every_signal_cancels_what_runs_and_still_tells_how_it_went(deploy, signals, within):
    deployment = deploy("delivery/p01", speed="0.1")
    simulation = deployment.simulate().ready()
    run = deployment.run(within=within)
    simulation.until(lambda: len([one for one in simulation.objects() if one["event"] == "start"]) == 2)
    for number in signals:
        run.process.send_signal(number)
    finished = deployment.finish(run, simulation)
    assert (finished.status, finished.result["reason"]) == (1, "cancelled")
    assert [event["outcome"] for event in finished.events if event["event"] == "end"] == ["canceled", "canceled"]
    assert [call["outcome"] for call in finished.result["calls"] if call["attempts"]] == ["canceled", "canceled"]
    assert finished.result["failures"] == []
