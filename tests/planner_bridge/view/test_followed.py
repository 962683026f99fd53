"""What was taken of a policy, by each record of a journal, and how the page lights it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import TypeAlias
from xml.etree import ElementTree

import pytest
from playwright.sync_api import expect

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.model.plan import PlanningResult
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.policies.net import TakenBranch, followed
from planner_bridge.planning.policies.policy import Policy, Thinking, policies
from planner_bridge.tasks.result import TASKS, PolicyNote, notes_of
from planner_bridge.tasks.settings import Memory, Settings
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import Followed, Story
from pnm.actions.faults import Fault, Faults
from pnm.core.machine.plan_graph import GroundAction
from pnm.journal.resume import replayed
from tests.support.e2e.command_line import pnm
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.journals import steps
from tests.support.e2e.page.serving import asked, page_of

CUPS = parse_problem(
    "(define (problem mug) (:domain cups) (:init (on_table) (wet)) (:goal (held)))",
    parse_domain("""(define (domain cups) (:requirements :strips :negative-preconditions :non-deterministic)
  (:predicates (wet) (on_table) (on_floor) (held))
  (:action wipe :precondition (on_table) :effect (not (wet)))
  (:action pick :precondition (and (on_table) (not (wet)))
    :effect (oneof (and (held) (not (on_table))) (and (on_floor) (not (on_table))) (and)))
  (:action lift :precondition (on_floor) :effect (and (not (on_floor)) (on_table))))"""),
)
CAME = "3", "2", "3", "3", "2", "1"
"""The outcomes of the picks: missed, fallen, held."""
Told: TypeAlias = tuple[str, list[TakenBranch], int | None, tuple[str, ...], str]
"""The newest run, what was taken, what is under way, what the calls came to, and the picture."""
Seen: TypeAlias = dict[int, Told]


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place, coming = tmp_path_factory.mktemp("policy") / "journal", iter(CAME)

    def drawn(action: GroundAction, _: Random) -> Fault:
        return Fault(action.name, outcome=next(coming)) if action.name == "pick" else Fault(action.name, outcome="")

    assert achieve(None, CUPS, faults=Faults(drawn=drawn), journal=place).goal_reached
    return place


def told(story: Story) -> Told | None:
    """What is told of the policy; None while there is none."""
    run = [*story.runs.values()][-1] if story.runs else None
    found = run and Followed.by(story, run)
    if run is None or found is None:
        return None
    assert followed(found.policy, [(*one[:2], True) for one in found.runs])[1] is None, "nothing of a run that is over is under way"
    results = [result for one in story.runs.values() for result in one.last_results.values() if result.is_done]
    return run.id.hex, *followed(found.policy, found.runs), tuple(result.declared for result in results), found.picture()


@pytest.fixture(scope="module")
def seen(journal: Path) -> Seen:
    reader = Reader(journal)
    views = ((step.number, reader.at(step.number, told)) for step in steps(journal))
    return {number: view for number, view in views if view}


def test_the_branches_taken_are_the_outcomes_that_calls_had(seen: Seen) -> None:
    for _, taken, now, came, _ in seen.values():
        assert tuple(one.outcome for one in taken) == came
        assert not taken or now in (None, taken[-1].then), "what follows an outcome is under way"
    for before, after in pairwise(taken for _, taken, *_ in seen.values()):
        assert after[: len(before)] == before
    _, taken, now, *_ = [*seen.values()][-1]
    assert tuple(one.outcome for one in taken if one.outcome) == CAME
    assert (taken[0].step, taken[-1].then, now) == (1, 0, None)
    assert all(one.then == other.step for one, other in pairwise(taken))


def test_who_looks_at_one_record_sees_the_same(journal: Path, seen: Seen) -> None:
    with page_of(journal) as url:
        for number, (run, taken, now, _, picture) in [*seen.items()][::5]:
            status, kind, text = asked(url, f"/policy?run={run}&at={number}")
            assert (status, kind["content-type"].partition(";")[0], text) == (200, "image/svg+xml", picture)
            root = ElementTree.fromstring(text)
            lit = {box.get("data-step"): box.get("class") for box in root.iter() if box.get("data-step")}
            assert {step for step, look in lit.items() if look} == {str(step) for step in {*(one.step for one in taken), now} - {None}}
            assert [step for step, look in lit.items() if look == "now"] == ([str(now)] if now else [])
            paths = [part for part in root.iter() if part.tag.endswith("path") and "taken" in part.get("class", "")]
            assert len(paths) == len({*taken})
        assert asked(url, f"/policy?run={run}&at=1")[0] == 404


def test_the_page_lights_the_branch_that_was_taken(journal: Path, seen: Seen) -> None:
    last = {step.time: seen.get(step.number) for step in steps(journal)}
    moment = next(time for time, told in last.items() if told and len(told[1]) == 3 and told[2])
    with browser() as opened, page_of(journal) as url:
        page, said = opened.new_page(), list[str]()
        page.on("console", lambda message: said.append(message.text))
        page.goto(url)
        policy = page.locator("#policy")
        expect(policy.locator("path.taken")).to_have_count(5)
        expect(policy.locator("text.taken")).to_have_text(["1 33% ✓", "2 33% ✓ 2×", "3 33% ✓ 3×"])
        expect(policy.locator("g.now")).to_have_count(0)
        page.locator("#way").fill(f"{moment + 1e-6:.6f}")
        expect(policy.locator("text.taken")).to_have_text(["2 33% ✓", "3 33% ✓"])
        expect(policy.locator("g.now .name")).to_have_text(re.compile("lift"))
        said_there = "under way: #3 lift(); last: #2 pick(), which came out as 2; then 100.0% to the goal, 5.0 calls expected"
        expect(page.locator("#policy-said")).to_contain_text(said_there)
        assert not said


def test_the_history_says_of_a_policy_what_the_page_says(journal: Path) -> None:
    told = "last: #2 pick(), which came out as 1"
    assert f"policy  {told}" in pnm("history", "-v", str(journal)).stdout
    (listed,) = map(json.loads, pnm("history", "--json", "-v", str(journal)).stdout.splitlines())
    assert listed["policy"] == told


def test_what_is_under_way_is_told_with_what_is_to_be_expected_from_there(journal: Path) -> None:
    reader, words = Reader(journal), set[str]()
    for step in steps(journal):
        found = reader.at(step.number, lambda story: Followed.by(story, [*story.runs.values()][-1]) if story.runs else None)
        words |= {str(found)} if found else set()
    assert "under way: #2 pick(); last: #2 pick(), which came out as 3; then 100.0% to the goal, 4.0 calls expected" in words
    assert not any("then" in one for one in words if one.endswith("came out as 1")), "the goal holds"


class Found(Thinking):
    """Policies that are found by hand."""

    def __init__(self, *policies: Policy) -> None:
        self.problem, self.found, self.fallback = CUPS, policies, None
        self._followed, self._left = set(), set()


def test_a_better_policy_that_is_found_at_work_is_noted_when_it_is_followed(tmp_path: Path) -> None:
    best = [*policies(CUPS, 60.0)][-1]
    found, coming = Found(replace(best, chance=0.9)), iter(CAME)

    class Known(Memory):
        def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
            return replace(search(timeout), policy=found)

    def drawn(action: GroundAction, _: Random) -> Fault:
        came = next(coming) if action.name == "pick" else ""
        if came == CAME[1]:
            found.found = best, *found.found
        return Fault(action.name, outcome=came)

    assert achieve(None, CUPS, settings=Settings(memory=Known()), faults=Faults(drawn=drawn), journal=tmp_path / "journal").goal_reached
    (task,) = JournalHistory.read(tmp_path / "journal").tasks.values()
    assert [run.policy and run.policy.chance for run in task.own_runs] == [0.9, 0.9, *[1.0] * 4]
    (kept,) = replayed(tmp_path / "journal", TASKS).tasks.values()
    assert notes_of(kept, PolicyNote)[-1].chance == 1.0, "as a resume has it"
    assert task.policy is not None
    restored = task.policy.policy(CUPS)
    assert restored is not None
    assert restored.entries == best.entries


def test_a_task_whose_actions_have_one_outcome_has_no_policy(delivery: Path) -> None:
    reader = Reader(delivery)
    assert not [step.number for step in steps(delivery)[::20] if reader.at(step.number, told)]
