"""Controls of the page: who may use them, what they do, and what a refusal says."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from uuid import uuid4

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
from tests.support.e2e.page.serving import asked, page_of
from tests.support.files import ROOT
from tests.support.tasks.fake_tasks import FakeTasks, FakeWorld

# --- what an operator does with commands ---------------------------------------------------------


def replies(tasks: FakeTasks, world: FakeWorld, *commands: object) -> list[str]:
    """What is refused of commands that are given one after the other, and why."""

    async def course() -> list[str]:
        operator = Operator(tasks, tasks, world)
        return [(await operator.reply(command)).refused for command in commands]

    return asyncio.run(course())


@pytest.mark.parametrize(
    "command",
    [
        None,
        [],
        "pause",
        {},
        {"do": "explode"},
        {"do": ["pause"]},
        {"do": "pause", "task": "x"},
        {"do": "pause", "task": 7},
        {"do": "pause", "at_once": "yes"},
        {"do": "step"},
        {"do": "settle", "request": "1", "is_done": True},
        {"do": "settle", "request": "00000000000000000000000000000001"},
        {"do": "tell", "add": "(at r1 hall)"},
        {"do": "tell", "add": [1]},
        {"do": "tell", "add": ["\udcff"]},
        {"do": "goal", "goal": 5},
        {"do": "goal", "goal": "x" * 100_001},
        {"do": "goal", "goal": "\ud800"},
        {"do": "goal", "goal": "", "priority": 1.5},
        {"do": "goal", "goal": "", "priority": 2**31},
        {"do": "start", "plan": "none"},
        {"do": "start", "plan": "round", "given": ["rounds"]},
        {"do": "start", "plan": "round", "given": {"rounds": 3}},
    ],
)
def test_what_is_no_command_is_refused(command: object) -> None:
    tasks = FakeTasks()
    (refused,) = replies(tasks, FakeWorld(KnowledgeBase()), command)
    assert refused.startswith("expected")
    assert (tasks.wanted, tasks.said) == ([], [])


def test_what_a_person_says_reaches_the_tasks_and_the_world() -> None:
    tasks, world, id = FakeTasks(), FakeWorld(KnowledgeBase()), uuid4()
    assert replies(tasks, world, {"do": "goal", "goal": "running"}) == [""]
    (task,) = tasks.open
    for word, state in (("pause", TaskState.PAUSED), ("resume", TaskState.RUNNING)):
        assert replies(tasks, world, {"do": word, "task": str(task)}) == [""]
        assert tasks.open[task].state is state
    said = replies(
        tasks,
        world,
        {"do": "step", "task": str(task)},
        {"do": "settle", "request": id.hex, "is_done": True},
        {"do": "settle", "request": id.hex, "is_done": False},
        {"do": "answer", "question": id.hex, "text": "the kitchen"},
        {"do": "tell", "add": ["(at r1 hall)"]},
        {"do": "take", "name": "r1", "reason": "stuck"},
        {"do": "take", "name": "r2"},
        {"do": "give", "name": "r2"},
        {"do": "cancel", "task": task.hex},
    )
    assert (set(said), task in tasks.open) == ({""}, False)
    assert [(hand.name, hand.reason) for hand in tasks.in_hands] == [("r1", "stuck")]
    assert replies(tasks, world, {"do": "take", "name": "r1"}, {"do": "take", "name": "stubborn"}) == ["r1 is taken", "it may still move"]
    assert tasks.said == [("step", task), ("settle", id, True), ("settle", id, False), ("answer", id, "the kitchen")]
    assert world.knowledge.facts() == {("at", "r1", "hall"): True}


def test_plans_by_hand_are_told_with_their_parameters_and_started_with_values_in_yaml() -> None:
    tasks = FakeTasks()

    async def course() -> tuple[Reply, Reply]:
        operator = Operator(tasks, tasks, FakeWorld(KnowledgeBase()))
        started = {"do": "start", "plan": "round", "given": {"rounds": "3", "place": "the hall"}}
        return await operator.reply({"do": "plans"}), await operator.reply(started)

    told, started = asyncio.run(course())
    assert (told.plans, started.refused) == ({"empty": {}, "round": {"rounds": "2", "place": None}}, "")
    (wanted,) = tasks.wanted
    assert (wanted.text, wanted.is_plan, wanted.parameters) == ("round", True, {"rounds": 3, "place": "the hall"})


def test_what_is_refused_is_said_in_a_sentence() -> None:
    tasks, task = FakeTasks(), {"task": str(uuid4())}
    refused = replies(
        tasks, FakeWorld(KnowledgeBase()), {"do": "pause"} | task, {"do": "answer", "question": uuid4().hex, "text": "[1"}, {"do": "why"}
    )
    for said, sentence in zip(refused, ("there is no task", "is not JSON", "there is no problem here"), strict=True):
        assert sentence in said


def test_a_refusal_that_takes_its_time_is_no_consent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_SOON", 0.0)

    class SlowWorld(FakeWorld):
        async def check_goal(self, text: str, /) -> None:
            await asyncio.sleep(0.01)
            raise InputError(f"there is no {text}")

    (refused,) = replies(FakeTasks(), SlowWorld(KnowledgeBase()), {"do": "goal", "goal": "x" * 2000})
    assert refused.startswith("there is no xxx")
    assert len(json.dumps(Reply(refused).as_json())) < 1500, "many of them fit into a pipe"


# --- the way from a browser ----------------------------------------------------------------------


class DeliveryWorld(FakeWorld):
    """The world of the deliveries that the journal tells of."""

    async def pack(self, goal: str, /) -> str:
        problem = load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")
        return "x" * 100_000 if goal == "(large)" else packed(replace(problem, goal=Holds(parse_fluent(goal))))


@dataclass
class ControlledPage:
    """A page in a process of its own, and the tasks that it controls."""

    page: PageProcess
    tasks: FakeTasks

    @property
    def token(self) -> str:
        return urlsplit(self.page.url).fragment.removeprefix("token=")

    def send(self, command: object, method: str = "POST", **headers: str) -> tuple[int, dict[str, Any]]:
        """Send a command, or the text of one, as the page does; headers come before its own."""
        own = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        body = None if method == "GET" else command if isinstance(command, str) else json.dumps(command)
        status, _, text = asked(self.page.url, "/control", method, body, **{**own, **headers})
        return status, json.loads(text)


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    """The event loop of the tasks, on a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    yield loop
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


async def operate(page: PageProcess, tasks: FakeTasks, world: FakeWorld | None = None) -> None:
    """Have an operator carry out what people want on the page."""
    page.operate(Operator(tasks, tasks, world))


@pytest.fixture(scope="module")
def served(delivery: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageProcess]:
    """The page of a node whose robots are on their ways."""
    happened = ((step.number, step.record, step.time) for step in steps(delivery) if isinstance(step.record, Happened))
    moving = next(number for number, record, time in happened if isinstance(record.event, Feedback | Accepted) and time > 4.0)
    with closing(GrowingJournal(delivery, tmp_path_factory.mktemp("node") / "journal")) as journal:
        journal.grow(moving)
    with PageProcess(0, Controlled.NODE) as page:
        page.follow(str(journal.place))
        yield page


@pytest.fixture
def controlled(served: PageProcess, loop: asyncio.AbstractEventLoop) -> ControlledPage:
    """The page of a node, whose tasks are new ones."""
    tasks = FakeTasks()
    asyncio.run_coroutine_threadsafe(operate(served, tasks, DeliveryWorld(KnowledgeBase())), loop).result()
    return ControlledPage(served, tasks)


def test_a_goal_that_is_sent_is_pursued_and_one_that_is_wrong_is_refused_with_its_place(controlled: ControlledPage) -> None:
    assert controlled.send({"do": "goal", "goal": "running"}) == (200, {"refused": "", "line": 0, "column": 0})
    refused = {"refused": "there is no predicate 'nonsense' here", "line": 1, "column": 1}
    assert controlled.send({"do": "goal", "goal": "nonsense"}) == (409, refused)
    assert [wanted.text for wanted in controlled.tasks.wanted] == ["running"]


@pytest.mark.parametrize("given", ["", "Bearer ", "Bearer wrong", "Bearer {token}x", "Basic {token}", "bearer {token}", "Bearer \xe9"])
def test_without_the_token_nothing_is_done_nor_told(given: str, controlled: ControlledPage) -> None:
    goal = {"do": "goal", "goal": "running"}
    for command, method in ((goal, "GET"), (goal, "POST"), ({"do": "why", "goal": "(at r1 yard)"}, "POST")):
        status, reply = controlled.send(command, method, Authorization=given.format(token=controlled.token))
        assert (status, "token" in reply["refused"]) == (403, True)
    assert not controlled.tasks.wanted


@pytest.mark.parametrize(
    ("header", "value", "status"),
    [("Origin", "http://evil.example", 403), ("Host", "evil.example", 421), ("Content-Type", "text/plain", 415)],
)
def test_requests_of_other_pages_are_refused_even_with_the_token(header: str, value: str, status: int, controlled: ControlledPage) -> None:
    assert controlled.send({"do": "goal", "goal": "running"}, **{header: value})[0] == status
    assert not controlled.tasks.wanted


def test_what_is_nested_deeper_than_any_command_is_refused_and_nothing_else_suffers(controlled: ControlledPage) -> None:
    for depth in (10, 900, 940, *range(950, 1000, 5), 100_000):
        assert controlled.send(f'{{"do": "check", "goal": {"[" * depth}{"]" * depth}}}')[0] == 400
    assert controlled.send({"do": "goal", "goal": "running"})[0] == 200


def test_a_page_without_controls_says_how_to_get_them(delivery: Path) -> None:
    with page_of(delivery) as url:
        status, _, text = asked(url, "/control", "POST", "{}", **{"Authorization": "Bearer ", "Content-Type": "application/json"})
    assert (status, "--view-controls" in text) == (403, True)


def test_a_run_takes_no_goals_and_says_when_it_has_not_begun_and_when_it_is_over(loop: asyncio.AbstractEventLoop, delivery: Path) -> None:
    with PageProcess(0, Controlled.RUN) as page:
        page.follow(str(delivery))
        run = ControlledPage(page, FakeTasks())
        assert "nothing yet" in run.send({"do": "pause"})[1]["refused"]
        asyncio.run_coroutine_threadsafe(operate(page, run.tasks), loop).result()
        assert run.send(None, "GET") == (200, {"what": "run"})
        status, reply = run.send({"do": "goal", "goal": "running"})
        assert (status, "`pnm serve`" in reply["refused"]) == (409, True)
        asyncio.run(operate(page, run.tasks))
        assert "it is over" in run.send({"do": "pause"})[1]["refused"]


def every(answer: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield answer
    for reason in answer["reasons"]:
        yield from every(reason)


def test_why_a_goal_cannot_be_reached_is_a_tree_that_ends_at_the_closed_door(controlled: ControlledPage) -> None:
    status, told = controlled.send({"do": "why", "goal": "(at parcel1 yard)"})
    assert (status, [*told]) == (200, ["answers"])
    reason, help_ = told["answers"]
    assert reason["statement"] == "there is no plan: (at parcel1 yard) cannot be reached"
    ends = [answer["statement"] for answer in every(reason) if not answer["reasons"]]
    assert "(takes_parcels yard) is false, and no action changes that" in ends
    assert help_["statement"] == "no change of facts was found that would help", "nobody knows where the robot is that has it"
    status, told = controlled.send({"do": "why", "goal": "(large)"})
    assert (status, "too large to be explained here" in told["refused"]) == (409, True)


def test_what_a_plan_would_take_is_told_while_a_goal_is_typed(controlled: ControlledPage) -> None:
    status, told = controlled.send({"do": "look", "goal": "(at r1 yard)"})
    assert (status, told["calls"] > 0, told["seconds"] > 0.0, told["chance"]) == (200, True, True, None)
    told = controlled.send({"do": "look", "goal": "(at parcel1 yard)"})[1]
    assert (told["calls"], told["reason"].endswith("the goal cannot be reached")) == (None, True)
    assert "too large" in controlled.send({"do": "look", "goal": "(large)"})[1]["refused"]


def test_what_is_explained_counts_on_what_is_under_way(controlled: ControlledPage) -> None:
    """While a robot moves it is nowhere, so that it could never be anywhere again."""
    (plan,) = controlled.send({"do": "why", "goal": "(at r1 yard)"})[1]["answers"]
    assert plan["statement"].startswith("there is a plan with ")
