"""The page in a browser: what lights up, what can be read, the way back, on wide and on narrow screens."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import pytest
from playwright.sync_api import Browser, FloatRect, Page, expect

from planner_bridge.view.follow import Reader
from planner_bridge.view.story import view_of
from pnm.journal.records import Happened
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.journals import GrowingJournal, steps
from tests.support.e2e.page.serving import page_of

FAILING = "move(r1, hall, kitchen)"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    """A page that must say nothing on its console: no error, and nothing that was kept from it; servers may go away."""
    opened, said = chromium.new_page(), list[str]()
    opened.on("console", lambda message: said.append(message.text) if "net::ERR_" not in message.text else None)
    opened.on("pageerror", lambda error: said.append(str(error)))
    yield opened
    opened.close()
    assert not said


def shows(page: Page, record: int) -> None:
    """Wait until the page shows what was so after a record."""
    expect(page.locator("body")).to_have_attribute("data-record", str(record))


def states(page: Page) -> dict[str, str]:
    """The states of the calls of the plan that is shown, by what they do."""
    boxes = page.locator("#picture [data-step]")
    return {str(box.get_attribute("aria-label")).partition(":")[0]: str(box.get_attribute("data-state")) for box in boxes.all()}


def expect_states(page: Page, journal: Path, record: int) -> None:
    """The boxes of the newest plan have the states that the journal tells."""
    view = Reader(journal).at(record, view_of)
    assert view is not None
    run = next(iter(view.tasks.values()))["runs"][-1]
    calls = [call for call in view.calls.values() if call["run"] == run]
    for call in calls:
        box, action = page.locator('#picture [data-step="{index}"]'.format(**call)), re.escape(call["action"])
        expect(box).to_have_attribute("data-state", call["state"])
        expect(box).to_have_attribute("aria-label", re.compile(f"^{action}: "))
    assert len(states(page)) == len(calls)


def goes_to(page: Page, time: float) -> None:
    """Go to a moment, in seconds of the run."""
    way = page.get_by_label("time", exact=True)
    way.evaluate("(way, time) => { way.value = time; way.dispatchEvent(new Event('input')); }", time)
    expect(page.locator("#status")).to_have_text("history")


def test_calls_light_up_as_the_journal_grows(page: Page, delivery: Path, growing: GrowingJournal) -> None:
    growing.grow(5)
    with page_of(growing.place) as url:
        page.goto(url)
        shows(page, 5)
        expect(page.locator("#task-list button")).to_have_count(1)
        expect(page.locator("#plan")).to_be_hidden()
        expect(page.locator("#policy")).to_be_hidden()
        happened = [step.number for step in steps(delivery) if isinstance(step.record, Happened) and (step.commands or step.fired)]
        for record in [*happened[::3], growing.longest]:
            growing.grow(record)
            shows(page, record)
            expect_states(page, growing.place, record)
        expect(page.locator("#task")).to_contain_text("goal reached")
        expect(page.locator("#task h2")).to_have_text("Parcel1 at hall, parcel2 at kitchen")
    expect(page.locator("#status")).to_contain_text("not connected")


def test_a_failure_can_be_read_and_what_followed(page: Page, delivery: Path) -> None:
    with page_of(delivery) as url:
        page.goto(url)
        expect(page.locator("#pill")).to_have_text("nothing needs you")
        expect(page.locator("#changes")).to_have_text(re.compile("1 kept.*1 dropped.*4 added"))
        expect(page.locator("#lanes .newplan")).to_have_count(2)
        expect(page.locator("#picture .added")).to_have_count(4)
        trouble = page.locator("#detail .trouble", has_text="Move r1 hall kitchen failed").first
        expect(trouble.locator(".expected")).to_have_text("success")
        expect(trouble.locator(".observed")).to_have_text("the way is blocked")
        expect(trouble).to_contain_text("a new plan is needed")
        kinds = [event["mark"] for event in Reader(delivery).newest().events.values()]
        assert (kinds.count("failure"), kinds.count("replan"), kinds.count("end")) == (4, 2, 1)
        counts = [int(str(mark.get_attribute("data-count"))) for mark in page.locator("#marks [data-mark]").all()]
        assert sum(counts) == 7, "every mark is there, or counted where it has no room"
        expect(page.locator("#marks [data-mark=end]")).to_have_count(1)
        page.close()


def test_a_dropped_call_stays_until_the_new_plan_gets_on_and_flags_show_what_reaches_the_goal(page: Page, delivery: Path) -> None:
    view = Reader(delivery).newest()
    changed = next(run["time"] for run in view.runs.values() if run["replan"] and run["replan"]["dropped"])
    marks = {int(number): event for number, event in view.events.items() if event["mark"]}
    record = next(number for number, event in marks.items() if (event["mark"], event["time"]) == ("replan", changed))
    with page_of(delivery) as url:
        page.goto(url)
        gone = page.locator("#picture .dropped")
        flagged = page.locator("#picture [data-step]:has(use[href='#i-flag'])")
        expect(flagged).to_have_count(1)
        expect(flagged).to_have_attribute("aria-label", re.compile(r"^unload\(r1, parcel2, kitchen\): "))
        expect(gone).to_have_count(0)
        for number in takewhile(lambda number: number >= record, reversed(marks)):
            page.keyboard.press("Shift+ArrowLeft")
            shows(page, number)
        expect(gone).to_have_count(1)
        expect(gone).to_have_attribute("aria-label", re.compile(f"^{re.escape(FAILING)}: "))
        gone.click()
        expect(page.locator("#detail .steps")).to_be_visible()
        expect(page.locator("#detail .sub")).to_contain_text("kitchen")
        expect(page.locator("#plan-title")).to_have_text("New plan")
        page.close()


def test_no_two_texts_and_no_signs_stand_upon_each_other(page: Page, delivery: Path) -> None:
    for width in (400, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        with page_of(delivery) as url:
            page.goto(url)
            shows(page, Reader(delivery).newest().number)
            for picture in ("#lanes", "#picture"):
                texts = page.locator(f"{picture} svg text:not(:empty)")
                expect(texts.first).to_be_visible()
                boxes = [(text.text_content(), box) for text in texts.all() if (box := text.bounding_box()) and box["width"]]
                assert boxes
                clashes = [(one[0], other[0]) for place, one in enumerate(boxes) for other in boxes[:place] if _overlap(one[1], other[1])]
                assert not clashes, f"{picture} at {width}: {clashes}"
    page.close()


def _overlap(one: FloatRect, other: FloatRect) -> bool:
    beside = one["x"] + one["width"] <= other["x"] + 1 or other["x"] + other["width"] <= one["x"] + 1
    return not (beside or one["y"] + one["height"] <= other["y"] + 3 or other["y"] + other["height"] <= one["y"] + 3)


def test_the_page_has_four_sizes_of_type_and_never_scrolls(page: Page, delivery: Path) -> None:
    with page_of(delivery) as url:
        for width, height in ((1280, 800), (400, 800), (1920, 1080)):
            page.set_viewport_size({"width": width, "height": height})
            page.goto(url)
            shows(page, Reader(delivery).newest().number)
            expect(page.locator("#picture [data-step]").first).to_be_attached()
            sizes = page.evaluate("[...new Set([...document.querySelectorAll('body *')].map((each) => getComputedStyle(each).fontSize))]")
            assert set(sizes) <= {"12px", "13px", "15px", "20px"}
            page_is = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
            assert page_is == [width, height]
        page.close()


def test_the_keys_go_through_time(page: Page, delivery: Path) -> None:
    last = Reader(delivery).newest().number
    ends = [int(number) for number, event in Reader(delivery).newest().events.items() if event["mark"]]
    with page_of(delivery) as url:
        page.goto(url)
        shows(page, last)
        for record in reversed(ends):
            page.keyboard.press("Shift+ArrowLeft")
            shows(page, record)
        for record in ends[1:3]:
            page.keyboard.press("Shift+ArrowRight")
            shows(page, record)
        page.keyboard.press("ArrowLeft")
        expect(page.locator("body")).not_to_have_attribute("data-record", str(ends[2]))
        goes_to(page, 4.0)
        record = max(step.number for step in steps(delivery) if step.time <= 4.0)
        shows(page, record)
        expect_states(page, delivery, record)
        expect(page.locator("#where")).to_have_text(re.compile(r"^\d\d:\d\d:\d\d$"))
        page.keyboard.press("2")
        expect(page.locator("#tab-facts")).to_have_attribute("aria-selected", "true")
        expect(page.locator("#facts")).not_to_contain_text("(at parcel1 hall)")
        page.keyboard.press("End")
        shows(page, last)
        expect(page.locator("#facts")).to_contain_text("(at parcel1 hall)")
        page.close()


def test_the_timeline_is_zoomed_and_moved(page: Page, delivery: Path) -> None:
    with page_of(delivery) as url:
        page.goto(url)
        bars = page.locator("#lanes .bar[data-call]")
        expect(bars).to_have_count(15)
        one = bars.first
        before = one.bounding_box()
        page.get_by_label("zoom in").click()
        expect(bars).not_to_have_count(15)
        for _ in range(3):
            page.keyboard.press("+")
        page.keyboard.press("0")
        expect(bars).to_have_count(15)
        assert one.bounding_box() == before
        box = page.locator("#lanes").bounding_box()
        assert box
        page.mouse.move(box["x"] + box["width"] - 20, box["y"] + 40)
        page.keyboard.down("Control")
        page.mouse.wheel(0, -300)
        page.keyboard.up("Control")
        expect(bars).not_to_have_count(15)
        page.close()


def when_tried_again(journal: Path, call: int) -> int:
    """The first record after which the second attempt at a call goes on."""
    for step in steps(journal):
        view = Reader(journal).at(step.number, view_of) if isinstance(step.record, Happened) else None
        tries = [one for one in view.requests.values() if one["call"] == call] if view else []
        if len(tries) == 2 and tries[-1]["accepted"] is not None and tries[-1]["ended"] is None:
            return step.number
    raise AssertionError(f"call {call} is not tried again")


def test_a_call_opens_by_keys_and_says_why_it_is_there(page: Page, delivery: Path, growing: GrowingJournal) -> None:
    growing.grow(when_tried_again(delivery, 4))
    with page_of(growing.place) as url:
        page.goto(url)
        page.locator('#picture [data-step="4"]').focus()
        page.keyboard.press("Enter")
        call = page.locator("#detail")
        expect(call.locator("h2")).to_have_text("move")
        expect(call.locator(".steps [aria-current=step]")).to_contain_text("running")
        expect(call.locator(".attempt")).to_have_count(2)
        call.get_by_text("More of this call").click()
        expect(call).to_contain_text("move(r1, store, hall)")
        page.get_by_role("button", name="Why this call, why now?").click()
        answers = page.locator("#why-block .why > li")
        expect(answers.first).to_contain_text("is needed")
        expect(answers.first.locator("li").first).to_be_visible()
        expect(call.locator("#net")).to_be_hidden()
        call.get_by_text("Its net").click()
        expect(call.locator('[data-place="running"]')).to_have_class("marked")
        for state, said in (("succeeded", "it has left the block"), ("waiting", "it has not reached the block"), ("running", "marked: ")):
            page.locator(f"#picture [data-state={state}]").first.click()
            expect(page.locator("#net")).to_contain_text(said)
        page.locator("#robots [data-robot=r1]").click()
        expect(call.locator("h2")).to_have_text("r1")
        expect(call).to_contain_text("r1 carries parcel2")
        page.keyboard.press("l")
        expect(call.locator(".steps")).to_be_visible()
        page.close()
