"""Goals on an action server that this client has not sent: waited for, cancelled or left alone; and those of its node's other processes."""

from __future__ import annotations

import asyncio
from uuid import UUID, uuid4

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from builtin_interfaces.msg import Time
from hypothesis import given, strategies as st
from rclpy.serialization import serialize_message

from pnm.core.machine.bindings import Binding, Foreign, WhenLost
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Request
from pnm.ros.action_client.action_services import OtherGoals, ros_uuid, statuses
from pnm.ros.node.services import until_true
from tests.support.ros.child_process import until_logged
from tests.support.ros.recording_client import RecordingClient, Sent

PREFIX = b"node"


@given(st.dictionaries(st.binary(min_size=16, max_size=16), st.integers(0, 6), max_size=20), st.integers(0, 3))
def test_the_status_of_goals_is_read_as_rclpy_does(known, padding):
    listed = [
        GoalStatus(goal_info=GoalInfo(goal_id=ros_uuid(UUID(bytes=goal)), stamp=Time(sec=2**31 - 1, nanosec=2**32 - 1)), status=status)
        for goal, status in known.items()
    ]
    assert statuses(serialize_message(GoalStatusArray(status_list=listed)) + bytes(padding)) == known


def sent_by_another_process(client: RecordingClient, action: str) -> Sent:
    """Send a goal with an id such as those of the node's processes."""
    return client.send("act", UUID(bytes=PREFIX + uuid4().bytes[4:]), action=action)


async def test_what_another_program_has_sent_is_waited_for(connect, start, caplog):
    name = start().name
    other = connect(act=Binding(server=name))
    client = connect(act=Binding(server=name, resources=("arm",)), look=Binding(server=name))
    drive = other.send("act", action="hang")
    await drive.accepted()
    assert (await client.send("look", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED
    mine = client.send("act", action="succeed")
    await until_logged(caplog, f"act() waits: /{name} is at work on goals of other programs")
    assert Accepted(mine.id) not in [*mine.reports._queue]
    other.cancel(drive)
    assert (await drive.ended()).kind is OutcomeKind.CANCELED
    assert (await mine.ended()).kind is OutcomeKind.SUCCEEDED


async def test_the_wait_for_others_has_a_limit_and_they_are_cancelled_if_the_binding_says_so(connect, start):
    name = start().name
    other = connect(act=Binding(server=name))
    client = connect(
        wait=Binding(server=name, foreign=Foreign.WAIT, timeout=0.5), cancel=Binding(server=name, foreign=Foreign.CANCEL)
    )  # fmt: skip
    drive = other.send("act", action="hang")
    await drive.accepted()
    outcome = await client.send("wait", action="succeed").ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.UNAVAILABLE, f"/{name} was at work on goals of other programs for 0.5 s")
    mine = client.send("cancel", action="succeed")
    assert (await drive.ended()).kind is OutcomeKind.CANCELED
    assert (await mine.ended()).kind is OutcomeKind.SUCCEEDED


async def test_what_this_node_has_forgotten_is_cancelled_and_what_it_goes_on_with_is_not(ros, connect, start, caplog):
    name = start().name
    before = connect(act=Binding(server=name))
    kept, forgotten = (sent_by_another_process(before, "hang") for _ in range(2))
    foreign = before.send("act", action="hang")
    for sent in (kept, forgotten, foreign):
        await sent.accepted()
    others = OtherGoals(ros, PREFIX, [kept.id])
    await ros.ask(lambda: others.watch(f"/{name}"))
    assert (await forgotten.ended()).kind is OutcomeKind.CANCELED
    assert "of this node that it knows nothing of; it is cancelled" in caplog.text
    assert await ros.ask(lambda: others.others(f"/{name}")) == {foreign.id}
    assert await ros.ask(others.busy_servers) == (f"/{name}",)
    before.cancel(foreign)
    await until_true(ros, lambda: not others.others(f"/{name}"))
    assert not any(isinstance(report, Ended) for report in [*kept.reports._queue])
    await ros.ask(others.close)


async def test_a_node_without_its_lease_cancels_nothing_of_the_one_that_has_taken_over(ros, connect, start, caplog):
    name, lease = start().name, []
    successor = connect(act=Binding(server=name))
    sent = sent_by_another_process(successor, "hang")
    await sent.accepted()
    others, free = OtherGoals(ros, PREFIX, may_act=lambda: bool(lease)), OtherGoals(ros)
    await until_true(ros, lambda: others.others(f"/{name}"))
    foreign = successor.send("act", action="hang")
    await foreign.accepted()
    await until_true(ros, lambda: foreign.id in free.others(f"/{name}"))
    await ros.ask(lambda: free.cancel(f"/{name}", [foreign.id]))  # later than the other one had reason to cancel
    assert (await foreign.ended()).kind is OutcomeKind.CANCELED
    assert "it is cancelled" not in caplog.text
    assert not any(isinstance(report, Ended) for report in [*sent.reports._queue])
    lease.append("got back: nobody had taken over")
    assert (await sent.ended()).kind is OutcomeKind.CANCELED
    await ros.ask(free.close)
    await ros.ask(others.close)


async def test_a_server_that_died_is_at_work_on_nothing(ros, connect, start):
    server = start()
    await connect(act=Binding(server=server.name)).send("act", action="hang").accepted()
    others = OtherGoals(ros)
    await until_true(ros, lambda: others.others(f"/{server.name}"))
    server.kill()
    await asyncio.to_thread(start, name=server.name)
    await until_true(ros, lambda: not others.others(f"/{server.name}"))
    await ros.ask(others.close)


async def test_a_kept_goal_that_is_cancelled_at_once_ends_when_its_server_says_so(connect, shared):
    before, after = (connect(act=Binding(server=shared)) for _ in range(2))
    stubborn = before.send("act", action="stubborn", arguments=["0.5"])
    await stubborn.accepted()
    again, unknown = Sent(stubborn.request), Sent(Request(uuid4(), GroundAction("act"), {"action": "succeed"}))
    after.ros2.reattach(again.request, again.reports.put_nowait, accepted=True)
    after.ros2.reattach(unknown.request, unknown.reports.put_nowait, accepted=False)
    after.cancel(again)
    after.cancel(unknown)
    assert (await again.ended()).kind is OutcomeKind.SUCCEEDED
    assert await unknown.ended() == Outcome(OutcomeKind.CANCELED, message="cancelled before it was sent")


async def test_a_goal_that_may_be_sent_twice_is_sent_to_the_server_that_has_come_back(connect, start):
    server = start()
    client = connect(act=Binding(server=server.name, when_lost=WhenLost.RESEND))
    sent = client.send("act", action="slow", arguments=["1"])
    await sent.accepted()
    server.kill()
    await asyncio.to_thread(start, name=server.name)
    assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED
