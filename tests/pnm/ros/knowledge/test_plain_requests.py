"""Requests for knowledge as servers in other languages send them, and the ids of goals."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any
from uuid import UUID, uuid4

import pytest

from pnm.knowledge.source import MemoryKnowledge
from pnm.knowledge.sources import Sources
from pnm.ros.knowledge import KnowledgeServices, may_be_ours, service_prefix
from pnm.ros.node.services import ServiceClient
from tests.support.logic.people import Person
from tests.support.processes import LIMIT
from tests.support.ros.fake_executor import FakeExecutor, fake_executor


@asynccontextmanager
async def requests(one: FakeExecutor, goals: int = 1, service: str = "query") -> AsyncIterator[tuple[list[UUID], Callable[..., Any]]]:
    """Goals of an executor, and how to ask about the first one or, with other fields, something else."""
    ids = [one.new_id() for _ in range(goals)]
    one.goals |= dict.fromkeys(ids)
    client = ServiceClient(one.ros, f"pnm_interfaces/srv/{service.capitalize()}Knowledge", f"{one.name}/{service}")
    usual = {"goal_id": ids[0], "layer": 0, "name": "spam"}
    yield ids, lambda **fields: asyncio.ensure_future(client.call({**usual, **fields}, LIMIT))
    await client.close()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"goal_id": UUID(int=5)}, "no goal 00000000-0000-0000-0000-000000000005 is being carried out for this executive"),
        ({"layer": 9}, "there is no layer 9; expected one of {0: 'local', 1: 'global', 2: 'all', 3: 'person'}"),
        ({"name": ""}, "the request names no variable"),
        ({"meta": "{"}, "'{' is not JSON"),
        ({"name": "odd"}, "JSON cannot say nan"),
        ({"name": "bug", "layer": 1}, "KeyError: 'bug'"),
        ({"layer": 3}, "nobody can be asked"),
    ],
    ids=lambda value: str(value)[:40],
)
async def test_a_query_that_cannot_be_answered_is_refused(ros, fields, said):
    class Buggy(MemoryKnowledge):
        async def query(self, question, asker, /):
            raise KeyError(question.name)

    async with fake_executor(ros, [Buggy()]) as one, requests(one) as (_, ask):
        one.local.store({"odd": float("nan")})
        answer = await ask(**fields)
        assert (answer.success, answer.found, answer.value) == (False, False, "")
        assert said in answer.message
        answer = await ask()
        assert (answer.success, answer.found, answer.value, answer.message) == (True, False, "", "")


async def test_who_repeats_a_question_to_a_person_gets_the_same_answer(ros):
    person = Person()
    async with fake_executor(ros, person=person) as one, requests(one, 2) as (goals, ask):
        await ask()
        same = [ask(layer=3, name="shop") for _ in range(2)]
        others = [ask(goal_id=goals[1], layer=3, name="shop"), ask(layer=3, name="stop")]
        questions = [await person.asked.get() for _ in range(3)]
        await ask()  # whatever was sent before has come
        assert sorted(questions) == ["shop", "shop", "stop"]
        assert person.asked.empty()
        one.services.end(goals[1])
        assert (await others[0]).message == "the goal is over, or the executive ends"
        person.answer("stop", 1)
        assert (await others[1]).value == "1"
        for answer in ("1", "2"):  # what was answered is asked anew
            again = ask(layer=3, name="again")
            await person.asked.get()
            person.answer("again", int(answer))
            assert (await again).value == answer
        one.services.end(goals[0])
        assert {answer.message for answer in await asyncio.gather(*same)} == {"the goal is over, or the executive ends"}


async def test_an_update_with_what_is_no_json_is_refused(ros):
    async with fake_executor(ros) as one, requests(one, service="update") as (_, tell):
        for value in ("", "kitchen", "NaN"):
            answer = await tell(layer=2, value=value)
            assert not answer.success
            assert "is not JSON" in answer.message
        assert one.local.variables() == {}


async def test_closing_refuses_what_is_still_being_asked(ros):
    person = Person()
    one = FakeExecutor(ros, Sources([MemoryKnowledge()], person))
    await one.services.open()
    async with requests(one) as (_, ask):
        asking = ask(layer=3)
        await person.asked.get()
        await one.close()
        answer = await asking
        assert (answer.success, answer.message) == (False, "the goal is over, or the executive ends")
        assert person.withdrawn.get_nowait() == "spam"


async def test_an_executive_whose_loop_has_ended_refuses(ros, name):
    loop = asyncio.new_event_loop()
    loop.close()
    services = KnowledgeServices(ros, loop, name, lambda goal: None, Sources())
    await services.open()
    client = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{name}/query")
    answer = await client.call({"name": "spam"}, LIMIT)
    assert (answer.success, answer.message) == (False, "the executive has ended")
    await services.close()
    await client.close()


def test_ids_say_where_to_ask():
    goal = UUID("0123abcd-0000-5000-8000-000000000000")
    assert service_prefix(goal.bytes) == "/pnm_0123abcd"
    assert may_be_ours(goal.bytes)
    assert not may_be_ours(uuid4().bytes)
    assert not may_be_ours(bytes(16))
