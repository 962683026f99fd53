"""The page in a browser: what lights up, what can be read, the way back, on wide and on narrow screens."""

from __future__ import annotations

import re
from collections.abc import Iterator
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


def test_calls_light_up_as_the_journal_grows(page: Page, delivery: Path, growing: GrowingJournal) -> None:
    growing.grow(5)
    with page_of(growing.place) as url:
        page.goto(url)
        shows(page, 5)
        expect(page.locator("#lanes")).to_contain_text("nothing has begun yet")
        happened = [step.number for step in steps(delivery) if isinstance(step.record, Happened) and (step.commands or step.fired)]
        for record in [*happened[::3], growing.longest]:
            growing.grow(record)
            shows(page, record)
            expect_states(page, growing.place, record)
        expect(page.locator(".task")).to_contain_text("goal reached")
    expect(page.locator("#status")).to_contain_text("not connected")


def test_a_failure_can_be_read_and_what_followed(page: Page, delivery: Path) -> None:
    marked = [(int(number), " ".join(event["lines"])) for number, event in Reader(delivery).newest().events.items() if event["mark"]]
    failed = next(number for number, lines in marked if "aborted" in lines and "give_up" in lines)
    with page_of(delivery) as url:
        page.goto(url)
        page.get_by_label("record", exact=True).fill(str(failed))
        shows(page, failed)
        need = page.locator("#needs > .need").first
        expect(need).to_contain_text(f"{FAILING} failed: aborted")
        expect(need.locator(".expected")).to_have_text("success")
        expect(need.locator(".observed")).to_have_text("the way is blocked")
        page.get_by_role("button", name="Live").click()
        expect(page.locator("#status")).to_have_text("● live")
        expect(page.locator("#needs > p")).to_have_text("nothing")
        expect(page.locator("#cuts li")).to_have_count(2)
        expect(page.locator("#cuts li").last).to_contain_text(f"not again: {FAILING}")
        expect(page.locator("#cuts li").last).to_contain_text("added: ")
        for mark, count in (("failure", 4), ("replan", 2), ("end", 1)):
            expect(page.locator(f"#marks [data-mark={mark}]")).to_have_count(count)
        page.close()


def test_the_signs_of_calls_and_words_of_the_key_stand_where_they_can_be_read(page: Page, delivery: Path) -> None:
    page.set_viewport_size({"width": 400, "height": 800})
    with page_of(delivery) as url:
        page.goto(url)
        shows(page, Reader(delivery).newest().number)
        for entry in page.locator(".key > span").all():
            box = entry.bounding_box()
            assert box
            assert box["height"] < 30, "a sign and its word are in one line"
        facts, signs = page.locator("#picture .fact").all(), page.locator("#picture .badge circle").all()
        assert facts
        assert signs
        boxes = [(fact.bounding_box(), sign.bounding_box()) for fact in facts for sign in signs]
        assert not [pair for pair in boxes if pair[0] and pair[1] and _overlap(pair[0], pair[1])]
        page.close()


def _overlap(one: FloatRect, other: FloatRect) -> bool:
    beside = one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
    return not (beside or one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"])


def test_the_scrubber_goes_back_and_forth_by_keys(page: Page, delivery: Path) -> None:
    last = Reader(delivery).newest().number
    with page_of(delivery) as url:
        page.goto(url)
        shows(page, last)
        way = page.get_by_label("record", exact=True)
        way.focus()
        for record in (last - 1, last - 2):
            page.keyboard.press("ArrowLeft")
            shows(page, record)
        page.locator("h1").click()
        way.blur()
        page.keyboard.press("ArrowRight")
        shows(page, last - 1)
        for _ in range(10):  # faster than any answer
            page.keyboard.press("ArrowLeft")
        shows(page, last - 11)
        way.fill(str(last - 1))
        shows(page, last - 1)
        page.get_by_role("button", name="✕◀").click()  # the last thing that is marked before that: why there is a new plan
        record = int(str(page.locator("body").get_attribute("data-record")))
        expect(page.locator("#status")).to_contain_text("history")
        way.fill("20")
        shows(page, 20)
        expect_states(page, delivery, 20)
        expect(page.locator("#facts")).not_to_contain_text("(at parcel1 hall)")
        assert record < last
        page.get_by_role("button", name="Live").click()
        shows(page, last)
        expect(page.locator("#facts")).to_contain_text("(at parcel1 hall)")
        page.close()


def when_tried_again(journal: Path, call: int) -> int:
    """The first record after which the second attempt at a call goes on."""
    for step in steps(journal):
        view = Reader(journal).at(step.number, view_of) if isinstance(step.record, Happened) else None
        tries = [one for one in view.requests.values() if one["call"] == call] if view else []
        if len(tries) == 2 and tries[-1]["accepted"] is not None and tries[-1]["ended"] is None:
            return step.number
    raise AssertionError(f"call {call} is not tried again")


def test_a_call_opens_by_keys_and_says_why_it_is_there(page: Page, delivery: Path) -> None:
    with page_of(delivery) as url:
        page.goto(url)
        record = when_tried_again(delivery, 4)
        page.get_by_label("record", exact=True).fill(str(record))
        shows(page, record)
        page.locator('#picture [data-step="4"]').focus()
        page.keyboard.press("Enter")
        expect(page.locator("#call-choice")).to_have_value(re.compile("/4$"))
        call = page.locator("#detail")
        expect(call).to_contain_text("the end of #2 move(r1, store, hall)")
        expect(call.locator('[data-place="running"]')).to_have_class("marked")
        expect(call.locator(".attempts tbody tr")).to_have_count(2)
        page.get_by_role("button", name="Why this call, why now?").click()
        answers = page.locator("#why-block .why > li")
        expect(answers.first).to_contain_text("is needed")
        expect(answers.first.locator("li").first).to_be_visible()
        expect(page.locator("#why-block")).to_contain_text(f"after record {record}")
        for state, said in (("succeeded", "it has left the block"), ("waiting", "it has not reached the block"), ("running", "marked: ")):
            page.locator(f"#picture [data-state={state}]").first.click()
            expect(page.locator("#net")).to_contain_text(said)
        page.close()
