"""Action servers that come late, are killed or blocked, several of one name, and clients that end."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from time import monotonic

import pytest

from pnm.core.machine.bindings import Binding
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import OutcomeKind
from pnm.ros.node.graph import processes
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import until_true
from tests.support.e2e.hosts.lan import LEASE
from tests.support.processes import LIMIT
from tests.support.ros.middleware import middleware


async def test_a_server_that_comes_late_is_waited_for_and_its_type_is_learned(connect, start, names):
    client, action = connect(), GroundAction(names())
    assert await client.ros2.prepare([action], 0.0) == (f"/{action.name}",)
    sent = client.send(action.name, order=2)
    await asyncio.to_thread(start, "--fibonacci", name=action.name)
    assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED
    assert client.ros2.goal_fields(action) == ("order",)


async def test_30_goals_at_once_on_a_server_with_default_qos_that_end_together_or_are_cancelled(connect, shared):
    client = connect(act=Binding(server=shared))
    sent = [client.send("act", action="together", arguments=["30"]) for _ in range(30)]
    assert {(await one.ended()).kind for one in sent} == {OutcomeKind.SUCCEEDED}
    sent = [client.send("act", action="hang") for _ in range(30)]
    for one in sent:
        await one.accepted()
    for one in sent:
        client.cancel(one)
    assert {(await one.ended()).kind for one in sent} == {OutcomeKind.CANCELED}


async def test_a_goal_that_is_answered_late_is_cancelled_and_over_when_its_server_says_so(connect, start):
    name = start("--threads", "2").name
    client = connect(act=Binding(server=name, accept=2.0), patient=Binding(server=name))
    await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
    for _ in range(2):  # both threads are kept busy by goals that nobody waits for, unless these are cancelled
        outcome = await client.send("act", action="hesitate", arguments=["3"]).ended()
        assert (outcome.kind, outcome.message.partition(" after")[0]) == (OutcomeKind.CANCELED, "stopped")
    assert (await client.send("patient", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED


async def test_a_goal_whose_answer_gets_lost_is_cancelled_by_its_id(connect, shared):
    client = connect(act=Binding(server=shared, accept=1.0), patient=Binding(server=shared))
    await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
    outcome = await client.send("act", action="mute").ended()
    assert (outcome.kind, outcome.message.partition(" after")[0]) == (OutcomeKind.CANCELED, "stopped")


async def test_a_goal_that_is_never_taken_up_ends_when_its_server_does_not_know_it_for_as_long_again(connect, start):
    name = start("--threads", "3").name
    client = connect(act=Binding(server=name, accept=1.0), patient=Binding(server=name))
    await client.send("patient", action="succeed").ended()  # the first contact may take longer than the limit
    outcome = await client.send("act", action="hesitate", arguments=["30"]).ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.UNAVAILABLE, f"/{name} did not answer within 1 s, and does not know the goal")


async def test_a_restarted_server_is_noticed_quickly_and_used_again(connect, start):
    server = start()
    client = connect(act=Binding(server=server.name))
    sent = client.send("act", action="hang")
    await sent.accepted()
    server.kill()
    await asyncio.to_thread(start, name=server.name)
    outcome = await sent.ended()  # the lease of the old process lasts 20 s
    assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, f"/{server.name} no longer knows the goal; it was restarted")
    assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED


async def test_a_killed_server_is_lost_and_a_blocked_one_is_not(connect, start, tmp_path):
    killed = start(**middleware(tmp_path, int(os.environ["ROS_DOMAIN_ID"]), lease=LEASE))
    client = connect(act=Binding(server=killed.name), busy=Binding(server=start("--threads", "1").name))
    busy = client.send("busy", action="block", arguments=[str(LEASE + 8)])
    sent = client.send("act", action="hang")
    await asyncio.gather(sent.accepted(), busy.accepted())
    killed.kill()
    since = monotonic()
    outcome = await sent.ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, f"/{killed.name} went away")
    assert monotonic() - since > 2.0, "its lease lasts longer"
    assert (await busy.ended()).kind is OutcomeKind.SUCCEEDED


# --- several servers of one name: all of them carry out what is sent to one ---


async def test_nothing_is_sent_while_two_servers_would_carry_it_out(connect, start):
    other = start()
    start(name=other.name)
    async with RosThread("newcomer") as ros:
        client = connect(ros, act=Binding(server=other.name))
        await until_true(ros, lambda: len(processes(ros.node, f"/{other.name}")) == 2)  # a busy machine shows the second one late
        await client.ros2.prepare([GroundAction("act")], LIMIT)
        outcome = await client.send("act", action="hang").ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert outcome.message.startswith(f"there are 2 action servers /{other.name}, all of which would carry out every goal")
        await asyncio.to_thread(other.stop)
        while (await client.send("act", action="succeed").ended()).kind is not OutcomeKind.SUCCEEDED:  # noqa: ASYNC110 - the graph has no event
            await asyncio.sleep(0.1)


@pytest.mark.parametrize("allowed", [False, True])
async def test_a_second_server_ends_what_the_first_one_is_at_work_on_unless_it_is_allowed(connect, start, allowed):
    name = start().name
    client = connect(act=Binding(server=name, several_servers=allowed))
    sent = client.send("act", action="slow", arguments=["10"])
    await sent.accepted()
    await asyncio.to_thread(start, name=name)
    outcome, later = await sent.ended(), await client.send("act", action="succeed").ended()
    if allowed:
        assert (outcome.kind, outcome.message) == (OutcomeKind.SUCCEEDED, "done")
        assert later.kind is OutcomeKind.SUCCEEDED
    else:
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert outcome.message.startswith(f"there are 2 action servers /{name}, all of which would carry out every goal")
        assert later.message == outcome.message


# --- clients that end ---


async def test_goals_end_when_the_ros_thread_is_closed_under_the_client(connect, shared):
    ros = RosThread("closed_early")
    client = connect(ros, act=Binding(server=shared))
    sent = client.send("act", action="hang")
    await sent.accepted()
    assert await asyncio.to_thread(ros.close)
    outcome = await sent.ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.LOST, "the ROS 2 node was closed")
    assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.UNAVAILABLE


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
