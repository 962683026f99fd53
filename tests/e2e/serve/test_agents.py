"""Agents at a node over ROS 2: they read, preview, propose, and a person on the page decides; what moved is in the robots' own log."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from mcp import Client

from tests.support.e2e.agents import asked, over_stdio, task_of
from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.e2e.page import serving
from tests.support.e2e.plan_deployment import Serving
from tests.support.files import written


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
    robots, journal = deployment.simulate().ready(), str(deployment.folder / "node.journal")
    options = ["--view=0", "--view-controls", "--journal", journal]
    served = deployment.pnm(Serving, "serve", *deployment.files, *options).ready()
    return Node(deployment, robots, serving.announced(served.err), journal)


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
