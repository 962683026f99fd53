"""The thread: work goes to it, errors come back, and it ends."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from contextlib import closing
from functools import partial
from types import SimpleNamespace

import pytest

from pnm.errors import InputError, Position, RosError, installation
from pnm.ros.node.graph import server_name
from pnm.ros.node.ros_thread import RosThread
from tests.support.processes import LIMIT


def test_the_thread_is_woken_for_every_function_that_it_has_not_seen(ros):
    """Several threads, each of which goes on when its function was run: a wake-up that is left out would leave one waiting."""
    seen = []

    def call_on(name):
        for number in range(200):
            ros.submit(lambda number=number: seen.append((name, number))).result(LIMIT)

    threads = [threading.Thread(target=call_on, args=(name,)) for name in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT)
    assert sorted(seen) == [(name, number) for name in "abc" for number in range(200)]


def test_a_wake_up_that_the_middleware_loses_delays_a_function_and_no_more(monkeypatch):
    """Fast DDS clears a trigger that comes while it returns from a wait for a message: about one of 10,000 where messages come often."""
    with closing(RosThread("sleeper")) as thread:
        guard = SimpleNamespace(trigger=lambda: None)
        monkeypatch.setattr(thread, "_guard", guard)
        assert thread.submit(lambda: threading.current_thread().name).result(LIMIT) == "ros"
        assert [thread.submit(partial(int, number)).result(LIMIT) for number in range(2)] == [0, 1]


def test_errors_come_back_and_do_not_end_the_thread(ros, caplog):
    with pytest.raises(ZeroDivisionError):
        ros.submit(lambda: 1 / 0).result(LIMIT)
    with pytest.raises(ZeroDivisionError):
        asyncio.run(ros.ask(lambda: 1 / 0))
    ros.call(lambda: 1 / 0)
    assert ros.submit(lambda: True).result(LIMIT)
    assert "a function on the ROS 2 thread failed" in caplog.text


def test_a_callback_that_fails_does_not_end_the_thread(ros, caplog):
    fired = threading.Event()

    def fail():
        fired.set()
        raise RuntimeError("a bug")

    timer = ros.submit(lambda: ros.timer(0.01, fail)).result(LIMIT)
    assert fired.wait(LIMIT)
    ros.submit(timer.destroy).result(LIMIT)
    assert "a ROS 2 callback failed" in caplog.text


def test_close_runs_what_waits_and_may_be_repeated():
    thread = RosThread("closing")
    seen = []
    thread.call(lambda: seen.append(1))
    assert thread.close()
    assert thread.close()
    thread.call(lambda: seen.append(2))
    with pytest.raises(RosError, match="is closed"):
        thread.submit(lambda: None).result(LIMIT)
    assert seen == [1]


@pytest.mark.parametrize(("name", "args", "said"), [("two words", [], ""), ("pnm", ["--ros-args", "--spam"], ".*spam")])
def test_a_node_that_cannot_be_made_says_why(name, args, said):
    with pytest.raises(RosError, match=f"the ROS 2 node '{name}' cannot be made: {said}"):
        RosThread(name, args=args)


@pytest.mark.parametrize("name", ["two words", *(f"/secret/{argument}/go" for argument in ("\0", "r1\0", "\0r1", "a\0/b"))])
def test_what_is_no_name_of_a_server_is_refused_with_its_place_and_becomes_no_other_name(ros, name):
    with pytest.raises(InputError, match=r"f:1:2: not a name for an action server: "):
        ros.submit(lambda: server_name(ros.node, name, Position("f", 1, 2))).result(LIMIT)


WITHOUT = """
import sys
sys.modules["rclpy"] = None
import pnm.ros.action_client.client, pnm.ros.sensors
from pnm.ros.node.ros_thread import RosError, RosThread
try:
    RosThread()
except RosError as error:
    print(error)
"""


def test_without_ros_the_modules_import_and_the_thread_says_what_to_install():
    ended = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True, timeout=LIMIT, check=True)
    assert f"{installation('ros2')}" in ended.stdout
    assert "source a ROS 2 installation" in ended.stdout
