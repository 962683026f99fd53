"""Ways a goal can end, against real servers in other processes; `test_beside_rclpy` has the usual ones."""

from __future__ import annotations

import asyncio

import pytest

from pnm.core.machine.bindings import Binding
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, Feedback, OutcomeKind, Postponed
from pnm.errors import InputError
from tests.support.processes import LIMIT
from tests.support.ros.recording_client import GROUND

FIBONACCI = "test_msgs/action/Fibonacci"


async def test_an_end_is_known_before_it_is_reported_and_one_without_success_when_the_world_has_been_asked(connect, shared):
    known, asked, answered = [], asyncio.Event(), asyncio.Event()

    def ended(request):
        known.append((request, [report for report in sent.reports._queue if isinstance(report, Ended)]))
        asked.set()
        return answered.wait()

    client = connect(ended=ended, act=Binding(server=shared))
    sent = client.send("act", action="succeed")
    assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED
    assert known == [(sent.id, [])]
    asked.clear()
    sent = aborted = client.send("act", action="abort")
    await aborted.accepted()
    await asked.wait()
    sent = client.send("act", action="succeed")
    assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED
    assert aborted.reports.empty()
    answered.set()
    assert (await aborted.ended()).kind is OutcomeKind.ABORTED


async def test_two_types_for_one_server_are_an_error_and_one_serves_for_all(connect, shared):
    act, again = Binding(server=shared), Binding(server=f"/{shared}", type=GROUND)
    client = connect(act=act, again=again, other=Binding(server=shared, type=FIBONACCI))
    assert not await client.ros2.prepare([GroundAction("act"), GroundAction("again")], LIMIT)
    outcome = await client.send("again", action="succeed").ended()
    assert outcome.kind is OutcomeKind.SUCCEEDED
    reason = f"the action server /{shared} is bound with two types: {GROUND} and {FIBONACCI}"
    with pytest.raises(InputError, match=reason):
        await client.ros2.prepare([GroundAction("other")])
    outcome = await client.send("other", order=3).ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.UNAVAILABLE, reason)


async def test_cancel_before_acceptance_is_sent_on_acceptance(connect, shared):
    client = connect(act=Binding(server=shared))
    await client.send("act", action="succeed").ended()  # from now on goals are sent at once
    sent = client.send("act", action="hesitate", arguments=["0.5"])
    client.cancel(sent)
    await sent.accepted()
    assert (await sent.ended()).kind is OutcomeKind.CANCELED


async def test_cancel_before_sending_sends_nothing(connect, names):
    client = connect(act=Binding(server=names(), type=GROUND))
    sent = client.send("act")
    client.cancel(sent)
    outcome = await sent.ended()
    assert (outcome.kind, outcome.message) == (OutcomeKind.CANCELED, "cancelled before it was sent")


@pytest.mark.parametrize(
    ("server", "type", "goal", "kind", "said"),
    [
        ("SHARED", None, {"action": "reject"}, OutcomeKind.REJECTED, "/SHARED rejected the goal"),
        ("SHARED", None, {"action": 3}, OutcomeKind.REJECTED, "field action needs string, got 3 (int)"),
        ("SHARED", None, {"acton": "x"}, OutcomeKind.REJECTED, "field acton needs to be one of action, arguments"),
        ("SHAREDx", None, {}, OutcomeKind.UNAVAILABLE, "there is no action server /SHAREDx; similar are /SHARED"),
        (
            "SHARED",
            FIBONACCI,
            {"order": 3},
            OutcomeKind.UNAVAILABLE,
            f"the action server /SHARED has the type {GROUND}, the binding says {FIBONACCI}",
        ),
        ("two words", None, {}, OutcomeKind.UNAVAILABLE, "not a name for an action server: 'two words'"),
    ],
)
async def test_what_cannot_be_sent_or_is_rejected_says_why(connect, shared, server, type, goal, kind, said):
    client = connect(act=Binding(server=server.replace("SHARED", shared), type=type))
    outcome = await client.send("act", **goal).ended()
    assert outcome.kind is kind
    assert said.replace("SHARED", shared) in outcome.message


async def test_a_goal_that_was_filled_before_its_type_was_known_is_sent_if_it_has_all_fields(connect, start):
    name = start("--fibonacci").name
    filled = {"action": name, "arguments": [], "duration": 0.0}
    outcome = await connect().send(name, **filled).ended()
    assert outcome.kind is OutcomeKind.UNAVAILABLE
    assert outcome.message == f"/{name} appeared after the goal was filled; there are no values for order"
    for way in ("send", "reattach"):  # it may be another process that has filled it
        client = connect()
        outcome = await getattr(client, way)(name, **filled, order=6.0).ended()
        assert outcome.result == {"sequence": [0, 1, 1, 2, 3, 5]}
    action = GroundAction(name.replace("_", "-"))  # hyphens in PDDL are underscores in ROS
    assert await client.ros2.prepare([action], LIMIT) == ()
    assert client.ros2.goal_fields(action) == ("order",)


async def test_goals_that_wait_for_the_answers_to_others_have_their_whole_time(connect, start):
    """The server answers one goal after the other: more goals than it answers within the limit of one of them all get an answer."""
    client = connect(act=Binding(server=start().name, type=GROUND, accept=2.5))
    await client.send("act", action="succeed").ended()  # from now on goals are sent at once
    goals = [client.send("act", action="hesitate", arguments=["0.5"]) for _ in range(12)]
    for goal in goals:
        await goal.accepted()
    for goal in goals:
        client.cancel(goal)
    for goal in goals:
        assert (await goal.ended()).kind is OutcomeKind.CANCELED


async def test_nothing_is_sent_while_the_process_may_not_act_and_all_of_it_when_it_may(connect, shared):
    client, other = (connect(act=Binding(server=shared)) for _ in range(2))
    running = client.send("act", action="hang")
    await running.accepted()
    client.may_act = False
    client.cancel(running)
    waiting = client.send("act", action="succeed")
    for _ in range(3):  # by another process, so to speak
        await other.send("act", action="succeed").ended()
    reports = [sent.reports.get_nowait() for sent in (running, waiting) if not sent.reports.empty()]
    assert all(isinstance(report, Postponed) for report in reports)
    client.may_act = True
    assert (await running.ended()).kind is OutcomeKind.CANCELED
    assert (await waiting.ended()).kind is OutcomeKind.SUCCEEDED


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
