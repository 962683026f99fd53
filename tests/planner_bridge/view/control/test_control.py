"""Controls of the page: who may use them, what they do, and what a refusal says."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from uuid import UUID, uuid4

import pytest

from planner_bridge.explanations.goal_now import packed
from planner_bridge.pipeline.loading import load
from planner_bridge.view import serving
from planner_bridge.view.serving import Controlled, Operator, PageProcess, Reply
from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic.conditions import Holds
from pnm.core.machine.requests import Accepted, Feedback
from pnm.errors import InputError
from pnm.journal.records import Happened
from pnm.tasks import TaskState
from tests.support.e2e.page.journals import GrowingJournal, steps
from tests.support.e2e.page.serving import asked
from tests.support.files import ROOT
from tests.support.tasks.fake_tasks import FakeTasks, FakeWorld


@dataclass
class ControlledPage:
    """A page in a process of its own, and the tasks that it controls."""

    page: PageProcess
    tasks: FakeTasks
    world: FakeWorld

    @property
    def token(self) -> str:
        return urlsplit(self.page.url).fragment.removeprefix("token=")

    async def send(self, command: object, method: str = "POST", **headers: str) -> tuple[int, dict[str, Any]]:
        """Send a command as the page does; headers come before its own."""
        own = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        body = None if method == "GET" else json.dumps(command)
        status, _, text = await asyncio.to_thread(asked, self.page.url, "/control", method, body, **{**own, **headers})
        return status, json.loads(text)


@asynccontextmanager
async def page_with(what: Controlled, delivery: Path, world: FakeWorld | None = None) -> AsyncIterator[ControlledPage]:
    tasks = FakeTasks()
    page = await asyncio.to_thread(PageProcess, 0, what)
    try:
        page.follow(str(delivery))
        controlled = ControlledPage(page, tasks, world or FakeWorld(KnowledgeBase()))
        page.operate(Operator(tasks, tasks, controlled.world if what is Controlled.NODE else None))
        yield controlled
    finally:
        await asyncio.to_thread(page.close)


async def begun(controlled: ControlledPage, text: str = "running") -> UUID:
    """Begin a task over the page; return its id."""
    assert await controlled.send({"do": "goal", "goal": text}) == (200, {"refused": "", "line": 0, "column": 0})
    return controlled.tasks.wanted[-1].id


def test_a_goal_is_sent_and_its_task_is_paused_resumed_and_cancelled(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            task = await begun(controlled)
            for word, state in (("pause", TaskState.PAUSED), ("resume", TaskState.RUNNING)):
                assert (await controlled.send({"do": word, "task": str(task)}))[0] == 200
                assert controlled.tasks.open[task].state is state
            assert (await controlled.send({"do": "cancel", "task": task.hex}))[0] == 200
            assert task not in controlled.tasks.open

    asyncio.run(use())


def test_what_else_an_operator_says_reaches_the_tasks_and_the_world(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            task, id = await begun(controlled), uuid4()
            for command in (
                {"do": "step", "task": str(task)},
                {"do": "settle", "request": id.hex, "is_done": True},
                {"do": "settle", "request": id.hex, "is_done": False},
                {"do": "answer", "question": id.hex, "text": "5"},
                {"do": "answer", "question": id.hex, "text": "the kitchen"},
                {"do": "answer", "question": id.hex, "text": " "},
                {"do": "tell", "add": ["(at r1 hall)"]},
            ):
                assert (await controlled.send(command))[0] == 200
            answers = [("answer", id, "5"), ("answer", id, "the kitchen"), ("answer", id, " ")]
            assert controlled.tasks.said == [("step", task), ("settle", id, True), ("settle", id, False), *answers]
            known = controlled.world.knowledge
            assert known.facts() == {("at", "r1", "hall"): True}
            status, reply = await controlled.send({"do": "answer", "question": id.hex, "text": "[1"})
            assert (status, "is not JSON" in reply["refused"]) == (409, True)

    asyncio.run(use())


def test_what_is_refused_is_said_in_a_sentence(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            assert await controlled.send({"do": "goal", "goal": "nonsense"}) == (
                409,
                {"refused": "there is no predicate 'nonsense' here", "line": 1, "column": 1},
            )
            assert not controlled.tasks.wanted
            status, reply = await controlled.send({"do": "pause", "task": str(uuid4())})
            assert (status, "there is no task" in reply["refused"]) == (409, True)
            task = await begun(controlled)
            status, reply = await controlled.send({"do": "resume", "task": str(task)})
            assert (status, "is not paused" in reply["refused"]) == (409, True)

    asyncio.run(use())


@pytest.mark.parametrize("given", ["", "Bearer ", "Bearer wrong", "Bearer {token}x", "Basic {token}", "bearer {token}", "Bearer \xe9"])
def test_without_the_token_nothing_is_done_nor_told(given: str, delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            for method in ("GET", "POST"):
                status, reply = await controlled.send(
                    {"do": "goal", "goal": "running"}, method, Authorization=given.format(token=controlled.token)
                )
                assert status == 403
                assert "token" in reply["refused"]
            assert not controlled.tasks.wanted

    asyncio.run(use())


def test_requests_of_other_pages_are_refused_even_with_the_token(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            command = {"do": "goal", "goal": "running"}
            for header, value, expected in (
                ("Origin", "http://evil.example", 403),
                ("Host", "evil.example", 421),
                ("Content-Type", "text/plain", 415),
            ):
                status, _, _ = await asyncio.to_thread(
                    asked,
                    controlled.page.url,
                    "/control",
                    "POST",
                    json.dumps(command),
                    **{"Authorization": f"Bearer {controlled.token}", "Content-Type": "application/json", header: value},
                )
                assert status == expected
            assert not controlled.tasks.wanted

    asyncio.run(use())


def test_what_is_nested_deeper_than_any_command_is_refused_and_nothing_else_suffers(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery) as controlled:
            headers = {"Authorization": f"Bearer {controlled.token}", "Content-Type": "application/json"}
            for depth in (10, 900, 940, *range(950, 1000, 5), 100_000):
                body = f'{{"do": "check", "goal": {"[" * depth}{"]" * depth}}}'
                assert (await asyncio.to_thread(asked, controlled.page.url, "/control", "POST", body, **headers))[0] == 400
            await begun(controlled)

    asyncio.run(use())


def test_a_page_without_controls_has_no_token_and_says_how_to_get_one(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NOTHING, delivery) as controlled:
            assert urlsplit(controlled.page.url).fragment == ""
            status, reply = await controlled.send({"do": "pause"}, Authorization="Bearer ")
            assert (status, "--view-controls" in reply["refused"]) == (403, True)

    asyncio.run(use())


def test_a_run_takes_no_goals(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.RUN, delivery) as controlled:
            assert await controlled.send(None, "GET") == (200, {"what": "run"})
            status, reply = await controlled.send({"do": "goal", "goal": "running"})
            assert (status, "`pnm serve`" in reply["refused"]) == (409, True)

    asyncio.run(use())


def test_when_the_tasks_are_over_that_is_said(delivery: Path) -> None:
    page = PageProcess(0, Controlled.RUN)
    with page:
        page.follow(str(delivery))

        async def send(command: object) -> tuple[int, dict[str, Any]]:
            return await ControlledPage(page, FakeTasks(), FakeWorld(KnowledgeBase())).send(command)

        assert "nothing yet" in asyncio.run(send({"do": "pause"}))[1]["refused"]

        async def operate() -> None:
            page.operate(Operator(FakeTasks(), FakeTasks()))

        asyncio.run(operate())
        assert "it is over" in asyncio.run(send({"do": "pause"}))[1]["refused"]


class DeliveryWorld(FakeWorld):
    """The world of the deliveries that the journal tells of."""

    async def pack(self, goal: str, /) -> str:
        problem = load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")
        return "x" * 100_000 if goal == "(large)" else packed(replace(problem, goal=Holds(parse_fluent(goal))))


def test_why_a_goal_cannot_be_reached_is_a_tree_that_ends_at_the_closed_door(delivery: Path) -> None:
    async def use() -> None:
        async with page_with(Controlled.NODE, delivery, DeliveryWorld(KnowledgeBase())) as controlled:
            status, told = await controlled.send({"do": "why", "goal": "(at parcel1 yard)"})
            assert (status, [*told]) == (200, ["answers"])
            reason, help_ = told["answers"]
            assert reason["statement"] == "there is no plan: (at parcel1 yard) cannot be reached"
            ends = [answer["statement"] for answer in every(reason) if not answer["reasons"]]
            assert "(takes_parcels yard) is false, and no action changes that" in ends
            assert any("(takes_parcels yard) were true: a plan with" in answer["statement"] for answer in every(help_))
            status, told = await controlled.send({"do": "why", "goal": "(large)"})
            assert (status, "too large to be explained here" in told["refused"]) == (409, True)
            assert (await controlled.send({"do": "why", "goal": ""}, Authorization="Bearer wrong"))[0] == 403

    asyncio.run(use())


def test_what_is_explained_counts_on_what_is_under_way(delivery: Path, growing: GrowingJournal) -> None:
    """While a robot moves it is nowhere, so that it could never be anywhere again."""
    moving = next(
        step.number
        for step in steps(delivery)
        if isinstance(step.record, Happened) and isinstance(step.record.event, Feedback | Accepted) and step.time > 4.0
    )
    growing.grow(moving)

    async def use() -> None:
        async with page_with(Controlled.NODE, growing.place, DeliveryWorld(KnowledgeBase())) as controlled:
            (plan,) = (await controlled.send({"do": "why", "goal": "(at r1 yard)"}))[1]["answers"]
            assert plan["statement"].startswith("there is a plan with ")

    asyncio.run(use())


def every(answer: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield answer
    for reason in answer["reasons"]:
        yield from every(reason)


def test_a_refusal_that_takes_its_time_is_no_consent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_SOON", 0.0)

    class SlowWorld(FakeWorld):
        async def check_goal(self, text: str, /) -> None:
            await asyncio.sleep(0.01)
            raise InputError(f"there is no {text}")

    async def course() -> Reply:
        tasks = FakeTasks()
        return await Operator(tasks, tasks, SlowWorld(KnowledgeBase())).reply({"do": "goal", "goal": "x" * 2000})

    reply = asyncio.run(course())
    assert reply.refused.startswith("there is no xxx")
    assert len(json.dumps(reply.as_json())) < 1500, "many of them fit into a pipe"
