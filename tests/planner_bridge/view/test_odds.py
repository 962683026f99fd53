"""The odds of what is left of a plan, as the page shows them: by each record of a journal, and in a browser."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from planner_bridge.explanations.goal_now import packed
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.rates import Call, Counts, End, Rates, Times
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.loading import load
from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.pipeline.policy_odds import RestOfPlan
from planner_bridge.view.app import looked_at
from planner_bridge.view.follow import Reader
from planner_bridge.view.serving import PageProcess
from planner_bridge.view.story import Thing, view_of
from pnm.actions.faults import Faults
from pnm.core.logic.conditions import TRUE, Holds
from pnm.core.machine.plan_graph import PlanGraph
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.journals import GrowingJournal, steps
from tests.support.e2e.page.serving import asked, page_of
from tests.support.files import ROOT, written
from tests.support.pddl.chance import NEVER_FAILS, RIVER, to_the_island
from tests.support.processes import until

FAULTS = "faults: [{action: move, do: abort, chance: 0.5}]\n"
KNOWN = KnownRobots(Rates({Call("move", "move"): Counts({End.SUCCEEDED: 90, End.ABORTED: 10}, Times({80: 90}, 450_000))}, {"0": 1}))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def told(delivery: Path) -> dict[int, Thing]:
    """The only task after each record that there is one, as whoever follows the journal sees it."""
    reader = Reader(delivery, KNOWN)
    views = ((step.number, reader.at(step.number, view_of)) for step in steps(delivery))
    return {number: next(iter(view.tasks.values())) for number, view in views if view and view.tasks}


def test_a_goal_that_is_looked_at_has_odds_where_something_is_known_of_robots() -> None:
    problem = load(ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery" / "p01.pddl")
    text, world = packed(replace(problem, goal=Holds(("at", "r1", "hall")))), initial_knowledge(problem)
    known, unknown = looked_at(text, world, KNOWN), looked_at(text, world, NOTHING_KNOWN)
    assert (known["calls"], known["chance"], unknown["chance"]) == (1, "98.9 %", None), "two attempts of 90 %, by a rate that is not sure"
    assert 0.0 < known["seconds"] != unknown["seconds"]
    so_already = packed(replace(problem, goal=TRUE))
    assert looked_at(so_already, world, NOTHING_KNOWN)["calls"] == 0


def test_odds_rise_with_each_call_that_ends_and_are_gone_once_something_has_failed(told: dict[int, Thing]) -> None:
    last, seen, failures = 0.0, list[float](), set[int]()
    for number, task in told.items():
        odds = task["odds"]
        if odds is None:
            last = 0.0
            continue
        if odds["chance"] < last:  # an attempt has failed
            failures.add(number)
        assert 0.0 < odds["chance"] <= 1.0
        assert 0.0 <= odds["seconds"]["median"] <= odds["seconds"]["ninety_percent"]
        assert "learned from 100 of move: move" in odds["rests_on"] or "move" not in odds["rests_on"]
        last = odds["chance"]
        seen.append(last)
    assert len({*seen}) > 5
    assert len(failures) == 2
    assert max(seen) == pytest.approx(0.99), "the last call may fail twice"
    assert [task["odds"] for task in told.values()][-1] is None, "the task is over"
    assert any(task["odds"] is None and not task["code"] and len(task["runs"]) == 1 for task in told.values()), "a call has failed"


def test_who_looks_at_one_record_sees_the_same_odds(told: dict[int, Thing], delivery: Path) -> None:
    for number in sorted(told)[::7]:
        view = Reader(delivery, KNOWN).at(number, view_of)
        assert view is not None
        assert next(iter(view.tasks.values()))["odds"] == told[number]["odds"]


def test_odds_count_with_what_the_policy_has_after_each_outcome(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place, looked, chain = tmp_path / "journal", list[PlanGraph](), RestOfPlan.chain
    monkeypatch.setattr(RestOfPlan, "chain", lambda rest, *more: looked.append(rest.graph) or chain(rest, *more))
    assert achieve(None, RIVER, faults=Faults(drawn=to_the_island), journal=place).goal_reached
    reader = Reader(place, NEVER_FAILS)
    views = (reader.at(step.number, view_of) for step in steps(place))
    odds = (task["odds"] for view in views if view for task in view.tasks.values())
    assert [*dict.fromkeys(round(one["chance"], 6) for one in odds if one)] == [0.65, 0.8]
    assert len(looked) == 2, "a policy is looked at once for each stretch"


def test_what_follows_a_declared_outcome_is_no_replan(tmp_path: Path) -> None:
    result = achieve(None, RIVER, faults=Faults(drawn=to_the_island), journal=tmp_path / "journal")
    view = Reader(tmp_path / "journal").newest()
    (task,) = view.tasks.values()
    assert (result.replans, len(task["runs"])) == (0, 2)
    assert task["counts"] == str(result.counts)


def test_where_nothing_is_known_there_are_no_odds(delivery: Path) -> None:
    reader = Reader(delivery)
    views = (reader.at(step.number, view_of) for step in steps(delivery))
    assert not [task for view in views if view for task in view.tasks.values() if task["odds"]]


def test_the_page_says_the_chance_and_the_time_left_and_what_they_rest_on(
    chromium: Browser, growing: GrowingJournal, told: dict[int, Thing]
) -> None:
    record = next(number for number, task in told.items() if task["odds"])
    growing.grow(record)
    page = chromium.new_page()
    with page_of(growing.place, KNOWN) as url:
        page.goto(url)
        odds = page.locator("#task .odds")
        likely = r"\d+\.\d % likely to reach the goal without a new plan; in 90 % of such runs within \d+ s; .*learned from 100 of move"
        expect(odds).to_have_attribute("title", re.compile(likely))
        expect(page.locator("#task .stats")).to_contain_text(re.compile(r"\d+ s\s*to go"))
        page.get_by_role("button", name="more of the task").click()
        expect(page.locator("#detail")).to_contain_text("learned from 100 of move: move")
        first = odds.inner_text()
        later = next(number for number, task in told.items() if task["odds"] and task["odds"]["words"] != told[record]["odds"]["words"])
        growing.grow(later)
        expect(odds).to_contain_text(told[later]["odds"]["words"])
        assert odds.inner_text() != first
        growing.grow(growing.longest)
        expect(page.locator("#task")).to_contain_text("goal reached")
        expect(odds).to_have_count(0)
        page.close()


def test_the_page_of_a_command_knows_the_files_of_rates_and_of_faults(delivery: Path, told: dict[int, Thing], tmp_path: Path) -> None:
    rates, faults = written(tmp_path / "rates.yaml", KNOWN.rates.text()), written(tmp_path / "faults.yaml", FAULTS)
    record = next(number for number, task in told.items() if task["odds"])
    wrong, rests_on = written(tmp_path / "wrong.yaml", "journals: none"), told[record]["odds"]["rests_on"]
    for files, rests in (((rates, None), rests_on), ((rates, faults), "declared: load, move, unload"), ((wrong, None), None)):
        with PageProcess(0) as page:
            page.follow(str(delivery), *files)
            until(lambda url=page.url: asked(url, f"/state?at={record}")[0] == 200)  # type: ignore[misc]
            _, _, answer = asked(page.url, f"/state?at={record}")
        (task,) = json.loads(answer)["parts"]["tasks"].values()
        assert (task["odds"] or {}).get("rests_on") == rests
