"""Why a run goes as it goes: what its journal says of calls that wait, have begun or failed, and of new plans."""

from __future__ import annotations

from pathlib import Path
from uuid import uuid4

import pytest

from planner_bridge.explanations.answer import Known
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.run_questions import call_meant, explained, task_meant, why_call_of_run, why_replanned, why_so
from planner_bridge.tasks.result import TASKS
from pnm.core.machine.plan_graph import Moment
from pnm.core.machine.requests import CallOutcome
from pnm.errors import InputError
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps

FAILING = "move(r1, hall, kitchen)"


def length(journal: Path) -> int:
    return sum(1 for _ in replay_steps(journal, TASKS, Replay()))


def test_a_new_plan_is_explained_by_what_failed_and_by_what_it_keeps_drops_and_adds(delivery: Path) -> None:
    history = JournalHistory.read(delivery)
    again, anew = why_replanned(history, task_meant(history, None))
    assert "the rest of the plan still works: going on with 2 calls in a new machine" in again.statement
    assert f"a new plan is needed: {FAILING} has failed 2 times; not again: {FAILING}" in anew.statement
    failed, kept, dropped, added = anew.reasons
    assert "aborted: expected success; observed the way is blocked" in failed.statement
    assert failed.reasons[0].statement.startswith("it was sent 2 times, at ")
    assert kept.statement == "the plan that followed keeps unload(r1, parcel2, kitchen)"
    assert dropped.statement == f"the plan that followed drops {FAILING}"
    assert "pass_door(r1, door1, corridor, kitchen)" in added.statement
    assert {part.known for part in anew.every()} == {Known.JOURNAL}


def test_what_a_call_waits_for_is_what_has_not_come_after_every_record(delivery: Path) -> None:
    """Whatever is said to have to come first has not come, and all that has not come is said."""
    waited = 0
    for last in range(1, length(delivery), 8):
        history = JournalHistory.read(delivery, last)
        for task in history.tasks.values():
            for run in task.runs[-1:] if task.ending is None and task.runs and not task.runs[-1].is_over else ():
                for call in run.source.plan.calls:
                    if run.last_results[call.index].kind is CallOutcome.WAITING:
                        _, now, *_ = why_call_of_run(history, task, run, call.index)
                        said = {reason.statement.split()[0] for reason in now.reasons if " has to " in reason.statement}
                        missing = {
                            f"#{ordering.before.call}"
                            for ordering in run.source.plan.orderings
                            if ordering.after.call == call.index != ordering.before.call
                            and ordering.after.moment is Moment.START
                            and run.time_of(ordering.before) is None
                        }
                        assert said == missing
                        waited += bool(missing)
    assert waited > 10


def test_a_call_that_has_begun_names_what_ended_last_before_it(delivery: Path) -> None:
    history = JournalHistory.read(delivery, 40)
    task = task_meant(history, "1")
    needed, now = why_call_of_run(history, task, *call_meant(task, "move(r1,hall,kitchen)"))
    assert needed.known is Known.SIMULATION
    assert needed.reasons[0].statement == "#6 unload(r1, parcel2, kitchen) needs it: (at r1 kitchen)"
    assert "the last that it waited for was: #2 move(r1, store, hall) ended at 8.00 s, which brings about (at r1 hall)" in now.statement


def test_what_goes_on_is_told_call_by_call_and_what_is_over_with_how_it_ended(delivery: Path) -> None:
    history = JournalHistory.read(delivery, 40)
    doing, *failures = why_so(history, task_meant(history, None))
    assert doing.statement == "the goal of the problem: 4 of 8 calls of its plan are done"
    assert [reason.statement for reason in doing.reasons][:2] == [f"#4 {FAILING}: running", "#5 move(r2, store, hall): running"]
    assert not failures
    history = JournalHistory.read(delivery)
    ended, *others = why_so(history, task_meant(history, None))
    assert ended.statement == "the goal of the problem is over: goal_reached: the goal holds"
    assert len(others) == 2


@pytest.mark.parametrize(
    ("task", "call", "message"),
    [
        ("7", "1", "no task is called '7'; expected one of 1 ("),
        ("zzz", "1", "no task is called 'zzz'"),
        (None, "99", "there is no call 99: the last run has 5 calls"),
        (None, "8", "there is no call 8"),
        (None, "move(r1,hall,kitchn)", "did you mean 'move(r1, hall, kitchen)'?"),
        (None, "fly(x)", "has fly(x); expected one of move(r2, hall, kitchen)"),
    ],
)
def test_names_that_are_not_there_are_refused_with_near_ones(delivery: Path, task: str | None, call: str, message: str) -> None:
    history = JournalHistory.read(delivery)
    with pytest.raises(InputError) as error:
        call_meant(task_meant(history, task), call)
    assert message in str(error.value)


def test_before_there_is_a_task_or_a_plan_that_is_said(delivery: Path) -> None:
    with pytest.raises(InputError, match="the journal has no task"):
        task_meant(JournalHistory.read(delivery, 1), None)
    history = next(h for h in (JournalHistory.read(delivery, last) for last in range(1, 20)) if h.tasks)
    task = task_meant(history, None)
    assert why_so(history, task)[0].statement == "the goal of the problem has no plan yet"
    with pytest.raises(InputError, match="has no plan yet"):
        call_meant(task, "1")


def test_who_knows_the_ids_gets_the_same_answers(delivery: Path) -> None:
    history = JournalHistory.read(delivery, 40)
    (task,) = history.tasks.values()
    run = task.runs[-1].id
    assert explained(delivery, run, 4, 40) == why_call_of_run(history, task, *call_meant(task, "4"))
    for wrong in ((run, 99), (uuid4(), 0)):
        with pytest.raises(InputError, match="has no call"):
            explained(delivery, *wrong, 40)
