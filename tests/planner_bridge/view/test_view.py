"""The view: what is shown of a run that fails, goes on, and is planned anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.view.follow import Reader
from planner_bridge.view.story import Thing, View, detail, view_of
from pnm.core.execution.events import Begin
from pnm.core.machine.requests import Ended
from pnm.journal.records import Happened, RunMade, TaskAccepted, TaskOver
from pnm.journal.replay import ReplayStep
from tests.support.e2e.page.journals import steps

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


def test_a_replan_says_why_and_what_becomes_of_the_calls_that_were_left(last: View) -> None:
    (task,) = last.tasks.values()
    first, second, third = (last.runs[id]["replan"] for id in task["runs"])
    assert first is None
    assert "still works" in second["why"]
    assert (second["kept"], second["dropped"], second["added"]) == ((FAILING, "unload(r1, parcel2, kitchen)"), (), ())
    assert f"not again: {FAILING}" in third["why"]
    assert third["dropped"] == (FAILING,)
    assert "pass_door(r1, door1, corridor, kitchen)" in third["added"]


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
