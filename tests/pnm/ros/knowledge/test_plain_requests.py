"""Requests for knowledge as servers in other languages send them, and the ids of goals."""

from __future__ import annotations

import asyncio
from uuid import UUID, uuid4

import pytest
from pnm_interfaces.srv import QueryKnowledge, UpdateKnowledge

from pnm.core.logic.computed_values import Layer
from pnm.knowledge.source import MemoryKnowledge
from pnm.knowledge.sources import Sources
from pnm.ros.knowledge import KnowledgeServices, may_be_ours, service_prefix, uuid_field
from pnm.ros.node.services import ServiceClient
from tests.support.logic.people import Person
from tests.support.processes import LIMIT
from tests.support.ros.child_process import bounded, run_bounded
from tests.support.ros.fake_executor import fake_executor

# --- from the side of servers in other languages ---


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"goal_id": uuid_field(UUID(int=5))}, "no goal 00000000-0000-0000-0000-000000000005 is being carried out for this executive"),
        ({"layer": 9}, "there is no layer 9; expected one of {0: 'local', 1: 'global', 2: 'all', 3: 'person'}"),
        ({"name": ""}, "the request names no variable"),
        ({"meta": "{"}, "'{' is not JSON"),
        ({"name": "odd"}, "JSON cannot say nan"),
        ({"name": "bug", "layer": 1}, "KeyError: 'bug'"),
        ({"layer": 3}, "nobody can be asked"),
    ],
    ids=lambda value: str(value)[:40],
)
@bounded
async def test_a_query_that_cannot_be_answered_is_refused(ros, fields, said):
    class Buggy(MemoryKnowledge):
        async def query(self, question, asker, /):
            raise KeyError(question.name)

    async with fake_executor(ros, [Buggy()]) as one:
        one.local.store({"odd": float("nan")})
        goal = one.new_id()
        one.goals[goal] = None
        client = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{one.name}/query")
        answer = await client.call({"goal_id": uuid_field(goal), "layer": 0, "name": "spam", **fields}, LIMIT)
        assert (answer.success, answer.found, answer.value) == (False, False, "")
        assert said in answer.message
        answer = await client.call({"goal_id": uuid_field(goal), "layer": 0, "name": "spam"}, LIMIT)
        assert (answer.success, answer.found, answer.value, answer.message) == (True, False, "", "")
        await client.close()


def test_who_repeats_a_question_to_a_person_gets_the_same_answer(ros):
    async def main():
        person = Person()
        async with fake_executor(ros, person=person) as one:
            goals = [one.new_id() for _ in range(2)]
            one.goals |= dict.fromkeys(goals)
            client = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{one.name}/query")

            def ask(goal, layer, name):
                return asyncio.ensure_future(client.call({"goal_id": uuid_field(goal), "layer": layer, "name": name}, LIMIT))

            await ask(goals[0], 0, "spam")
            same = [ask(goals[0], 3, "shop") for _ in range(2)]
            others = [ask(goals[1], 3, "shop"), ask(goals[0], 3, "stop")]
            questions = [await person.asked.get() for _ in range(3)]
            await ask(goals[0], 0, "spam")  # whatever was sent before has come
            assert sorted(questions) == ["shop", "shop", "stop"]
            assert person.asked.empty()
            one.services.end(goals[1])
            assert (await others[0]).message == "the goal is over, or the executive ends"
            del one.goals[goals[1]]
            person.answer("stop", 1)
            assert (await others[1]).value == "1"
            first = ask(goals[0], 3, "again")
            await person.asked.get()
            person.answer("again", 1)
            assert (await first).value == "1"
            second = ask(goals[0], 3, "again")
            await person.asked.get()
            person.answer("again", 2)
            assert (await second).value == "2", "what was answered is asked anew"
            one.services.end(goals[0])
            assert {answer.message for answer in await asyncio.gather(*same)} == {"the goal is over, or the executive ends"}
            await client.close()

    run_bounded(main())


@pytest.mark.parametrize("value", ["", "kitchen", "NaN"])
@bounded
async def test_an_update_with_what_is_no_json_is_refused(ros, value):
    async with fake_executor(ros) as one:
        goal = one.new_id()
        one.goals[goal] = None
        client = ServiceClient(ros, "pnm_interfaces/srv/UpdateKnowledge", f"{one.name}/update")
        answer = await client.call({"goal_id": uuid_field(goal), "layer": 2, "name": "spam", "value": value}, LIMIT)
        assert not answer.success
        assert "is not JSON" in answer.message
        assert one.local.variables() == {}
        await client.close()


@bounded
async def test_closing_refuses_what_is_still_being_asked(ros):
    person = Person()
    async with fake_executor(ros, person=person) as one:
        goal = one.new_id()
        one.goals[goal] = None
        client = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{one.name}/query")
        asking = asyncio.ensure_future(client.call({"goal_id": uuid_field(goal), "layer": 3, "name": "spam"}, LIMIT))
        await person.asked.get()
    answer = await asking
    assert (answer.success, answer.message) == (False, "the goal is over, or the executive ends")
    assert person.withdrawn.get_nowait() == "spam"
    await client.close()


@bounded
async def test_an_executive_whose_loop_has_ended_refuses(ros, names):
    loop = asyncio.new_event_loop()
    loop.close()
    name = names()

    services = KnowledgeServices(ros, loop, name, lambda goal: None, Sources())
    await services.open()
    client = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{name}/query")
    answer = await client.call({"name": "spam"}, LIMIT)
    assert (answer.success, answer.message) == (False, "the executive has ended")
    await services.close()
    await client.close()


# --- ids ---


def test_ids_say_where_to_ask():
    goal = UUID("0123abcd-0000-5000-8000-000000000000")
    assert service_prefix(goal.bytes) == "/pnm_0123abcd"
    assert may_be_ours(goal.bytes)
    assert not may_be_ours(uuid4().bytes)
    assert not may_be_ours(bytes(16))


def test_the_layers_of_the_interfaces_are_those_of_queries():
    from pnm.ros.knowledge import LAYERS

    for kind in (QueryKnowledge.Request, UpdateKnowledge.Request):
        assert [LAYERS[getattr(kind, layer.name)] for layer in Layer] == list(Layer)
