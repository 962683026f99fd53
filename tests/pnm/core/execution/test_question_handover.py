"""What a person was asked is not asked again by the run that goes on."""

from __future__ import annotations

import asyncio
from uuid import UUID

import pytest

from pnm.core.execution.run import Run
from pnm.core.logic.computed_values import Layer
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.executor import Executor
from pnm.knowledge.sources.person_text import question_text
from tests.support.people import Person
from tests.support.runs.handover import ManualClient, carried, successor

ACT = GroundAction("act", resources=("arm",), duration=5.0)
ASKING = Bindings({"greet": Binding(goal={"word": "$word"}, ask={"word": "What shall I say to {whom}?"})})


def greet(whom: str) -> GroundAction:
    return GroundAction("greet", (whom,), parameters=("whom",))


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.mark.parametrize("moment", ["handled", "in the inbox", "later, while it is paused", "later"])
def test_what_a_person_is_asked_is_asked_once_whichever_run_goes_on(moment: str) -> None:
    person, loops = Person(question_text, Layer.PERSON), list[asyncio.Task[None]]()

    def scenario(executor: Executor, server: ManualClient) -> None:
        loops.append(asyncio.ensure_future(tell(executor, server)))

    async def tell(executor: Executor, server: ManualClient) -> None:
        def succeed() -> None:
            executor.succeed(successor(executor.run, GroundAction("first"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True))

        executor.pause()
        await settle()
        if moment == "handled":
            person.answer("What shall I say to ann?", "hello")
            await settle()
        elif moment == "in the inbox":
            person.answer("What shall I say to ann?", "hello")
            await asyncio.sleep(0)
        succeed()
        await settle()
        if moment == "later, while it is paused":
            person.answer("What shall I say to ann?", "hello")
            await settle()
        executor.succeed(successor_of_successor(executor.run))
        executor.resume()
        await settle()
        server.end("act")
        server.end("first")
        await settle()
        if moment == "later":
            person.answer("What shall I say to ann?", "hello")
            await settle()
        assert server.reporters["greet"][0].goal["word"] == "hello"
        server.end("greet")

    def successor_of_successor(run: Run) -> Run:
        return successor(run, GroundAction("first"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True, id=UUID(int=3))

    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert person.history == ["What shall I say to ann?"]
    assert not person.open
    loops[0].result()


def test_a_question_that_the_successor_does_not_ask_is_withdrawn() -> None:
    person = Person(question_text, Layer.PERSON)

    def scenario(executor: Executor, server: ManualClient) -> None:
        executor.succeed(successor(executor.run, greet("bob"), bindings=ASKING, asks=True))
        asyncio.get_running_loop().call_later(1, lambda: open_then.extend(person.open))
        asyncio.get_running_loop().call_later(2, person.answer, "What shall I say to bob?", "good day")
        asyncio.get_running_loop().call_later(3, server.end, "act")
        asyncio.get_running_loop().call_later(3, server.end, "greet")

    open_then: list[str] = []
    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert open_then == ["What shall I say to bob?"]
    assert person.history == ["What shall I say to ann?", "What shall I say to bob?"]


def test_an_answer_does_for_one_call() -> None:
    person = Person(question_text, Layer.PERSON)

    def scenario(executor: Executor, server: ManualClient) -> None:
        executor.pause()
        loop = asyncio.get_running_loop()
        loop.call_later(1, person.answer, "What shall I say to ann?", "hello")
        loop.call_later(2, lambda: executor.succeed(two(executor.run)))
        loop.call_later(3, executor.resume)
        loop.call_later(4, lambda: server.end("greet"))
        loop.call_later(5, person.answer, "What shall I say to ann?", "hello again")
        loop.call_later(6, lambda: words.append(server.reporters["greet"][0].goal["word"]))
        loop.call_later(7, lambda: server.end("greet"))
        loop.call_later(8, lambda: server.end("act"))

    def two(run: Run) -> Run:
        return successor(run, greet("ann"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True)

    words: list[object] = []
    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert person.history == ["What shall I say to ann?"] * 2
    assert words == ["hello again"]
