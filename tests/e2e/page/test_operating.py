"""What people do on the page of a node by keys alone: a plan by hand is started and answered, a robot is taken and given back."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.support.e2e.deployment import ProblemDeployment
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.nodes import Node, serve
from tests.support.files import written
from tests.support.processes import LIMIT

PATROL = """
actions:
  note: {type: kb_action}
patrol:
  params: [rounds]
  results: [answer]
  initial_knowledge: {rounds: 2, answer: none}
  plan:
    - note: {operation: {LocalUpdate: [answer, {PersonQuery: [answer, "The pump is hot. Go on?"]}]}}
"""
COVERS = """() => {
  const [said, mid] = ["command-said", "mid"].map((id) => document.getElementById(id).getBoundingClientRect());
  return said.width > 0 && said.right > mid.left && said.left < mid.right && said.bottom > mid.top && said.top < mid.bottom;
}"""


@pytest.fixture
def node(deploy: Callable[..., ProblemDeployment]) -> Node:
    deployment = deploy("delivery/p01", speed="4", quick=True)
    written(deployment.folder / "patrol.yaml", PATROL)
    return serve(deployment, "--world", str(written(deployment.folder / "world.yaml", "plans: [patrol.yaml]")))


@pytest.fixture
def page(node: Node) -> Iterator[Page]:
    with browser() as opened:
        yield shown(opened, node)


def shown(opened: Browser, node: Node) -> Page:
    page = opened.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1000 * LIMIT)
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto(node.url)
    expect(page.locator("#goal-form")).to_be_visible()
    return page


def until_focused(page: Page, wanted: str) -> None:
    """Press Tab until what has the focus matches a selector."""
    for _ in range(200):
        page.keyboard.press("Tab")
        if page.evaluate("(wanted) => document.activeElement.matches(wanted)", wanted):
            return
    raise AssertionError(f"{wanted} cannot be reached by keys")


def test_all_is_done_by_keys_alone(page: Page) -> None:
    a_plan_by_hand_is_started_and_answered(page)
    a_day_is_looked_at(page)
    a_goal_is_sent_paused_and_goes_on(page)
    a_robot_is_taken_and_given_back(page)


def a_plan_by_hand_is_started_and_answered(page: Page) -> None:
    until_focused(page, "[data-plan=patrol] input")
    page.keyboard.type("3")
    page.keyboard.press("Enter")
    expect(page.locator("#task h2")).to_have_text("Patrol (rounds: 3)")
    expect(page.locator(".need.asks p")).to_have_text("The pump is hot. Go on?")
    expect(page.locator("#pill")).to_have_text("1 needs you")
    everybody_can_use(page)
    page.keyboard.press("Escape")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("y")
    expect(page.locator("#command-said")).to_have_text("✓ answered: yes")
    expect(page.locator("#task")).to_contain_text("goal reached")
    expect(page.locator("#pill")).to_have_text("nothing needs you")


def everybody_can_use(page: Page) -> None:
    """Nothing is found on what is shown, on a wide screen, on a phone, and there with the inspector pulled up, in light and dark."""
    for width, scheme in ((1280, "light"), (400, "dark"), (400, "light")):
        page.set_viewport_size({"width": width, "height": 800})
        page.emulate_media(color_scheme="dark" if scheme == "dark" else "light", reduced_motion="reduce")
        for is_up in (False, True) if width == 400 else (False,):
            if is_up:
                page.locator("#grab").click()
                expect(page.locator("#grab")).to_have_attribute("aria-expanded", "true")
            found = Axe().run(page)
            assert not found.response["violations"], found.generate_report()
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            if is_up:
                page.locator("#grab").click()
    page.set_viewport_size({"width": 1280, "height": 800})


def a_day_is_looked_at(page: Page) -> None:
    page.locator("#day-open").click()
    expect(page.locator("#day [role=button]").first).to_be_visible()
    everybody_can_use(page)
    page.locator("#day [role=button]").first.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#detail h2")).to_have_text(re.compile(r"^\d+:00 to \d+:00$"))
    everybody_can_use(page)
    page.keyboard.press("Escape")
    expect(page.locator("#day")).to_be_hidden()


def a_goal_is_sent_paused_and_goes_on(page: Page) -> None:
    page.keyboard.press("g")
    page.keyboard.type("(and (at parcel1 hall) (at parcel2 kitchen))")
    expect(page.locator("#goal-said")).to_have_class("said ok")
    expect(page.locator("#goal-look")).to_have_text(re.compile(r"^\d+ calls · \d+ s$"))
    page.keyboard.press("Enter")
    expect(page.locator("#goal-look")).to_be_empty()
    expect(page.locator("#task h2")).to_have_text("Parcel1 at hall, parcel2 at kitchen")
    expect(page.locator("#robots [data-robot=r1]")).to_be_visible()
    page.keyboard.press("p")
    expect(page.locator("#task .state")).to_have_text("paused")
    page.keyboard.press("p")
    expect(page.locator("#task .state")).to_have_text("running")
    page.keyboard.press("?")
    expect(page.locator("#keys")).to_be_visible()
    page.keyboard.press("Escape")


def a_robot_is_taken_and_given_back(page: Page) -> None:
    until_focused(page, "#robots [data-robot=r2]")
    page.keyboard.press("Enter")
    until_focused(page, "#detail form.take input")
    page.keyboard.type("the gripper is stuck")
    page.keyboard.press("Enter")
    expect(page.locator("#robots [data-robot=r2]")).to_contain_text("person")
    expect(page.locator("#detail")).to_contain_text(re.compile("in a person's hands since .*: the gripper is stuck"))
    everybody_can_use(page)
    assert not page.evaluate(COVERS), "what is said of a command covers nothing of the middle"
    heights = "new Set([...document.querySelectorAll('#lanes .planned rect')].map((each) => each.getAttribute('y'))).size"
    assert page.evaluate(heights) <= page.locator("#robots [data-robot]").count(), "a plan is one row of a robot, also of what it took over"
    until_focused(page, "#detail button[title^='have tasks use it again']")
    page.keyboard.press("Enter")
    expect(page.locator("#command-said")).to_have_text("✓ r2 is given back")
    expect(page.locator("#robots [data-robot=r2]")).not_to_contain_text("person")
