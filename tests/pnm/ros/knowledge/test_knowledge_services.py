"""What action servers in other processes ask while they carry out a goal, and what they are told."""

from __future__ import annotations

import asyncio
import json
from uuid import uuid4

import pytest
from pnm_interfaces.srv import QueryKnowledge, UpdateKnowledge
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.core.machine.requests import OutcomeKind
from pnm.knowledge.source import Asker, MemoryKnowledge, SourceError
from pnm.knowledge.sources import Sources
from tests.support.logic.people import Person
from tests.support.processes import LIMIT
from tests.support.ros.child_process import OURS, Within
from tests.support.ros.fake_executor import FakeExecutor, fake_executor


@pytest.fixture
def one(ros):
    """An executor with global knowledge in memory."""
    return Within(fake_executor(ros))


async def test_local_and_global_and_both(one, server):
    assert await one.said(server, "query", "all", "spam") == []
    assert await one.said(server, "update", "local", "spam", {"eggs": [1, 2.5, None, "ü"]}) == [None]
    assert one.local.variable("spam") == {"eggs": [1, 2.5, None, "ü"]}
    assert await one.said(server, "query", "local", "spam") == [{"eggs": [1, 2.5, None, "ü"]}]
    assert await one.said(server, "query", "global", "spam") == []
    assert await one.said(server, "update", "global", "spam", False) == [None]
    assert await one.said(server, "query", "all", "spam") == [{"eggs": [1, 2.5, None, "ü"]}]
    assert await one.said(server, "query", "global", "spam") == [False]
    assert await one.said(server, "update", "all", "both", 0) == [None]
    assert [await one.said(server, "query", layer, "both") for layer in ("local", "global")] == [[0], [0]]


async def test_every_kind_of_server_may_ask_whatever_spins_it(ros, names, begin, server):
    many = await asyncio.to_thread(begin, "asking_server", names(), "8")
    async with fake_executor(ros) as one:
        for name in (server, f"{server}_coroutine", many.name, f"{many.name}_coroutine"):
            ended = [one.send(name, "update", "all", f"v{number}", [name, number]) for number in range(20)]
            assert {outcome.message for outcome in await asyncio.gather(*ended)} == {"[null]"}
            assert one.local.variables() == {f"v{number}": [name, number] for number in range(20)}
            assert await one.said(name, "query", "all", "v7") == [[name, 7]]


async def test_the_example_of_the_documentation(one, server):
    await one.sources.update(Question("shop", Layer.GLOBAL, "null"), "bakery", Asker(one.run))
    assert (await one.send("guide", "lead")).kind is OutcomeKind.SUCCEEDED
    assert one.local.variables() == {"seen": ["bakery"]}


async def test_waiting_on_the_thread_that_spins_is_refused_at_once(one, server):
    for wanted in (("query", "all", "a"), ("update", "all", "a", 1)):
        assert "in a coroutine, await the ..._async method" in await one.said(f"{server}_wrong", *wanted)


async def test_a_goal_of_somebody_else_is_carried_out_and_has_no_knowledge(one, server):
    outcome = await one.send(server, "query", "all", "spam", id=uuid4())
    assert outcome.kind is OutcomeKind.SUCCEEDED
    assert "the goal does not come from a plan executive" in outcome.message


async def test_an_executive_without_services_is_missed_by_name(ros, server):
    one = FakeExecutor(ros, Sources())
    for action, rest in (("query", []), ("update", [1])):
        said = await one.said(server, action, "all", "spam", *rest, None, 0.5)
        assert said == f"there is no service {one.name}/{action}; the executive that has sent the goal is gone"
    await one.close()


async def test_an_executive_is_asked_again_until_it_has_answered_once_but_told_once(ros, server):
    def deaf(heard):
        async def answer(request, response):
            heard.append(request.name)
            if len(heard) == 1:
                await Future()
            response.success = True
            return response

        return answer

    one = FakeExecutor(ros, Sources())
    heard = {kind: [] for kind in (QueryKnowledge, UpdateKnowledge)}
    names = {QueryKnowledge: f"{one.name}/query", UpdateKnowledge: f"{one.name}/update"}

    def offer():
        group = ReentrantCallbackGroup()
        return [ros.node.create_service(kind, names[kind], deaf(heard[kind]), callback_group=group) for kind in heard]

    services = await ros.ask(offer)
    assert await one.said(server, "query", "all", "spam", None, LIMIT) == []
    assert await one.said(server, "update", "person", "spam", 1, None, 1.5) == f"{one.name}/update did not answer within 1.5 s"
    assert len(heard[QueryKnowledge]) >= 2
    assert len(heard[UpdateKnowledge]) == 1
    await ros.ask(lambda: [ros.node.destroy_service(service) for service in services])
    await one.close()


async def test_a_global_source_that_never_answers_is_said_to_the_server(ros, server):
    class Never(MemoryKnowledge):
        async def query(self, question, asker, /):
            return await asyncio.get_running_loop().create_future()

    async with fake_executor(ros, [Never()]) as one:
        assert await one.said(server, "query", "all", "spam", None, 0.5) == "there was no answer within 0.5 s"


async def test_what_a_source_refuses_is_said_to_the_server_and_changes_nothing(ros, server):
    class Full(MemoryKnowledge):
        async def update(self, question, value, asker, /):
            raise SourceError("the disk\nis full")

    async with fake_executor(ros, [Full()]) as one:
        assert await one.said(server, "update", "all", "spam", 1) == "the disk is full"
        assert one.local.variable("spam") is MISSING


@pytest.mark.parametrize("kind", ["", "_coroutine"])
async def test_cancelling_a_goal_that_asks_ends_it_and_withdraws_the_question(ros, server, kind):
    person, name = Person(), f"{server}{kind}"
    async with fake_executor(ros, person=person) as one:
        await one.meet(name)
        goal = one.new_id()
        ended = one.send(name, "query", "person", "shop", None, 300.0, id=goal)
        await person.asked.get()
        one.client(name).ros2.cancel(goal)
        outcome = await ended
        assert (outcome.kind, outcome.message) == (OutcomeKind.CANCELED, '"the goal is being cancelled"')
        assert await person.withdrawn.get() == "shop"


async def test_a_person_is_asked_while_others_go_on(ros, server):
    person = Person()
    async with fake_executor(ros, person=person) as one:
        first = one.send(server, "query", "person", "shop", "Which shop?", LIMIT)
        second = one.send(server, "query", "global", "USER", None, LIMIT)
        assert {await person.asked.get(), await person.asked.get()} == {"shop", "USER"}
        assert {asker.plan for asker in person.askers} == {"tour"}
        assert await one.said(server, "update", "local", "spam", 1) == [None], "a question that is open holds up no other request"
        person.answer("USER", "later")
        assert json.loads((await second).message) == ["later"]
        assert not first.done()
        person.answer("shop", "bakery")
        assert json.loads((await first).message) == ["bakery"]
        assert await one.said(server, "update", "person", "shop", "thanks", {"mood": 1}) == [None]
        assert await person.asked.get() == 'shop: thanks {"mood": 1}'


@pytest.mark.parametrize("action", ["raise", "return"])
async def test_a_callback_that_fails_aborts_its_goal_and_nothing_more(one, server, action):
    assert (await one.send(server, action)).kind is OutcomeKind.ABORTED
    assert await one.said(server, "query", "all", "spam") == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("query", 2, "spam"), "2 is not one of Layer.LOCAL, Layer.GLOBAL, Layer.ALL, Layer.PERSON"),
        (("update", "local", "spam", float("nan")), "JSON cannot say nan: Out of range float values are not JSON compliant"),
        (("query", "local", "spam", [float("inf")]), "JSON cannot say [inf]"),
    ],
)
async def test_a_server_that_asks_nonsense_is_told_so(one, server, arguments, said):
    assert said in await one.said(server, *arguments)


async def test_a_server_that_ends_while_it_asks_leaves_no_traceback_of_ours(ros, names, begin):
    server = await asyncio.to_thread(begin, "asking_server", names())
    person = Person()
    async with fake_executor(ros, person=person) as one:
        await one.meet(server.name)
        ended = one.send(server.name, "query", "person", "a", None, LIMIT)
        await person.asked.get()
        assert OURS not in await asyncio.to_thread(server.stop)
        assert (await ended).kind in (OutcomeKind.LOST, OutcomeKind.UNAVAILABLE)
