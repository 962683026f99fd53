"""Every way a goal can end, against real servers in other processes."""

from __future__ import annotations

import asyncio
from uuid import uuid4

import pytest

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, OutcomeKind, Postponed, Request
from pnm.errors import InputError
from pnm.ros.action_client.client import Ros2ActionClient
from tests.support.processes import LIMIT
from tests.support.ros.child_process import run_bounded

GROUND = "pnm_interfaces/action/GroundAction"
FIBONACCI = "test_msgs/action/Fibonacci"


@pytest.mark.parametrize(
    ("action", "kind", "message"),
    [
        ("succeed", OutcomeKind.SUCCEEDED, "did succeed r1"),
        ("abort", OutcomeKind.ABORTED, "the door is shut"),
        ("raise", OutcomeKind.ABORTED, ""),
        ("oddly", OutcomeKind.ABORTED, "no end"),
    ],
)
def test_outcome_and_result(with_client, shared, action, kind, message):
    async def scenario(client):
        sent = client.send("act", action=action, arguments=["r1"])
        await sent.accepted()
        outcome = await sent.ended()
        assert (outcome.kind, outcome.message, outcome.result) == (kind, message, {"message": message})

    with_client(scenario, act=Binding(server=shared))


def test_an_end_is_known_before_it_is_reported(ros, shared):
    async def scenario():
        order = []
        loop, over = asyncio.get_running_loop(), asyncio.Event()

        def known(request):
            order.append(request)
            return asyncio.sleep(0)

        client = Ros2ActionClient(ros, Bindings({"act": Binding(server=shared)}), loop, known)

        def report(what):
            order.append(what)
            if isinstance(what, Ended):
                over.set()

        request = Request(uuid4(), GroundAction("act"), {"action": "succeed"})
        client.send(request, report)
        await over.wait()
        client.close()
        *_, last, ended = order
        assert (last, ended.request) == (request.id, request.id)
        assert order.count(request.id) == 1

    run_bounded(scenario())


def test_two_types_for_one_server_are_an_error_and_one_serves_for_all(with_client, shared):
    async def scenario(client):
        assert not await client.ros2.prepare([GroundAction("act"), GroundAction("again")], LIMIT)
        outcome = await client.send("again", action="succeed").ended()
        assert outcome.kind is OutcomeKind.SUCCEEDED
        reason = f"the action server /{shared} is bound with two types: {GROUND} and {FIBONACCI}"
        with pytest.raises(InputError, match=reason):
            await client.ros2.prepare([GroundAction("other")])
        outcome = await client.send("other", order=3).ended()
        assert (outcome.kind, outcome.message) == (OutcomeKind.UNAVAILABLE, reason)

    act, again = Binding(server=shared), Binding(server=f"/{shared}", type=GROUND)
    with_client(scenario, act=act, again=again, other=Binding(server=shared, type=FIBONACCI))


def test_rejected(with_client, shared):
    async def scenario(client):
        outcome = await client.send("act", action="reject").ended()
        assert outcome.kind is OutcomeKind.REJECTED
        assert shared in outcome.message

    with_client(scenario, act=Binding(server=shared, type=GROUND))


def test_cancel_is_confirmed_by_the_end(with_client, shared):
    async def scenario(client):
        sent = client.send("act", action="hang")
        await sent.accepted()
        client.cancel(sent)
        outcome = await sent.ended()
        assert outcome.kind is OutcomeKind.CANCELED
        assert outcome.message.startswith("stopped after")

    with_client(scenario, act=Binding(server=shared))


def test_cancel_before_acceptance_is_sent_on_acceptance(with_client, shared):
    async def scenario(client):
        await client.send("act", action="succeed").ended()  # from now on goals are sent at once
        sent = client.send("act", action="hesitate", arguments=["0.5"])
        client.cancel(sent)
        await sent.accepted()
        assert (await sent.ended()).kind is OutcomeKind.CANCELED

    with_client(scenario, act=Binding(server=shared))


def test_cancel_before_sending_sends_nothing(with_client, names):
    async def scenario(client):
        sent = client.send("act")
        client.cancel(sent)
        outcome = await sent.ended()
        assert (outcome.kind, outcome.message) == (OutcomeKind.CANCELED, "cancelled before it was sent")

    with_client(scenario, act=Binding(server=names(), type=GROUND))


def test_a_refused_cancel_is_not_an_end(with_client, shared):
    async def scenario(client):
        sent = client.send("act", action="stubborn", arguments=["1.5"])
        await sent.accepted()
        client.cancel(sent)
        assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED

    with_client(scenario, act=Binding(server=shared))


def test_cancelling_what_is_unknown_or_over_does_nothing(with_client, shared):
    async def scenario(client):
        sent = client.send("act", action="succeed")
        await sent.ended()
        client.cancel(sent)
        await client.send("act", action="succeed").ended()
        assert sent.reports.empty()

    with_client(scenario, act=Binding(server=shared))


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ({"action": 3}, "field action needs string, got 3 (int)"),
        ({"arguments": "kitchen"}, "field arguments needs a list of values of type string, got 'kitchen' (str)"),
        ({"acton": "x"}, "field acton needs to be one of action, arguments"),
    ],
)
def test_a_value_that_does_not_fit_is_rejected_and_named(with_client, shared, goal, said):
    async def scenario(client):
        outcome = await client.send("act", **goal).ended()
        assert outcome.kind is OutcomeKind.REJECTED
        assert said in outcome.message

    with_client(scenario, act=Binding(server=shared))


def test_an_absent_server_is_unavailable_and_a_similar_one_named(with_client, shared):
    async def scenario(client):
        assert await client.ros2.prepare([GroundAction("act")], limit=0.3) == (f"/{shared}x",)
        outcome = await client.send("act").ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert f"there is no action server /{shared}x; similar are /{shared}" in outcome.message

    with_client(scenario, act=Binding(server=f"{shared}x"))


def test_a_server_of_another_type_is_unavailable_and_both_types_named(with_client, shared):
    async def scenario(client):
        outcome = await client.send("act", order=3).ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert outcome.message == f"the action server /{shared} has the type {GROUND}, the binding says {FIBONACCI}"

    with_client(scenario, act=Binding(server=shared, type=FIBONACCI))


def test_a_name_that_cannot_be_one_is_unavailable(with_client):
    async def scenario(client):
        outcome = await client.send("act").ended()
        assert outcome.kind is OutcomeKind.UNAVAILABLE
        assert "not a name for an action server: 'two words'" in outcome.message

    with_client(scenario, act=Binding(server="two words"))


def test_type_found_from_the_graph_and_hyphens_written_as_underscores(with_client, start, names):
    name = names()
    start("--fibonacci", f"{name}_up")

    async def scenario(client):
        action = GroundAction(f"{name}-up")
        assert await client.ros2.prepare([action]) == ()
        assert client.ros2.goal_fields(action) == ("order",)
        outcome = await client.send(f"{name}-up", order=6.0).ended()
        assert outcome.result == {"sequence": [0, 1, 1, 2, 3, 5]}

    with_client(scenario)


def test_a_goal_that_another_process_filled_before_its_type_was_known_is_sent(with_client, start, names):
    name = names()
    start("--fibonacci", name)

    async def scenario(client):
        assert await client.ros2.prepare([GroundAction(name)], LIMIT) == ()
        outcome = await client.reattach(name, action=name, arguments=[], duration=0.0, order=2).ended()
        assert outcome.kind is OutcomeKind.SUCCEEDED

    with_client(scenario)


@pytest.mark.parametrize(("goal", "kind"), [({}, OutcomeKind.UNAVAILABLE), ({"order": 2}, OutcomeKind.SUCCEEDED)])
def test_a_goal_that_was_filled_before_its_type_was_known_is_sent_if_it_has_all_fields(with_client, start, names, goal, kind):
    name = names()
    start("--fibonacci", name)

    async def scenario(client):
        outcome = await client.send(name, action=name, arguments=[], duration=0.0, **goal).ended()
        assert outcome.kind is kind
        if not goal:
            assert outcome.message == f"/{name} appeared after the goal was filled; there are no values for order"

    with_client(scenario)


def test_goals_that_wait_for_the_answers_to_others_have_their_whole_time(with_client, start, names):
    """The server answers one goal after the other: more goals than it answers within the limit of one of them all get an answer."""
    server = names()
    start(server)

    async def scenario(client):
        await client.send("act", action="succeed").ended()  # from now on goals are sent at once
        goals = [client.send("act", action="hesitate", arguments=["0.5"]) for _ in range(12)]
        for goal in goals:
            await goal.accepted()
        for goal in goals:
            client.cancel(goal)
        for goal in goals:
            assert (await goal.ended()).kind is OutcomeKind.CANCELED

    with_client(scenario, act=Binding(server=server, type=GROUND, accept=2.5))


def test_an_end_without_success_is_reported_when_the_world_has_been_asked(with_client, shared):
    asked, answered = asyncio.Event(), asyncio.Event()

    async def ended(request):
        asked.set()
        await answered.wait()

    async def scenario(client):
        assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED
        await asked.wait()
        asked.clear()
        aborted = client.send("act", action="abort")
        await aborted.accepted()
        await asked.wait()
        assert (await client.send("act", action="succeed").ended()).kind is OutcomeKind.SUCCEEDED
        assert aborted.reports.empty()
        answered.set()
        assert (await aborted.ended()).kind is OutcomeKind.ABORTED

    with_client(scenario, ended=ended, act=Binding(server=shared))


def test_nothing_is_sent_while_the_process_may_not_act_and_all_of_it_when_it_may(with_client, shared, ros):
    async def scenario(client):
        others, ends = Ros2ActionClient(ros, Bindings({"act": Binding(server=shared)}), asyncio.get_running_loop()), asyncio.Queue()
        running = client.send("act", action="hang")
        await running.accepted()
        client.may_act = False
        client.cancel(running)
        waiting = client.send("act", action="succeed")
        for _ in range(3):  # by another process, so to speak
            others.send(Request(uuid4(), GroundAction("act"), {"action": "succeed"}), ends.put_nowait)
            while not isinstance(await ends.get(), Ended):
                pass
        reports = [sent.reports.get_nowait() for sent in (running, waiting) if not sent.reports.empty()]
        assert all(isinstance(report, Postponed) for report in reports)
        client.may_act = True
        assert (await running.ended()).kind is OutcomeKind.CANCELED
        assert (await waiting.ended()).kind is OutcomeKind.SUCCEEDED
        others.close()

    with_client(scenario, act=Binding(server=shared))
