"""What action servers say about goals while they are at work: on one line, and not more often than anybody can read."""

from __future__ import annotations

import asyncio

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PolygonStamped, PoseStamped
from pnm_interfaces.action import GroundAction, RunPlan
from test_msgs.action import Fibonacci, NestedMessage
from test_msgs.msg import Arrays, BasicTypes, Nested

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Feedback
from pnm.ros.action_client.goal import LENGTH, feedback_line
from tests.support.ros.child_process import bounded


def pose(x: float) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x = x
    return message


@pytest.mark.parametrize(
    ("message", "line"),
    [
        (GroundAction.Feedback(progress=0.25), "progress 0.25"),
        (Fibonacci.Feedback(sequence=[0, 1, 1]), "sequence [0, 1, 1]"),
        (Fibonacci.Feedback(sequence=range(1000)), "sequence 1000 items"),
        (Fibonacci.Feedback(), ""),
        (
            RunPlan.Feedback(running=["move(r1)"], feedback=["progress 1"], ended=3),
            "running [move(r1)], feedback [progress 1], ended 3, restarts 0",
        ),
        (
            NestedMessage.Feedback(nested_different_pkg=Duration(sec=3, nanosec=250_000_000)),
            "nested_different_pkg 3.2 s",
        ),
        (pose(1.23456), "pose.position.x 1.235, pose.position.y 0, pose.position.z 0"),
        (PolygonStamped(), ""),
        (Nested(basic_types_value=BasicTypes(byte_value=b"\x05")), "basic_types_value.bool_value false, basic_types_value.byte_value 5"),
    ],
)
def test_feedback_on_one_line(message, line):
    written = feedback_line(message)
    assert written.startswith(line), written
    assert bool(written) == bool(line)
    assert len(written) <= LENGTH + 3


def test_the_longest_line_ends_where_it_is_too_long():
    assert feedback_line(Arrays()).endswith(", …")
    assert feedback_line(RunPlan.Feedback(running=["x" * 1000])) == f"running [{'x' * (LENGTH - 10)}…"


@bounded
async def test_a_server_that_reports_without_a_pause_is_heard_a_few_times_about_the_goal_it_means(connect, shared):
    client = connect(act=Binding(server=shared))
    other, sent = client.send("act", action="hang"), client.send("act", action="chatter", arguments=["2000"])
    await asyncio.gather(other.accepted(), sent.accepted())
    heard = []
    while not heard or heard[-1] != Feedback(sent.id, "progress 1"):
        heard.append(await sent.reports.get())
    assert len(heard) < 200, "of two thousand"
    shares = [float(report.text.removeprefix("progress ")) for report in heard]
    assert shares == sorted(shares)
    assert {report.request for report in heard} == {sent.id}
    assert await other.reports.get() == Feedback(other.id, "progress 0")
    for goal in (other, sent):
        client.cancel(goal)
        await goal.ended()
