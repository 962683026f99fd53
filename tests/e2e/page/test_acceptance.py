"""The page of a node over ROS 2, as people use it: goals are sent, fail, are planned anew, explained and reached; people answer."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from itertools import takewhile
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from planner_bridge.view.follow import Reader
from pnm.journal.records import TaskAccepted
from tests.support.e2e.deployment import ProblemDeployment
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.journals import steps
from tests.support.e2e.page.nodes import Node, begun, serve
from tests.support.e2e.page.serving import asked
from tests.support.e2e.plan_deployment import ClientProgram
from tests.support.files import ROOT, written
from tests.support.processes import LIMIT
from tests.support.runs.files import CUPS, DROPS, TOLD

FAULTS = (ROOT / "problems" / "delivery" / "faults.yaml").read_text(encoding="utf-8")
STUCK = "  - {call: 'move(r2, hall, yard)', do: hang, times: 1}\n"
ASKS = """
actions:
  note: {type: kb_action}
serves:
  results: [drink]
  initial_knowledge: {drink: none}
  plan:
    - note: {operation: {LocalUpdate: [drink, {PersonQuery: [drink, "Tea or water?"]}]}}
"""
SIZES = {"wide": (1280, 900), "narrow": (400, 800)}
REFUSED = re.compile("409 \\(Conflict\\)|403 \\(Forbidden\\)")


@pytest.fixture(scope="module")
def node(deploy_for_module: Callable[..., ProblemDeployment]) -> Node:
    """A node whose robots take their time: a task is paused long before it is over, also on a busy machine."""
    return serve(deploy_for_module("delivery/p01", speed="1", quick=True))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture
def page(chromium: Browser, deploy: Callable[..., ProblemDeployment]) -> Iterator[Page]:
    """A page that must say nothing on its console but what it asks for in vain. It is closed before the nodes are."""
    opened, said = chromium.new_page(), list[str]()
    opened.set_default_timeout(1000 * LIMIT)
    opened.on("console", lambda message: said.append(message.text) if not REFUSED.search(message.text) else None)
    opened.on("pageerror", lambda error: said.append(str(error)))
    yield opened
    opened.close()
    assert not said


def send(page: Page, goal: str) -> None:
    page.get_by_label("Goal", exact=True).fill(goal)
    expect(page.locator("#goal-said")).to_have_class("said ok")
    page.locator("#send").click()
    expect(page.locator("#command-said")).to_have_text(f"✓ sent: {goal}")


def test_a_run_over_ros_2_is_seen_explained_and_steered_in_a_browser(page: Page, deploy: Callable[..., ProblemDeployment]) -> None:
    deployment = deploy("delivery/p01", speed="4", quick=True, faults=FAULTS + STUCK)
    written(deployment.folder / "asks.yaml", ASKS)
    node = serve(deployment, "--world", str(written(deployment.folder / "world.yaml", "plans: [asks.yaml]")))
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto(node.url)
    expect(page.locator("#status")).to_have_text("live")
    assert "token" not in page.url, "it is out of sight"
    field = page.get_by_label("Goal", exact=True)
    field.fill("(and (at parcel1 kitchn))")
    expect(page.locator("#goal-said")).to_contain_text("✕ column 18: unknown object 'kitchn'; did you mean 'kitchen'?")
    expect(field).to_have_attribute("aria-invalid", "true")
    send(page, "(and (at parcel1 hall) (at parcel2 kitchen))")
    expect(page.locator("#task")).to_contain_text("goal reached")
    expect(page.locator("#task h2")).to_have_text("Parcel1 at hall, parcel2 at kitchen")
    expect(page.locator("#lanes .newplan")).to_have_count(2)
    trouble = page.locator("#detail .trouble", has_text="Move r1 hall kitchen failed").first
    expect(trouble).to_contain_text("a new plan is needed")
    accepted = {step.record.wanted.text for step in steps(node.journal) if isinstance(step.record, TaskAccepted)}
    assert accepted == {"(and (at parcel1 hall) (at parcel2 kitchen))"}
    goes_back(page)
    a_plan_asks_a_person(page, deployment)
    an_end_is_forced(page, node)
    what_cannot_be_reached_is_explained(page)


def a_plan_asks_a_person(page: Page, deployment: ProblemDeployment) -> None:
    """A plan's own question is answered on the page, and the plan goes on with the answer."""
    client = deployment.module(ClientProgram, "tests.support.e2e.programs.client", "plan", "serves", "", "")
    question = page.locator(".need.asks")
    expect(question.locator("p")).to_have_text("Tea or water?")
    expect(page.locator("#pill")).to_have_text("1 needs you")
    expect(page).to_have_title(re.compile(r"^\(1\) "))
    question.get_by_label("answer").fill("tea")
    question.get_by_role("button", name="Answer").click()
    expect(page.locator("#command-said")).to_have_text("✓ answered: tea")
    expect(question).to_have_count(0)
    assert client.result()["results"] == {"drink": "tea"}


def an_end_is_forced(page: Page, node: Node) -> None:
    """A robot that is stuck: its limit runs down, what its call needs has a value and an age, and a person says that it has failed."""
    send(page, "(at r2 yard)")
    page.locator("#task-list button", has_text="R2 at yard").click()
    bar = page.locator("#lanes .bar[data-state=running]")
    expect(page.locator("#limit")).to_contain_text("of 30 s to be done")
    assert 0.0 <= float(str(page.locator("#limit [role=meter]").get_attribute("aria-valuenow"))) < 30.0
    read = page.locator("#detail [data-fact='(at r2 hall)']").first
    expect(read).to_contain_text("◉ sensed")
    expect(read.locator(".age")).to_have_text(re.compile(r"\d+ s ago|since the start"))
    page.get_by_role("button", name="It has failed").click()
    expect(page.locator("#command-said")).to_contain_text("counts as failed as soon as its server is done with it")
    expect(page.locator("#task")).to_contain_text("goal reached")
    expect(bar).to_have_count(0)
    requests = Reader(node.journal).newest().requests.values()
    assert [request["outcome"] for request in requests if request["action"] == "move(r2, hall, yard)"] == ["aborted", "succeeded"]


def what_cannot_be_reached_is_explained(page: Page) -> None:
    """No place in the yard takes parcels: the tree ends there, at the goal that is typed and at the task that was given up."""
    page.get_by_label("Goal", exact=True).fill("(at parcel1 yard)")
    page.get_by_role("button", name="Can it be reached?").click()
    tree = page.locator("#goal-reasons")
    expect(tree).to_be_visible()
    expect(tree).to_contain_text("there is no plan: (at parcel1 yard) cannot be reached [proved by reachability]")
    expect(tree.locator("li:not(:has(li))", has_text="(takes_parcels yard) is false, and no action changes that").first).to_be_visible()
    expect(tree).to_contain_text("if (takes_parcels yard) were true: a plan with")
    send(page, "(at parcel1 yard)")
    expect(tree).to_be_empty()
    question = page.locator(".need.asks")
    expect(question).to_contain_text("This goal cannot be reached")
    question.get_by_role("button", name="Why is there no plan?").click()
    expect(question).to_contain_text("(takes_parcels yard) is false, and no action changes that")
    question.get_by_role("button", name="give up").click()
    expect(question).to_have_count(0)
    page.keyboard.press("Escape")
    page.locator("#over button", has_text="Parcel1 at yard").click()
    task = page.locator("#task", has_text="a person was asked for help, and says to give up")
    task.get_by_role("button", name="Why is there no plan?").click()
    expect(task).to_contain_text("(takes_parcels yard) is false, and no action changes that")


def goes_back(page: Page) -> None:
    """The scrubber shows what was so at a failure, and nobody controls the past."""
    mark = page.locator("#marks [data-mark=failure]").first
    record = str(mark.get_attribute("data-record"))
    mark.click()
    expect(page.locator("body")).to_have_attribute("data-record", record)
    expect(page.locator("#status")).to_contain_text("history")
    expect(page.locator("#goal-form")).to_be_hidden()
    expect(page.get_by_role("button", name="Pause")).to_have_count(0)
    page.get_by_role("button", name="Live").click()
    expect(page.locator("#status")).to_have_text("live")
    expect(page.locator("#goal-form")).to_be_visible()


def test_outcomes_are_seen_also_in_a_node_that_goes_on_with_a_policy(
    page: Page, chromium: Browser, deploy: Callable[..., ProblemDeployment]
) -> None:
    deployment = deploy("cups", texts=CUPS, faults=DROPS, bindings=f"{TOLD}assumed: [held, floor, table]\n", speed="0.5", quick=True)
    simulation = deployment.simulate().ready()
    first, node = begun(deployment)
    dying = chromium.new_context()
    before = dying.new_page()  # of a node that dies, of which its console may say what it will
    before.set_default_timeout(1000 * LIMIT)
    before.goto(node.url)
    send(before, "(held mug)")
    simulation.happens("start", "lift")
    expect(before.locator("#lanes .bar", has_text="pick(mug), attempt 1: 2")).to_have_count(1)
    expect(before.locator("#policy-picture text.taken", has_text="2 33%")).to_have_count(1)
    dying.close()
    first.process.kill()
    _, node = begun(deployment)
    page.goto(node.url)
    expect(page.locator("#task")).to_contain_text("goal reached")
    for outcome in (1, 2, 3):
        expect(page.locator("#lanes .bar", has_text=f"pick(mug), attempt 1: {outcome}")).to_have_count(1)
        expect(page.locator("#policy-picture text.taken", has_text=f"{outcome} 33%")).to_have_count(1)
    starts = [event["action"] for event in simulation.objects() if event["event"] == "start"]
    assert starts == ["pick(mug)", "lift(mug)", "pick(mug)", "pick(mug)"]


def test_a_task_is_paused_makes_a_step_goes_on_and_is_cancelled(page: Page, node: Node) -> None:
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto(node.url)
    send(page, "(and (at parcel1 hall) (at parcel2 kitchen))")
    task = page.locator("#task", has_text="parcel2 at kitchen")
    expect(page.locator("#picture [data-state=running]").first).to_be_visible()
    task.get_by_role("button", name="Pause at once").click()
    expect(task.locator(".state")).to_have_text("paused")
    sent = page.locator("#lanes .bar").count()
    task.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator("#command-said")).to_have_text("✓ one request has left")
    expect(task.locator(".state")).to_have_text("paused")
    assert page.locator("#lanes .bar").count() == sent + 1
    task.get_by_role("button", name="Resume").click()
    expect(task.locator(".state")).to_have_text("running")
    task.get_by_role("button", name="Cancel").click()
    expect(task.locator(".state")).to_have_text("cancelled")
    expect(task.get_by_role("group")).to_have_count(0)


def test_without_the_token_nothing_is_controlled(chromium: Browser, node: Node) -> None:
    context = chromium.new_context()
    page = context.new_page()
    page.goto(node.address)
    expect(page.locator("#status")).to_have_text("live")
    expect(page.locator("#goal-form")).to_be_hidden()
    expect(page.get_by_role("button", name="Pause")).to_have_count(0)
    page.goto(f"{node.address}#token=wrong")
    page.reload()
    expect(page.locator("#control-note")).to_contain_text("this needs the token")
    expect(page.locator("#goal-form")).to_be_hidden()
    context.close()
    headers = {"Content-Type": "application/json", "Authorization": "Bearer wrong"}
    status, _, text = asked(node.address, "/control", "POST", json.dumps({"do": "pause"}), **headers)
    assert (status, "token" in json.loads(text)["refused"]) == (403, True)
    token = urlsplit(node.url).fragment.removeprefix("token=")
    assert len(token) >= 40
    assert token not in text
    assert token.encode() not in node.journal.read_bytes()


@pytest.mark.parametrize(("size", "scheme"), [("wide", "light"), ("narrow", "dark")])
def test_everybody_can_use_it(page: Page, node: Node, tmp_path: Path, size: str, scheme: str) -> None:
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light", reduced_motion="reduce")
    page.goto(node.url)
    expect(page.locator("#status")).to_have_text("live")
    expect(page.locator("#picture svg.g")).to_be_visible()
    expect(page.locator("#pause-all")).to_be_visible()
    page.keyboard.press("2")
    reached = list(takewhile("live".__ne__, (reach(page) for _ in range(500))))  # the last of the page; every fact before is a button
    for wanted in ("pause-all", "theme", "lanes", "picture", "tab-facts", "way", *(("goal", "fact") if size == "wide" else ("grab",))):
        assert wanted in reached, f"{wanted} cannot be reached by keys"
    page.keyboard.press("g")
    page.get_by_label("Goal", exact=True).fill("(at parcel1 kitchn)")
    expect(page.locator("#goal-said")).to_contain_text("column 13")
    page.screenshot(path=tmp_path / f"page-{size}-{scheme}.png", full_page=True)
    found = Axe().run(page)
    assert not found.response["violations"], found.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def reach(page: Page) -> str:
    """Go on to what the next Tab reaches; return what it is known by."""
    page.keyboard.press("Tab")
    return str(page.evaluate("document.activeElement.id"))
