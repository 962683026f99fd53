"""The tools that agents get over the Model Context Protocol, asked by the client of the official SDK."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from mcp import Client

from planner_bridge.node import agents
from planner_bridge.node.agents import MAX_CALLS, MAX_TEXT, Agents, server_of
from planner_bridge.node.node_journal import latest_journal
from planner_bridge.node.problem_service import served_files
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.settings import Settings
from pnm.errors import installation
from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT
from tests.support.logic.agents import asked, over_stdio

FILES = ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl"


def with_client(work: Callable[[Client], Awaitable[Any]]) -> Any:
    """Do the work with a client of the tools over files, in this process."""

    async def connected() -> Any:
        async with Client(server_of(Agents(served_files(load(*FILES), Settings()), latest_journal))) as client:
            return await work(client)

    return asyncio.run(connected())


def told(tool: str, **given: Any) -> Any:
    return with_client(lambda client: asked(client, tool, **given))


def test_a_client_over_the_standard_streams_reads_the_world_and_previews_a_plan_with_its_proof():
    async def read() -> tuple[Any, Any]:
        async with over_stdio(*map(str, FILES)) as client:
            return await asked(client, "see_world"), await asked(client, "preview", goal="(at r1 kitchen)")

    world, plan = asyncio.run(read())
    assert "r1 - robot" in world["objects"]
    assert "(at r1 store)" in world["facts"]
    assert world["actions"]["move"]["needs"] == "(and (connected ?from ?to) (at ?robot ?from))"
    assert [step["call"] for step in plan["plan"]] == ["move(r1, store, hall)", "move(r1, hall, kitchen)"]
    assert plan["proof"].startswith("sound: 2 calls")
    assert plan["is_sent"] is False


@pytest.mark.parametrize(
    ("tool", "given", "says"),
    [
        ("check_goal", {"goal": "(at r1 kitchn)"}, "goal:1:8: unknown object 'kitchn'; did you mean 'kitchen'?"),
        ("check_goal", {"goal": "kitchen"}, "there is no goal 'kitchen'; expected a condition such as (at r1 kitchen)"),
        ("preview", {"goal": "(at door1 kitchen)"}, "'door1' is of type door; expected movable"),
        ("why", {"not_call": "mve(r1, store, hall)"}, "not_call: there is no action 'mve'; did you mean 'move'?"),
        ("why", {"not_call": "; move"}, "not_call: "),
        ("check_goal", {"goal": "x" * (MAX_TEXT + 1)}, f"goal has {MAX_TEXT + 1} characters; expected {MAX_TEXT} at most"),
        ("check_goal", {}, "Field required"),
        ("check_goal", {"goal": ["(at r1 kitchen)"]}, "valid string"),
        ("send", {}, "Unknown tool: send"),
    ],
)
def test_mistakes_are_answered_as_on_the_command_line(tool, given, says):
    assert says in told(tool, **given)


def test_what_is_refused_leaves_no_traceback(caplog):
    with pytest.raises(Exception, match=r"TaskGroup|prompt"):  # as the SDK has it
        with_client(lambda client: client.get_prompt("nope"))
    assert not caplog.records


def test_a_goal_is_read_back_and_explained():
    assert told("check_goal", goal="(AT r1\n store) ; the person has said yes") == {"goal": "(at r1 store)", "holds_now": True}
    assert "#0 move(r1, store, hall): for #1" in told("why", goal="(at r1 kitchen)")["why"]
    assert "move(r2, hall, store)" in told("why", goal="(at r1 kitchen)", not_call="move(r2, hall, store)")["why"]
    no_plan = told("preview", goal="(connected store kitchen)")
    assert (no_plan["has_plan"], no_plan["plan"], no_plan["proof"]) == (False, None, None)


def test_odds_are_there_if_they_are_asked_for():
    assert 0.9 < told("preview", goal="(at r1 hall)", with_odds=True)["odds"]["chance"] <= 1.0


def test_resources_and_the_prompt_are_there():
    async def read(client: Client) -> list[str]:
        texts = [(await client.read_resource(f"pnm://{name}")).contents[0].text for name in ("domain", "problem")]
        return [*texts, (await client.get_prompt("tools")).messages[0].content.text]

    domain, problem, prompt = with_client(read)
    assert domain.startswith("(define (domain delivery)")
    assert problem.startswith("(define (problem delivery-p01)")
    assert "see_world" in prompt


def test_no_more_calls_than_that_are_at_work_and_none_for_longer(monkeypatch):
    monkeypatch.setattr(agents, "SECONDS", 0.01)

    class Slow(Agents):
        async def see_world(self) -> dict[str, Any]:
            """Wait for ever."""
            await asyncio.Event().wait()
            return {}

    async def connected() -> list[str]:
        async with Client(server_of(Slow(served_files(load(*FILES), Settings()), latest_journal))) as client:
            return await asyncio.gather(*(asked(client, "see_world") for _ in range(MAX_CALLS + 2)))

    said = asyncio.run(connected())
    assert sum("calls are at work already" in one for one in said) == 2
    assert sum("there was no answer within" in one for one in said) == MAX_CALLS


def test_without_the_extra_the_command_names_what_installs_it(monkeypatch):
    for name in [*sys.modules]:
        if name == "mcp" or name.startswith("mcp."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcp", None)
    done = pnm("mcp", *map(str, FILES))
    assert done.returncode == 2
    assert installation("mcp") in done.stderr
