"""The view and its story: what is shown of a run that fails, goes on, and is planned anew; and what a state alone does not say."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import Story, Thing, View, detail, timelines, view_of
from pnm.core.execution.events import Begin
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.requests import Ended, OutcomeKind
from pnm.core.resources import Hand
from pnm.journal.records import (
    WORLD,
    HandPut,
    Happened,
    KnowledgeBegan,
    KnowledgeDelta,
    RunMade,
    SharedBegan,
    TaskAccepted,
    TaskNoted,
    TaskOver,
)
from pnm.journal.replay import ReplayStep
from pnm.knowledge.people import HelpAsked, HelpEnded
from pnm.tasks import Wanted
from tests.support.e2e.page.journals import steps
from tests.support.files import written

FAILING = "move(r1, hall, kitchen)"


@pytest.fixture(scope="module")
def records(delivery: Path) -> list[ReplayStep]:
    return steps(delivery)


@pytest.fixture(scope="module")
def reader(delivery: Path) -> Reader:
    return Reader(delivery)


@pytest.fixture
def last(reader: Reader) -> View:
    """The view after the last record."""
    return reader.newest()


def at(reader: Reader, step: ReplayStep) -> View:
    view = reader.at(step.number, view_of)
    assert view is not None
    return view


def task_at(reader: Reader, step: ReplayStep) -> Thing:
    """The only task, after a record."""
    (task,) = at(reader, step).tasks.values()
    return task


def failing_ends(records: list[ReplayStep]) -> list[ReplayStep]:
    """The records in which a request ends without success."""
    return [
        step
        for step in records
        if isinstance(step.record, Happened) and isinstance(step.record.event, Ended) and step.record.event.outcome.message
    ]


def test_a_task_is_planned_for_runs_is_planned_for_again_after_a_failure_and_is_over(reader: Reader, records: list[ReplayStep]) -> None:
    accepted = next(step for step in records if isinstance(step.record, TaskAccepted))
    begins = next(step for step in records if isinstance(step.record, Happened) and isinstance(step.record.event, Begin))
    over = next(step for step in records if isinstance(step.record, TaskOver))
    first, again, anew = (records[step.number - 2] for step in records if isinstance(step.record, RunMade))
    shown = [task_at(reader, step) for step in (accepted, first, begins, again, anew, records[over.number - 2], over)]
    assert [task["state"] for task in shown] == ["queued", "planning", "running", "running", "planning", "running", "over"]
    assert [task["reason"].partition(":")[0] for task in shown[3:5]] == ["the rest of the plan still works", "a new plan is needed"]
    assert (shown[-1]["code"], shown[-1]["reason"], len(shown[-1]["runs"])) == ("goal_reached", "the goal holds", 3)


def test_a_failure_is_told_with_what_was_expected_and_seen_and_what_followed(reader: Reader, records: list[ReplayStep]) -> None:
    first, second, *_ = failing_ends(records)
    (hindered,) = at(reader, first).troubles.values()
    said = {"step": FAILING, "cause": "aborted", "expected": "success", "observed": "the way is blocked", "is_failure": False}
    assert hindered.items() >= {**said, "followed": "tried again, attempt 2"}.items()
    failed = list(at(reader, second).troubles.values())[-1]
    assert (failed["is_failure"], failed["observed"], failed["followed"]) == (True, "the way is blocked", "")
    assert "has failed: aborted" in task_at(reader, second)["reason"]
    assert next(iter(at(reader, records[-1]).troubles)) == f"{first.number}.0", "what happened keeps its name"


def test_attempts_facts_and_servers_are_those_of_the_records(last: View) -> None:
    failing = [request for request in last.requests.values() if request["action"] == FAILING]
    assert [(request["attempt"], request["sent"], request["ended"], request["outcome"]) for request in failing][:2] == [
        (1, 8.0, 10.0, "aborted"),
        (2, 10.0, 12.0, "aborted"),
    ]
    assert {call["lane"] for call in last.calls.values()} == {"r1", "r2"}
    assert last.servers["/r1/move"]["failed"] == 4
    assert not any(server["busy"] for server in last.servers.values())
    carried = last.facts["(at parcel1 hall)"]
    assert (carried["value"], carried["since"], carried["is_initial"]) == ("true", 14.0, False)
    assert last.facts["(connected hall kitchen)"]["is_initial"]
    assert {fact["source"] for fact in last.facts.values()} == {"sensed", "assumed"}


def test_what_is_marked_on_the_way_through_the_records(last: View, records: list[ReplayStep]) -> None:
    marks = {int(number): event["mark"] for number, event in last.events.items() if event["mark"]}
    replans = [step.number for step in records if isinstance(step.record, RunMade)][1:]
    over = [step.number for step in records if isinstance(step.record, TaskOver)]
    failures = [step.number for step in failing_ends(records)]
    assert marks == {**dict.fromkeys(failures, "failure"), **dict.fromkeys(replans, "replan"), **dict.fromkeys(over, "end")}


def told(reader: Reader, step: ReplayStep, action: str) -> dict[str, Any]:
    """The detail of the first call of an action in the newest run."""
    run = task_at(reader, step)["runs"][-1]
    index = next(call["index"] for call in at(reader, step).calls.values() if (call["run"], call["action"]) == (run, action))
    found = reader.at(step.number, lambda story: detail(story, UUID(run), index))
    assert found is not None
    return found


def test_a_call_tells_what_it_waits_for_its_conditions_and_where_its_token_is(reader: Reader, records: list[ReplayStep]) -> None:
    first = failing_ends(records)[0]
    unload = told(reader, first, "unload(r1, parcel2, kitchen)")
    waits = {wait["action"]: (wait["has_come"], wait["protects"]) for wait in unload["waits_for"]}
    assert waits[FAILING] == (False, ["(at r1 kitchen)"])
    assert waits["load(r1, parcel2, store)"][0]
    truths = {check["text"]: (check["truth"], check["source"]) for check in unload["checks"]}
    assert truths["(at r1 kitchen)"] == ("false", "sensed")
    assert truths["(carries r1 parcel2)"] == ("true", "sensed")
    reads = {read["name"]: read for check in unload["checks"] for read in check["reads"]}
    assert (reads["(at r1 kitchen)"]["value"], reads["(at r1 kitchen)"]["source"]) == ("false", "sensed")
    known, carries = at(reader, first).facts["(carries r1 parcel2)"], reads["(carries r1 parcel2)"]
    assert (carries["value"], carries["since"], carries["is_initial"]) == ("true", known["since"], False)
    assert not [place for place in unload["places"] if place["tokens"] and place["name"] != "budget"]
    moving = told(reader, first, FAILING)
    assert {place["name"]: place["tokens"] for place in moving["places"] if place["tokens"]} == {"requested": 1, "spent": 1}
    assert "accepted" in {transition["name"] for transition in moving["transitions"] if transition["is_enabled"]}
    assert moving["resources"] == []
    for run, index in ((UUID(moving["run"]), 99), (UUID(int=0), 0)):
        assert reader.at(first.number, lambda story, run=run, index=index: detail(story, run, index)) is None  # type: ignore[misc]


# --- the story ---


AT = ("at", "r1", "hall")


def story_of(*records: object) -> Story:
    """A story of the world, and of records that follow one second after the other."""
    story = Story()
    for number, record in enumerate((SharedBegan({}), KnowledgeBegan(WORLD, {AT: True}, sensed={"at": 0.5}), *records), 1):
        story.apply(number, float(number), record)
    return story


def test_what_is_not_reported_any_more_says_what_it_was() -> None:
    stale = story_of(KnowledgeDelta(WORLD, {AT: UNKNOWN})).facts["(at r1 hall)"]
    assert (stale["value"], stale["was"], stale["source"], stale["since"]) == ("unknown", "true", "sensed", 3.0)
    still = story_of(KnowledgeDelta(WORLD, {AT: UNKNOWN}), KnowledgeDelta(WORLD, {AT: UNKNOWN})).facts["(at r1 hall)"]
    assert (still["value"], still["was"]) == ("unknown", "true")
    again = story_of(KnowledgeDelta(WORLD, {AT: UNKNOWN}), KnowledgeDelta(WORLD, {AT: False})).facts["(at r1 hall)"]
    assert (again["value"], again["was"]) == ("false", "")


def test_the_clock_is_known_from_a_task_on() -> None:
    assert story_of().clock is None
    accepted = TaskAccepted(Wanted(UUID(int=1), "(at r1 hall)"), 1, 1000.0)
    assert story_of(accepted).clock == 997.0
    assert view_of(story_of(accepted)).clock == 997.0


def test_questions_about_lost_requests_stand_beside_those_how_to_go_on() -> None:
    task, one, other = UUID(int=1), UUID(int=8), UUID(int=9)
    records = [
        TaskAccepted(Wanted(task, "(at r1 hall)"), 1, 1000.0),
        TaskNoted(task, HelpAsked(one, "Was it carried out?", ("yes", "no"), one)),
        TaskNoted(task, HelpAsked(other, "How does it go on?")),
        TaskNoted(task, HelpEnded("a person says so", one)),
        TaskNoted(task, HelpEnded("a person says that it is to be tried again")),
    ]
    asked = [{name: question["choices"] for name, question in story_of(*records[:count]).questions.items()} for count in range(2, 6)]
    assert asked[1] == {one.hex: ("yes", "no"), other.hex: ("try again", "give up")}
    assert asked[0] == {one.hex: ("yes", "no")}
    assert asked[2:] == [{other.hex: ("try again", "give up")}, {}]


# --- timelines ---


def test_a_plan_by_hand_has_lanes_by_what_its_actions_have_for_themselves(tmp_path: Path) -> None:
    plan = written(
        tmp_path / "plan.yaml",
        "actions:\n  say: {params: [text], resources: [voice]}\n  point: {params: [place], resources: [r1/arm]}\n"
        "plan:\n  - say: {text: Hello you}\n  - point: {place: hall}\n",
    )
    assert carry_out(plan, journal=tmp_path / "j").goal_reached
    (timeline,) = timelines(tmp_path / "j")
    assert [(call.name, call.lane) for call in timeline.plans[0].calls] == [("say(Hello you)", "voice"), ("point(hall)", "r1")]
    assert all(attempt.outcome is OutcomeKind.SUCCEEDED for call in timeline.plans[0].calls for attempt in call.attempts)


def test_what_people_have_in_their_hands_is_shown_until_it_is_given_back() -> None:
    story, hand = Story(), Hand("r1", 0.0, "stuck", "ada")
    for number, record in enumerate((SharedBegan({}), KnowledgeBegan(WORLD, {}), HandPut(hand, is_taken=True)), 1):
        story.apply(number, 0.0, record)
    assert view_of(story).hands == {"r1": {"words": str(hand)}}
    assert "r1 is in the hands of ada since " in view_of(story).hands["r1"]["words"]
    story.apply(4, 1.0, HandPut(hand, is_taken=False))
    assert not view_of(story).hands
    assert [event["lines"] for event in view_of(story).events.values()][-1] == ("r1 is given back",)
