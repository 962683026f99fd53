"""The view: what is shown of a run that fails, goes on, and is planned anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.view.follow import Reader
from planner_bridge.view.shown import View
from planner_bridge.view.story import Story, detail, view_of
from pnm.core.execution.events import Begin
from pnm.core.machine.requests import Ended
from pnm.journal.records import Happened, RunMade, TaskAccepted, TaskOver
from pnm.journal.replay import ReplayStep
from tests.support.e2e.page.journals import steps
from tests.support.tasks.scenarios.random_scenarios import run_scenario

FAILING = "move(r1, hall, kitchen)"


@pytest.fixture(scope="module")
def records(delivery: Path) -> list[ReplayStep]:
    return steps(delivery)


@pytest.fixture
def reader(delivery: Path) -> Reader:
    return Reader(delivery)


def at(reader: Reader, step: ReplayStep) -> View:
    view = reader.at(step.number, view_of)
    assert view is not None
    return view


def failing_ends(records: list[ReplayStep]) -> list[ReplayStep]:
    """The records in which a request ends without success."""
    return [
        step
        for step in records
        if isinstance(step.record, Happened) and isinstance(step.record.event, Ended) and step.record.event.outcome.message
    ]


def test_a_task_is_planned_for_runs_and_is_over(reader: Reader, records: list[ReplayStep]) -> None:
    accepted = next(step for step in records if isinstance(step.record, TaskAccepted))
    begins = next(step for step in records if isinstance(step.record, Happened) and isinstance(step.record.event, Begin))
    over = next(step for step in records if isinstance(step.record, TaskOver))
    made = next(step for step in records if isinstance(step.record, RunMade))
    states = [next(iter(at(reader, step).tasks.values())).state for step in (accepted, records[made.number - 2], begins, over)]
    assert states == ["queued", "planning", "running", "over"]
    ended = next(iter(at(reader, over).tasks.values()))
    assert (ended.code, ended.reason, len(ended.runs)) == ("goal_reached", "the goal holds", 3)


def test_the_states_of_calls_are_what_the_replay_says(reader: Reader, records: list[ReplayStep]) -> None:
    for step in records:
        view, results = at(reader, step), reader.at(step.number, _results)
        assert {(call.run, call.index): call.state for call in view.calls.values()} == results


def _results(story: Story) -> dict[tuple[str, int], str]:
    runs = ((id.hex, replayed.result.calls if replayed.result else replayed.run.results) for id, replayed in story.replay.runs.items())
    return {(run, result.call.index): result.kind.name.lower() for run, results in runs for result in results}


def test_a_failure_is_told_with_what_was_expected_and_seen_and_what_followed(reader: Reader, records: list[ReplayStep]) -> None:
    first, second, *_ = failing_ends(records)
    (hindered,) = at(reader, first).troubles.values()
    assert (hindered.step, hindered.cause, hindered.expected, hindered.observed) == (FAILING, "aborted", "success", "the way is blocked")
    assert (hindered.is_failure, hindered.followed) == (False, "tried again, attempt 2")
    failed = list(at(reader, second).troubles.values())[-1]
    assert (failed.is_failure, failed.observed, failed.followed) == (True, "the way is blocked", "")
    assert "has failed: aborted" in next(iter(at(reader, second).tasks.values())).reason
    later = next(iter(at(reader, records[-1]).troubles.items()))
    assert later[0] == f"{first.number}.0", "what happened keeps its name"


def test_a_replan_says_why_and_what_becomes_of_the_calls_that_were_left(reader: Reader, records: list[ReplayStep]) -> None:
    view = at(reader, records[-1])
    first, second, third = (view.runs[id] for id in next(iter(view.tasks.values())).runs)
    assert first.replan is None
    assert second.replan is not None
    assert third.replan is not None
    assert "still works" in second.replan.why
    assert (second.replan.kept, second.replan.dropped, second.replan.added) == ((FAILING, "unload(r1, parcel2, kitchen)"), (), ())
    assert f"not again: {FAILING}" in third.replan.why
    assert third.replan.dropped == (FAILING,)
    assert "pass_door(r1, door1, corridor, kitchen)" in third.replan.added
    made = [step.number for step in records if isinstance(step.record, RunMade)]
    assert [run.record for run in (first, second, third)] == made


def test_attempts_have_their_times_and_lanes_are_those_of_robots(reader: Reader, records: list[ReplayStep]) -> None:
    view = at(reader, records[-1])
    failing = [request for request in view.requests.values() if request.action == FAILING]
    assert [(request.attempt, request.sent, request.ended, request.outcome) for request in failing][:2] == [
        (1, 8.0, 10.0, "aborted"),
        (2, 10.0, 12.0, "aborted"),
    ]
    assert {call.lane for call in view.calls.values()} == {"r1", "r2"}
    assert view.servers["/r1/move"].failed == 4
    assert not any(server.busy for server in view.servers.values())


def test_facts_say_since_when_they_are_so_and_how_they_are_known(reader: Reader, records: list[ReplayStep]) -> None:
    view = at(reader, records[-1])
    assert (view.facts["(at parcel1 hall)"].value, view.facts["(at parcel1 hall)"].since) == ("true", 14.0)
    assert not view.facts["(at parcel1 hall)"].is_initial
    assert view.facts["(connected hall kitchen)"].is_initial
    assert {fact.source for fact in view.facts.values()} == {"sensed", "assumed"}


def test_what_is_marked_on_the_way_through_the_records(reader: Reader, records: list[ReplayStep]) -> None:
    marks = {int(number): event.mark for number, event in at(reader, records[-1]).events.items() if event.mark}
    replans = [step.number for step in records if isinstance(step.record, RunMade)][1:]
    over = [step.number for step in records if isinstance(step.record, TaskOver)]
    failures = [step.number for step in failing_ends(records)]
    assert marks == {**dict.fromkeys(failures, "failure"), **dict.fromkeys(replans, "replan"), **dict.fromkeys(over, "end")}


def test_a_task_is_planned_again_after_a_failure_and_not_after_its_goal(reader: Reader, records: list[ReplayStep]) -> None:
    (over,) = [step for step in records if isinstance(step.record, TaskOver)]
    before_replans = [number for number, step in enumerate(records[1:]) if isinstance(step.record, RunMade)][1:]
    shown = [
        next(iter(at(reader, step).tasks.values()))
        for step in (*(records[number] for number in before_replans), records[over.number - 2], over)
    ]
    assert [task.state for task in shown] == ["running", "planning", "running", "over"], "with the rest of its plan, and with another one"
    assert [task.reason.partition(":")[0] for task in shown[:2]] == ["the rest of the plan still works", "a new plan is needed"]


def told(reader: Reader, step: ReplayStep, action: str) -> dict[str, Any]:
    """The detail of the first call of an action in the newest run."""
    view = at(reader, step)
    run = next(iter(view.tasks.values())).runs[-1]
    index = next(call.index for call in view.calls.values() if call.run == run and call.action == action)
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
    known = at(reader, first).facts["(carries r1 parcel2)"]
    carries = reads["(carries r1 parcel2)"]
    assert (carries["value"], carries["since"], carries["is_initial"]) == ("true", known.since, False)
    assert not [place for place in unload["places"] if place["tokens"] and place["name"] != "budget"]
    moving = told(reader, first, FAILING)
    assert {place["name"]: place["tokens"] for place in moving["places"] if place["tokens"]} == {"requested": 1, "spent": 1}
    assert "accepted" in {transition["name"] for transition in moving["transitions"] if transition["is_enabled"]}
    assert moving["resources"] == []


def test_there_is_no_detail_of_a_call_that_is_not_there(reader: Reader, records: list[ReplayStep]) -> None:
    run = next(iter(at(reader, records[-1]).runs))
    assert reader.at(records[-1].number, lambda story: detail(story, UUID(run), 99)) is None
    assert reader.at(records[-1].number, lambda story: detail(story, UUID(int=0), 0)) is None


@pytest.mark.parametrize("number", [0, 1, 2, 34, 40, 42, 51, 54, 65, 78])  # in most of them runs succeed others
def test_every_request_ends_as_the_journal_says_also_one_that_another_run_has_taken_over(number: int, tmp_path: Path) -> None:
    run_scenario(number, journal=tmp_path / "journal")
    view, ends, runs = Reader(tmp_path / "journal").newest(), dict[str, str](), dict[str, str]()
    for step in steps(tmp_path / "journal"):
        if isinstance(step.record, Happened) and isinstance(step.record.event, Ended):
            ends[step.record.event.request.hex], runs[step.record.event.request.hex] = (
                step.record.event.outcome.kind.value,
                step.record.run.hex,
            )
    for id, request in view.requests.items():
        assert request.outcome == ends.get(id, "")
        assert request.run == runs.get(id, request.run)
        assert view.calls[f"{request.run}/{request.call}"].action == request.action
