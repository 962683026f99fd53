"""Action servers that come late, shut down, are killed or blocked, and clients that end."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from time import monotonic

import pytest

from pnm.core.machine.bindings import Binding
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import OutcomeKind
from pnm.ros.node.ros_thread import RosThread
from tests.support.e2e.hosts.lan import DDS, LEASE
from tests.support.files import written
from tests.support.processes import LIMIT


def test_the_type_of_a_server_that_comes_later_is_learned(with_client, start, names):
    name = names()

    async def scenario(client):
        action = GroundAction(name)
        assert await client.ros2.prepare([action], 0.0) == (f"/{name}",)
        await asyncio.to_thread(start, "--fibonacci", name)
        await client.ros2.prepare([action], LIMIT)
        assert client.ros2.goal_fields(action) == ("order",)

    with_client(scenario)


def test_a_server_that_comes_late_is_waited_for(with_client, start, names):
    name = names()

    async def scenario(client):
        sent = client.send("act", action="succeed")
        await asyncio.to_thread(start, name)
        assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=name))


def test_30_goals_at_once_on_a_server_with_default_qos_that_end_together(with_client, shared):
    async def scenario(client):
        sent = [client.send("act", action="together", arguments=["30"]) for _ in range(30)]
        outcomes = await asyncio.gather(*(one.ended() for one in sent))
        assert {outcome.kind for outcome in outcomes} == {OutcomeKind.SUCCEEDED}

    with_client(scenario, act=Binding(server=shared))


def test_30_cancellations_at_once(with_client, shared):
    async def scenario(client):
        sent = [client.send("act", action="hang") for _ in range(30)]
        await asyncio.gather(*(one.accepted() for one in sent))
        for one in sent:
            client.cancel(one)
        outcomes = await asyncio.gather(*(one.ended() for one in sent))
        assert {outcome.kind for outcome in outcomes} == {OutcomeKind.CANCELED}

    with_client(scenario, act=Binding(server=shared))


def test_a_goal_that_is_answered_late_is_cancelled_and_over_when_its_server_says_so(with_client, start, names):
    name = names()
    start(name, "--threads", "2")

    async def scenario(client):
        await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
        for _ in range(2):  # both threads are kept busy by goals that nobody waits for, unless these are cancelled
            late = client.send("act", action="hesitate", arguments=["3"])
            outcome = await late.ended()
            assert (outcome.kind, outcome.message.partition(" after")[0]) == (OutcomeKind.CANCELED, "stopped")
        assert (await client.send("patient", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=name, accept=2.0), patient=Binding(server=name))


def test_a_goal_whose_answer_gets_lost_is_cancelled_by_its_id(with_client, shared):
    async def scenario(client):
        await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
        outcome = await client.send("act", action="mute").ended()
        assert (outcome.kind, outcome.message.partition(" after")[0]) == (OutcomeKind.CANCELED, "stopped")

    with_client(scenario, act=Binding(server=shared, accept=1.0), patient=Binding(server=shared))


def test_a_goal_that_is_never_taken_up_ends_when_its_server_does_not_know_it_for_as_long_again(with_client, start, names):
    name = names()
    start(name, "--threads", "3")

    async def scenario(client):
        await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
        outcome = await client.send("act", action="hesitate", arguments=["30"]).ended()
        assert (outcome.kind, outcome.message) == (
            OutcomeKind.UNAVAILABLE,
            f"/{name} did not answer within 1 s, and does not know the goal",
        )

    with_client(scenario, act=Binding(server=name, accept=1.0), patient=Binding(server=name))


def test_a_server_that_shuts_down_is_lost(with_client, start, names):
    name = names()
    server = start(name)

    async def scenario(client):
        sent = client.send("act", action="hang")
        await sent.accepted()
        await asyncio.to_thread(server.stop)
        assert (await sent.ended()).kind is OutcomeKind.LOST

    with_client(scenario, act=Binding(server=name))


def test_a_restarted_server_is_noticed_quickly_and_used_again(with_client, start, names):
    name = names()
    server = start(name)

    async def scenario(client):
        sent = client.send("act", action="hang")
        await sent.accepted()
        server.kill()
        await asyncio.to_thread(start, name)
        outcome = await sent.ended()  # the lease of the old process lasts 20 s
        assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, f"/{name} no longer knows the goal; it was restarted")
        assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=name))


def test_a_killed_server_is_lost_and_a_blocked_one_is_not(with_client, start, names, tmp_path):
    killed, blocked = names(), names()
    victim = start(killed, FASTRTPS_DEFAULT_PROFILES_FILE=str(written(tmp_path / "dds.xml", DDS)))
    start(blocked, "--threads", "1")

    async def scenario(client):
        busy = client.send("busy", action="block", arguments=[str(LEASE + 8)])
        sent = client.send("act", action="hang")
        await asyncio.gather(sent.accepted(), busy.accepted())
        victim.kill()
        since = monotonic()
        outcome = await sent.ended()
        assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, f"/{killed} went away")
        assert monotonic() - since > 2.0, "its lease lasts longer"
        assert (await busy.ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=killed), busy=Binding(server=blocked))


def test_goals_end_when_the_ros_thread_is_closed_under_the_client(with_client, shared):
    async def scenario(another):
        ros = RosThread("closed_early")
        client = type(another)(ros, act=Binding(server=shared))
        sent = client.send("act", action="hang")
        await sent.accepted()
        assert await asyncio.to_thread(ros.close)
        outcome = await sent.ended()
        assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, "the ROS 2 node was closed")
        assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.UNAVAILABLE

    with_client(scenario)


CLOSING = """
import asyncio, sys
from uuid import uuid4
from pnm.core.machine.requests import Request
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.node.ros_thread import RosThread

ros = RosThread("closing")

async def main():
    client = Ros2ActionClient(ros, Bindings(), asyncio.get_running_loop())
    accepted = asyncio.Event()
    action = GroundAction(sys.argv[1])
    client.send(Request(uuid4(), action, {"action": "hang"}), lambda report: accepted.set())
    await asyncio.wait_for(accepted.wait(), 100)
    if sys.argv[2] == "close":
        client.close()
        assert ros.close()

asyncio.run(main())
"""


@pytest.mark.parametrize("how", ["close", "just end"])
def test_a_process_with_an_open_goal_ends_cleanly(shared, how):
    command = [sys.executable, "-c", CLOSING, shared, how]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
