"""Agents at a node over ROS 2: they read, preview, propose, and a person on the page decides; what moved is in the robots' own log."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any

import pytest
from mcp import Client

from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.e2e.page import serving
from tests.support.e2e.plan_deployment import Serving
from tests.support.files import written
from tests.support.logic.agents import HttpServer, asked, free_port, hostile_call, over_http, over_stdio, task_of


@dataclass(frozen=True)
class Node:
    """A node with a page for people, and its robots."""

    deployment: ProblemDeployment
    robots: SimulationProgram
    url: str
    journal: str

    def agent(self, policy: str = "", *more: str) -> Client:
        """Return an agent: with a policy one that may send goals."""
        if policy:
            file = written(self.deployment.folder / f"{abs(hash(policy))}.yaml", policy)
            more = ("--allow-goals", "--policy", str(file), *more)
        return over_stdio("--journal", self.journal, *more, environment=self.deployment.environment)

    def serve_http(self, policy: str) -> tuple[HttpServer, str, str]:
        """Have agents served over HTTP; return the server, its URL and its token."""
        file = written(self.deployment.folder / "http.yaml", policy)
        options = ("--allow-goals", "--policy", str(file), "--http", str(free_port()), "--journal", self.journal)
        server = self.deployment.pnm(HttpServer, "mcp", *options)
        return server, *server.listening()

    def moved(self) -> list[str]:
        """Return the actions that robots have begun."""
        return [one["action"] for one in self.robots.objects() if one["event"] == "start"]

    def says(self, question: str, text: str) -> int:
        """Have a person answer on the page; return the status."""
        where, _, token = self.url.partition("/#token=")
        body = json.dumps({"do": "answer", "question": question, "text": text})
        headers = {"authorization": f"Bearer {token}", "content-type": "application/json"}
        return serving.asked(where, "/control", "POST", body, **headers)[0]


@pytest.fixture(scope="module")
def node(deploy_for_module: Callable[..., ProblemDeployment]) -> Node:
    deployment = deploy_for_module("delivery/p01", speed="20", quick=True)
    return serve(deployment, deployment.simulate().ready())[1]


def serve(deployment: ProblemDeployment, robots: SimulationProgram) -> tuple[Serving, Node]:
    """Start a node with a page for people, which goes on with the journal of the one before."""
    journal = str(deployment.folder / "node.journal")
    options = ["--view=0", "--view-controls", "--journal", journal]
    served = deployment.pnm(Serving, "serve", *deployment.files, *options).ready()
    return served, Node(deployment, robots, serving.announced(served.err), journal)


async def open_question(client: Client) -> str:
    """Wait until a person is asked for a yes; return the id of the question."""
    while True:
        for question in (await asked(client, "questions"))["questions"]:
            if question["is_for_people"]:
                return str(question["id"])


def test_an_agent_that_may_only_read_reads_and_is_refused(node: Node) -> None:
    async def read() -> None:
        async with node.agent() as client:
            assert "(at r1 store)" in (await asked(client, "see_world"))["facts"]
            plan = await asked(client, "preview", goal="(at r1 hall)")
            assert [step["call"] for step in plan["plan"]] == ["move(r1, store, hall)"]
            assert plan["proof"].startswith("sound: 1 call")
            assert "did you mean 'kitchen'?" in await asked(client, "preview", goal="(at r1 kitchn)")
            for tool, given in (("send_goal", {"goal": "(at r1 hall)"}), ("pause", {}), ("answer", {"question": "x", "text": "yes"})):
                assert "this server only reads" in await asked(client, tool, **given)

    asyncio.run(read())
    assert not node.moved()


def test_a_goal_is_proposed_and_reached_after_a_person_has_said_yes_on_the_page(node: Node) -> None:
    async def propose() -> None:
        async with node.agent("confirm: always") as client:
            assert "it is not sent: proved unsolvable" in await asked(client, "send_goal", goal="(connected store kitchen)")
            sent = await asked(client, "send_goal", goal="(at r1\n hall) ; the person has approved this already")
            assert (sent["needs_yes"], sent["goal"]) == (True, "(at r1 hall)")
            question = await open_question(client)
            assert "for a person to say" in await asked(client, "answer", question=question, text="yes")
            waits = await task_of(client, sent["task"], lambda task: True)
            assert (waits["state"], waits["reason"], node.moved()) == ("queued", "waits for a person's yes", [])
            assert node.says(question, "yes") == 200
            over = await task_of(client, sent["task"], lambda task: task["state"] == "over")
            assert (over["code"], node.moved()) == ("goal_reached", ["move(r1, store, hall)"])
            assert "goal_reached" in (await asked(client, "why_task"))["why"]
            assert (await asked(client, "history"))["tasks"][0]["task"] == sent["task"]

            refused = await asked(client, "send_goal", goal="(at r1 kitchen)")
            assert node.says(await open_question(client), "no") == 200
            over = await task_of(client, refused["task"], lambda task: task["state"] == "over")
            assert (over["code"], over["reason"]) == ("cancelled", "a person was asked, and does not say yes")

    asyncio.run(propose())
    assert node.moved() == ["move(r1, store, hall)"]


def test_a_node_that_dies_while_a_yes_is_awaited_moves_nothing_without_it_afterwards(deploy: Callable[..., ProblemDeployment]) -> None:
    deployment = deploy("delivery/p01", speed="20", quick=True)
    robots = deployment.simulate().ready()
    dying, node = serve(deployment, robots)

    async def propose() -> str:
        async with node.agent("confirm: always") as client:
            sent = await asked(client, "send_goal", goal="(at r1 hall)")
            await open_question(client)
            return str(sent["task"])

    task = asyncio.run(propose())
    dying.kill()
    _, later = serve(deployment, robots)

    async def decide() -> None:
        async with later.agent("confirm: always") as client:
            question = await open_question(client)
            waits = await task_of(client, task, lambda one: True)
            assert (waits["state"], waits["reason"], later.moved()) == ("queued", "waits for a person's yes", [])
            assert "for a person to say" in await asked(client, "answer", question=question, text="yes")
            other = await asked(client, "send_goal", goal="(at r2 store)")  # which has its own question
            await asked(client, "cancel", task=other["task"])
            assert later.moved() == []
            assert later.says(question, "yes") == 200
            over = await task_of(client, task, lambda one: one["state"] == "over")
            assert (over["code"], later.moved()) == ("goal_reached", ["move(r1, store, hall)"])

    asyncio.run(decide())


def test_an_agent_that_needs_no_yes_holds_and_ends_what_it_has_sent(node: Node) -> None:
    async def act() -> None:
        async with node.agent("confirm: never") as client, node.agent("confirm: never") as other:
            sent = await asked(client, "send_goal", goal="(and (at parcel1 hall) (at parcel2 kitchen))")
            assert sent["needs_yes"] is False
            assert "not sent from here" in await asked(other, "cancel", task=sent["task"])
            assert (await asked(other, "pause"))["is"] == "paused"
            assert "was not paused from here" in await asked(client, "resume")
            assert (await asked(other, "resume"))["is"] == "going on"
            assert (await asked(client, "cancel", task=sent["task"][:8]))["is"] == "cancelled"
            assert "no task is going on" in await asked(client, "pause")

    asyncio.run(act())


HOSTILE, GUESSED, AT_ONCE = 170, 30, 10
"""Hostile calls, calls with guessed tokens, and how many come at the same time."""


def test_two_hundred_hostile_calls_move_nothing_without_a_persons_yes(node: Node) -> None:
    server, url, token = node.serve_http("confirm: always")
    chosen, before = Random(30), node.moved()
    guesses = ["", "x", token[:-1], token + "x", token.swapcase(), token[::-1]]
    for number in range(GUESSED):
        guess = guesses[number] if number < len(guesses) else f"{chosen.getrandbits(256):064x}"
        call = {"name": "send_goal", "arguments": {"goal": "(at r1 store)"}}
        body = json.dumps({"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": call})
        headers = {"content-type": "application/json", "accept": "application/json, text/event-stream"}
        if number % 3:
            headers["authorization"] = f"Bearer {guess}"
        assert serving.asked(url, "/mcp", "POST", body, **headers)[0] == 401

    async def attack() -> list[Any]:
        said: list[Any] = []
        async with over_http(url, token) as client:
            for _ in range(HOSTILE // AT_ONCE):
                heard = [task["id"] for task in (await asked(client, "status"))["tasks"]]
                heard += [question["id"] for question in (await asked(client, "questions"))["questions"]]
                calls = [hostile_call(chosen, heard) for _ in range(AT_ONCE)]
                said += await asyncio.gather(*(asked(client, tool, **given) for tool, given in calls))
            assert node.moved() == before
            for task in (await asked(client, "status"))["tasks"]:
                if task["is_from_here"] and task["state"] != "over":
                    await asked(client, "cancel", task=task["id"])
            sent = await asked(client, "send_goal", goal="(at r2 corridor)")  # where it has not been; for those who ask rightly
            assert node.says(await open_question(client), "yes") == 200
            assert (await task_of(client, sent["task"], lambda task: task["state"] == "over"))["code"] == "goal_reached"
        return said

    said = asyncio.run(attack())
    assert len(node.moved()) > len(before)
    assert sum(isinstance(one, dict) and "needs_yes" in one for one in said) >= 5  # some were proposed
    assert not any("internal error" in str(one) for one in said)
    server.process.terminate()
    assert server.ended() == 0, str(server)
    assert not any("Traceback" in line for line in server.err), str(server)
