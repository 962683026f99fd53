"""What the packages log is on `/rosout`: by the first node of a process, for whoever comes late, and never in a circle."""

from __future__ import annotations

import logging
import subprocess
import sys
from queue import SimpleQueue

import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from pnm.ros.node.ros_thread import RosThread
from pnm.tasks import EVENTS
from tests.support.files import ROOT
from tests.support.processes import LIMIT


def test_warnings_and_events_are_published_with_their_level_and_time(ros):
    heard: SimpleQueue[Log] = SimpleQueue()
    latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    logging.getLogger("pnm.somewhere").warning("the first %s of %d", "word", 2)
    logging.getLogger("planner_bridge.else").error("wrong")
    logging.getLogger("pnm.somewhere").info("nobody wants to know")
    EVENTS.info("a task has begun")
    late = ros.submit(lambda: ros.node.create_subscription(Log, "/rosout", heard.put, latched)).result(LIMIT)
    published: dict[str, Log] = {}
    while "a task has begun" not in published:
        message = heard.get(timeout=LIMIT)
        published[message.msg] = message
    ros.submit(lambda: ros.node.destroy_subscription(late)).result(LIMIT)
    assert "nobody wants to know" not in published
    levels = {text: published[text].level for text in ("the first word of 2", "wrong", "a task has begun")}
    assert levels == {"the first word of 2": 30, "wrong": 40, "a task has begun": 20}
    first = published["the first word of 2"]
    assert (first.name, first.file, first.stamp.sec > 1_600_000_000) == ("test", __file__, True)


PROGRAM = """
import logging, sys
from pnm.ros.node.ros_thread import RosThread
from pnm.tasks import EVENTS
ros = RosThread("alone", args=sys.argv[1:])
logging.getLogger("pnm.somewhere").warning("mind the gap")
EVENTS.error("not here")
ros.close()
logging.getLogger("pnm.somewhere").warning("mind the step")
EVENTS.error("nor here")
"""


@pytest.mark.parametrize("arguments", [[], ["--ros-args", "--disable-rosout-logs"]])
def test_warnings_are_printed_once_as_if_nothing_were_published(arguments):
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT, check=True)
    assert (done.stdout, done.stderr) == ("", "mind the gap\nmind the step\n")


def test_a_node_that_is_closed_leaves_it_to_the_next_one():
    before = EVENTS.handlers.copy()
    thread = RosThread("short")
    assert thread.close()
    assert EVENTS.handlers == before
