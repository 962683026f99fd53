"""Requests that take long: the event loop goes on meanwhile, their turns come in order, and there is an end to what they may take."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.node import world_queries
from planner_bridge.node.problem_service import NOTHING, ProblemFolder, ServedProblem
from planner_bridge.node.world_queries import MAX_CHARACTERS, MAX_GOAL_CHOICES
from planner_bridge.tasks.settings import Settings
from pnm.clock import in_own_thread, run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.domain import MAX_CHOICES
from pnm.errors import InputError
from tests.support.processes import LIMIT
from tests.support.runs.simulated import in_virtual_time
from tests.support.tasks.world import PROBLEM, served, world

LONG = f"(and {'(not (dark)) ' * 5000}(charged r1))"


@pytest.fixture(autouse=True)
def no_time_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the answers take no time, on however busy a machine."""
    monkeypatch.setattr(world_queries, "monotonic", lambda: 0.0)


def deep(variables: int) -> str:
    """A condition about every choice of three robots for so many variables."""
    return f"(forall ({' '.join(f'?x{number}' for number in range(variables))} - robot) (charged ?x0))"


def node_in(folder: Path) -> ServedProblem:
    """A node that has its folder here, and loads other problems."""
    knowledge = initial_knowledge(PROBLEM)

    def begin_anew(_: Problem, initial: KnowledgeBase) -> None:
        knowledge.begin_anew(initial.facts(), initial.objects_by_type(), initial.rules)

    return ServedProblem(PROBLEM, knowledge, Settings(), ProblemFolder(folder), begin_anew)


async def noop() -> None:
    """Do nothing, at once."""


async def turns_of(work: Awaitable[object]) -> int:
    """How many turns the event loop has while the work is done."""
    task, turns = asyncio.ensure_future(work), 0
    while not task.done():
        await asyncio.sleep(0)
        turns += 1
    task.result()
    return turns


@pytest.mark.parametrize("what", ["query", "update", "get", "save", "load"])
@in_virtual_time
async def test_the_event_loop_goes_on_while_a_request_is_worked_on(tmp_path, what):
    node = node_in(tmp_path)
    requests = {
        "query": lambda: node.query([LONG] * 5),
        "update": lambda: node.update(["(dark)"] * 10_000, [], []),
        "get": node.get,
        "save": lambda: node.save("p.pddl"),
        "load": lambda: node.load("", f"(define (problem p) (:domain d) (:goal {LONG}) (:objects r1 - robot))"),
    }
    assert await turns_of(noop()) == 1
    assert await turns_of(requests[what]()) > 1


class KnowledgeOfOneThread(KnowledgeBase):
    """Knowledge that the event loop may change at any moment: no other thread may look at it."""

    def facts(self):
        assert threading.current_thread() is threading.main_thread()
        return super().facts()


@pytest.mark.parametrize("problem", [PROBLEM, NOTHING], ids=lambda problem: problem.name)
@in_virtual_time
async def test_changes_are_read_from_a_snapshot(problem):
    node = served(KnowledgeOfOneThread(objects=problem.objects_by_type), problem)
    with pytest.raises(InputError, match="unknown predicate"):
        await node.update(["(flies r1)"], [], [])


@in_virtual_time
async def test_requests_have_their_turns_in_order_each_from_what_is_known_then():
    node, ended = served(initial_knowledge(PROBLEM)), []

    async def noted(name, work):
        result = await work
        ended.append(name)
        return result

    first, _, second = await asyncio.gather(
        noted("first", node.query([LONG, "(dark)"])),
        noted("update", node.update(["(dark)"], [], [])),
        noted("second", node.query(["(dark)"])),
    )
    assert ended == ["first", "update", "second"]
    assert (first[1][1], second[0][1]) == ("false", "true")


class BusyPlanners(Executor):
    """Planners that have no answer before they are told to stop."""

    def __init__(self) -> None:
        self.searches: list[Future[Any]] = []
        self.are_both_busy = threading.Event()

    def submit(self, *_: object, **__: object) -> Future[Any]:
        self.searches.append(Future())
        if len(self.searches) == 2:
            self.are_both_busy.set()
        return self.searches[-1]


def test_plan_requests_have_their_turns_and_leave_threads_to_others():
    planners = BusyPlanners()

    async def scene() -> None:
        settings = Settings(planner="race:kairos,aries", executor=planners)
        node = served(initial_knowledge(PROBLEM), settings=settings)
        requests = [asyncio.create_task(node.make("(dark)", "", LIMIT)) for _ in range(40)]
        assert await in_own_thread(lambda: planners.are_both_busy.wait(LIMIT))
        async with asyncio.timeout(LIMIT):
            assert await node.query(["(dark)"]) == [("(dark)", "false")]
        for request in reversed(requests):
            request.cancel()
        await asyncio.wait(requests)
        assert len(planners.searches) == 2, "each of the two planners has searched for the first request"

    run_async(scene())


@in_virtual_time
async def test_a_request_has_a_budget(monkeypatch):
    node, said = served(initial_knowledge(PROBLEM)), f"characters at once; expected {MAX_CHARACTERS} at most"
    with pytest.raises(InputError, match=said):
        await node.query([LONG] * 20)
    with pytest.raises(InputError, match=said):
        await node.update([LONG] * 10, [LONG] * 10, [])
    monkeypatch.setattr(world_queries, "MAX_SECONDS", -1.0)
    with pytest.raises(InputError, match="the answers have taken -1 s; expected fewer or simpler questions"):
        await node.query(["(dark)"] * 3)


def test_goals_range_over_less_than_questions():
    assert 3**8 < MAX_GOAL_CHOICES < 3**9 < MAX_CHOICES < 3**10
    assert world().query([deep(9)]) == [(deep(9), "false")]
    with pytest.raises(InputError, match=rf"questions\[0\]:1:1: the quantifiers range over {3**10} choices of objects"):
        world().query([deep(10)])
    assert world().read_goal(deep(8))
    with pytest.raises(InputError, match=f"goal:1:1: the quantifiers range over {3**9} choices of objects; expected {MAX_GOAL_CHOICES}"):
        world().read_goal(deep(9))


def test_the_time_for_answers_is_over_in_the_middle_of_a_question(monkeypatch):
    moments = iter([0.0, *[1.0] * 100, *[9.0] * 10])
    monkeypatch.setattr(world_queries, "monotonic", lambda: next(moments))
    with pytest.raises(InputError, match="the answers have taken 5 s"):
        world().query([f"(or {'(dark) ' * 200})"])
    assert len(list(moments)) == 9
