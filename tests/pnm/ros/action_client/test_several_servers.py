"""Several action servers of one name: all of them carry out what is sent to one."""

from __future__ import annotations

import asyncio

from pnm.core.machine.bindings import Binding
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import OutcomeKind
from pnm.ros.node.graph import processes
from pnm.ros.node.ros_thread import RosThread
from tests.support.processes import LIMIT


async def until(client, kind):
    """Send goals until one ends like this: the graph takes its time to show who is there."""
    async with asyncio.timeout(LIMIT):
        while (await client.send("act", action="succeed").ended()).kind is not kind:
            pass


def test_nothing_is_sent_while_two_servers_would_carry_it_out(with_client, start, names):
    name = names()
    start(name)
    other = start(name)

    async def scenario(another):
        ros = RosThread("newcomer")
        client = type(another)(ros, act=Binding(server=name))
        async with asyncio.timeout(LIMIT):  # on a busy machine the graph shows the second one late
            while len(await ros.ask(lambda: processes(ros.node, f"/{name}"))) < 2:
                pass
        await client.ros2.prepare([GroundAction("act")], LIMIT)
        outcome = await client.send("act", action="hang").ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert outcome.message.startswith(f"there are 2 action servers /{name}, all of which would carry out every goal")
        await asyncio.to_thread(other.stop)
        await until(client, OutcomeKind.SUCCEEDED)
        client.ros2.close()
        assert await asyncio.to_thread(ros.close)

    with_client(scenario)


def test_a_binding_allows_them(with_client, start, names):
    name = names()
    start(name)
    start(name)

    async def scenario(client):
        assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=name, several_servers=True))


def test_a_second_server_ends_what_the_first_one_is_at_work_on_with_the_reason(with_client, start, names):
    name = names()
    start(name)

    async def scenario(client):
        sent = client.send("act", action="hang")
        await sent.accepted()
        await asyncio.to_thread(start, name)
        outcome = await sent.ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert outcome.message.startswith(f"there are 2 action servers /{name}, all of which would carry out every goal")
        assert (await client.send("act", action="succeed").ended()).message == outcome.message

    with_client(scenario, act=Binding(server=name))


def test_a_second_server_that_is_allowed_does_not_make_the_first_one_lost(with_client, start, names):
    name = names()
    start(name)

    async def scenario(client):
        sent = client.send("act", action="slow", arguments=["10"])
        await sent.accepted()
        await asyncio.to_thread(start, name)
        outcome = await sent.ended()
        assert (outcome.kind, outcome.message) == (OutcomeKind.SUCCEEDED, "done")

    with_client(scenario, act=Binding(server=name, several_servers=True))
