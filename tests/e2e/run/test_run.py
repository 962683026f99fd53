"""From a goal in PDDL to action servers of ROS 2 in another process; that process knows what became of it."""

from __future__ import annotations

import json
import signal
import threading

import pytest

from pnm.ros.node.messages import import_type
from pnm.ros.node.ros_thread import RosThread
from tests.support.e2e.command_line import pnm
from tests.support.processes import LIMIT, overlaps


def test_robots_deliver_at_the_same_time(deploy):
    finished = deploy("delivery/p01").execute()
    assert finished.result["goal_reached"]
    assert (finished.result["plans"], finished.result["replans"], finished.result["failures"]) == (1, 0, [])
    assert {call["outcome"] for call in finished.result["calls"]} == {"succeeded"}
    assert {"r1", "r2"} in [{action.split("(")[1].split(",")[0] for action in pair} for pair in overlaps(finished.events)]


def test_simulated_robots_tell_how_far_they_have_come(deploy, monkeypatch):
    deployment = deploy("delivery/p01", speed="2", quick=True)
    deployment.simulate().ready()
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    ros, told, over = RosThread("listener"), [], threading.Event()
    ground = import_type("pnm_interfaces/action/GroundAction")

    def answered(future):
        future.result().get_result_async().add_done_callback(lambda _: over.set())

    def send():
        from rclpy.action import ActionClient

        client = ActionClient(ros.node, ground, "/r1/move")
        client.wait_for_server(LIMIT)
        goal = ground.Goal(action="move", arguments=["r1", "store", "hall"])
        client.send_goal_async(goal, lambda message: told.append(message.feedback.progress)).add_done_callback(answered)

    try:
        ros.call(send)
        assert over.wait(LIMIT)
    finally:
        assert ros.close()
    assert len(told) >= 2
    assert told == sorted(told)
    assert all(0.0 < share <= 1.0 for share in told)


IN_BACKGROUND = ("sh", "-c", 'trap "" INT; exec "$@"', "sh")
TWICE = (signal.SIGTERM, signal.SIGTERM)  # as some supervisors send it: to the process and to its group


@pytest.mark.parametrize(
    ("signals", "within"), [((signal.SIGINT,), IN_BACKGROUND), (TWICE, ())], ids=["INT in the background", "TERM twice at once"]
)
def test_every_signal_cancels_what_runs_and_still_tells_how_it_went_also_in_the_journal(deploy, signals, within):
    deployment = deploy("delivery/p01", speed="0.1")
    simulation = deployment.simulate().ready()
    journal = str(deployment.folder / "run.journal")
    run = deployment.run("--journal", journal, within=within)
    simulation.until(lambda: len([one for one in simulation.objects() if one["event"] == "start"]) == 2)
    for number in signals:
        run.process.send_signal(number)
    finished = deployment.finish(run, simulation)
    assert (finished.status, finished.result["reason"]) == (1, "cancelled")
    assert [event["outcome"] for event in finished.events if event["event"] == "end"] == ["canceled", "canceled"]
    assert [call["outcome"] for call in finished.result["calls"] if call["attempts"]] == ["canceled", "canceled"]
    assert finished.result["failures"] == []
    (task,) = map(json.loads, pnm("history", journal, "--json").stdout.splitlines())
    assert task["code"] == "cancelled"
    assert pnm("resume", journal).returncode == 1
