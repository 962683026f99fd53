"""Action servers that ask a person: answers, and questions that are withdrawn."""

from __future__ import annotations

import json

from tests.support.logic.people import Person
from tests.support.processes import LIMIT
from tests.support.ros.child_process import bounded
from tests.support.ros.fake_executor import fake_executor


@bounded
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
