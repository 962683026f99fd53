"""Questions hold nothing up: timers behind them go on, nothing is asked while resources are held, and every wait has a limit."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from functools import partial
from typing import TypeVar
from uuid import UUID

import pytest

from pnm.core.execution.events import Ask, Begin, Command, Send, Stop, Tick, Wake, Withdraw
from pnm.core.execution.questions import LIMITS
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from pnm.knowledge.people import question_text
from tests.support.logic.people import Person
from tests.support.runs.commands import RUN
from tests.support.runs.handover import SUCCEEDED, ManualClient, carried, successor
from tests.support.yaml.programs import only_plan

TELLING = "actions: {tell: {params: [what], ask: {what: Which one}}}\nplan:\n  - tell:\n"


def started(text: str) -> tuple[Run, list[Command]]:
    """The run of a plan, begun, and its commands."""
    plan = only_plan(text)
    machine = generate(plan.graph, plan.bindings)
    verify(machine)
    run = Run(machine, Layered(KnowledgeBase(), KnowledgeBase(variables=plan.variables)), id=RUN, bindings=plan.bindings, asks=True)
    return run, run.handle(Begin(), 0.0)


def wait(run: Run, commands: list[Command]) -> tuple[float, list[Command]]:
    """Let time pass, and nothing else happen, until the run is over; return when that is, and what it wanted done."""
    done, now, left = [*commands], 0.0, [*commands]
    while not run.over:
        wakes = [command.at for command in left if isinstance(command, Wake)]
        assert wakes, "it waits for ever"
        now = wakes[-1]
        left = run.handle(Tick(), now)
        done += left
    return now, done


C = TypeVar("C")


def of_type(commands: Iterable[Command], kind: type[C]) -> list[C]:
    return [command for command in commands if isinstance(command, kind)]


def test_a_deadline_passes_while_a_person_is_asked() -> None:
    run, commands = started(f"{TELLING}    deadline: 5\n")
    now, commands = wait(run, commands)
    assert now == 5.0
    assert run.result().failures[0].cause is Cause.TOO_LATE
    assert [ask.id for ask in of_type(commands, Ask)][-1:] == [withdrawn.id for withdrawn in of_type(commands, Withdraw)]


def test_a_question_has_a_limit_in_the_run() -> None:
    run, commands = started(TELLING)
    now, commands = wait(run, commands)
    assert now == LIMITS[Layer.GLOBAL] + LIMITS[Layer.PERSON]
    failure = run.result().failures[0]
    assert failure.cause is Cause.DATA_MISSING
    assert "was not answered within 3600 s" in failure.observed
    assert len(of_type(commands, Ask)) == len(of_type(commands, Withdraw)) == 2


def test_nothing_is_asked_while_resources_are_held() -> None:
    run, commands = started(
        "actions:\n  grasp:\n    resources: [arm]\n    recoveries: {after: {when: {PersonQuery: dropped}, do: skip_action}}\n"
        "plan: [concurrent_actions: [grasp: , grasp: ]]\n"
    )
    asked = 0
    while sends := of_type(commands, Send):
        (request,) = [one.request.id for one in sends]
        assert len(run.resources.held) == 1
        run.handle(Accepted(request), 1.0)
        commands = run.handle(Ended(request, SUCCEEDED), 1.0)
        asked += len(of_type(commands, Ask))
        assert all(claim.request != request for claim in run.resources.held)
    assert asked == 2
    assert not run.resources.held


def test_a_run_that_is_stopped_asks_nobody_any_more() -> None:
    run, _ = started("actions:\n  look: {recoveries: {after: {when: {PersonQuery: wrong}, do: skip_action}}}\nplan: [look: ]\n")
    assert of_type(run.handle(Ended(run.open_requests[0], SUCCEEDED), 1.0), Ask)
    assert of_type(run.handle(Stop(), 2.0), Withdraw)
    assert run.over


# --- what a person was asked is not asked again by the run that goes on ---

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
        async def answer_if(now: str) -> None:
            if moment == now:
                person.answer("What shall I say to ann?", "hello")
                await (asyncio.sleep(0) if now == "in the inbox" else settle())

        def succeed(number: int) -> None:
            calls = GroundAction("first"), greet("ann")
            executor.succeed(successor(executor.run, *calls, orders=("1e<2s",), bindings=ASKING, asks=True, id=UUID(int=number)))

        executor.pause()
        await settle()
        await answer_if("handled")
        await answer_if("in the inbox")
        succeed(2)
        await settle()
        await answer_if("later, while it is paused")
        succeed(3)
        executor.resume()
        await settle()
        server.end("act")
        server.end("first")
        await settle()
        await answer_if("later")
        assert server.reporters["greet"][0].goal["word"] == "hello"
        server.end("greet")

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
        deeds = (
            partial(person.answer, "What shall I say to ann?", "hello"),
            lambda: executor.succeed(two(executor.run)),
            executor.resume,
            partial(server.end, "greet"),
            partial(person.answer, "What shall I say to ann?", "hello again"),
            lambda: words.append(server.reporters["greet"][0].goal["word"]),
            partial(server.end, "greet"),
            partial(server.end, "act"),
        )
        for second, deed in enumerate(deeds, 1):
            asyncio.get_running_loop().call_later(second, deed)

    def two(run: Run) -> Run:
        return successor(run, greet("ann"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True)

    words: list[object] = []
    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert person.history == ["What shall I say to ann?"] * 2
    assert words == ["hello again"]
