"""Reports about the world that cannot be so, or cannot be read."""

from __future__ import annotations

import asyncio
import math

import pytest

from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNKNOWN
from pnm.knowledge.state_reports import PERIOD, Complaints, StateReports
from tests.support.pddl.sensed_world import KNOWN, PROBLEM

WRONG = {
    "of an object that is not declared": ({("at", "R1", "kitchen"): True}, "there is no object 'R1' in the domain; "),
    "with too many arguments": ({("at", "r1"): True}, "(at r1) has 1 arguments; expected 2"),
    "of another type": ({("at", "kitchen", "r1"): True}, "kitchen is a place"),
    "of another kind": ({("at", "r1", "kitchen"): 3.0}, "at is a predicate"),
    "of a name that is not among those of the report": ({("open", "door1"): True}, "does not name open"),
    "in capitals, so that nothing of the name is left": ({("AT", "r1", "kitchen"): True}, "does not name AT"),
}


@pytest.mark.parametrize(("facts", "said"), WRONG.values(), ids=WRONG)
def test_a_report_that_cannot_be_so_makes_unknown_what_it_is_about_and_is_told_once_with_a_count(caplog, facts, said):
    async def main():
        world = KnowledgeBase({("at", "r1", "hall"): True}, objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {}, 1.0, None, KNOWN)
        for _ in range(1000):
            reports.record({"at"}, facts)
        assert world.value(("at", "r1", "hall")) is UNKNOWN
        assert world.is_sensed(("at", "r1", "hall")), "there is a sensor: nothing about it is assumed"
        reports.record({"at"}, {("at", "r1", "kitchen"): True})
        assert (world.value(("at", "r1", "kitchen")), world.value(("at", "r1", "hall"))) == (True, False)
        reports.close()

    run_async(main(), virtual=True)
    first, last = [record.getMessage() for record in caplog.records]
    assert said in first
    assert last.startswith("999 more reports on the state topic were wrong")


def test_wrong_reports_are_logged_once_in_every_period_as_long_as_there_are_any(caplog):
    async def main():
        complaints = Complaints("a topic")
        for _ in range(3):
            complaints.note("it is wrong")
        await asyncio.sleep(PERIOD + 1.0)
        complaints.note("it still is")
        await asyncio.sleep(3.0 * PERIOD)
        complaints.note("it is again")
        complaints.close()

    run_async(main(), virtual=True)
    assert [record.getMessage() for record in caplog.records] == [
        "a report on a topic is wrong: it is wrong",
        "2 more reports on a topic were wrong; the last one: it is wrong",
        "1 more reports on a topic were wrong; the last one: it still is",
        "a report on a topic is wrong: it is again",
    ]


def test_reports_that_cannot_be_read_do_not_make_their_names_assumed(caplog):
    async def main():
        world = KnowledgeBase({("at", "r1", "hall"): True}, objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {}, 1.0, None, KNOWN)
        reports.refuse({"at", "nonsense"}, "not a fact: 'at r1 hall'")
        assert world.value(("at", "r1", "hall")) is UNKNOWN
        assert (world.is_sensed(("at", "r1", "hall")), world.is_sensed(("nonsense",))) == (True, False)
        reports.close()

    run_async(main(), virtual=True)
    assert "a report on the state topic is wrong: not a fact: 'at r1 hall'" in caplog.text


def test_a_number_that_is_not_finite_is_not_recorded():
    async def main():
        world = KnowledgeBase(objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {}, 1.0, None, KNOWN)
        reports.record({"battery"}, {("battery", "r1"): math.inf})
        assert world.value(("battery", "r1")) is UNKNOWN
        reports.close()

    run_async(main(), virtual=True)


def test_senders_that_contradict_each_other_are_told_of_and_restarted_ones_are_not(caplog):
    async def main():
        world = KnowledgeBase({("at", "r1", "hall"): True}, objects=PROBLEM.objects_by_type)
        reports = StateReports(world, {}, 1.0, None, KNOWN)
        for _ in range(10):
            for sequence, place in enumerate(("hall", "kitchen", "hall"), 1):
                reports.record({"at"}, {("at", "r1", place): True}, sequence)
        for sequence in range(101, 110):
            reports.record({"at"}, {("at", "r1", "hall"): True}, sequence)
            reports.record({"at"}, {("at", "r1", "hall"): True}, sequence - 50)
        assert not caplog.records
        for sequence in range(201, 210):
            reports.record({"at"}, {("at", "r1", "hall"): True}, sequence)
            reports.record({"at"}, {("at", "r1", "kitchen"): True}, sequence - 50)
        reports.close()

    run_async(main(), virtual=True)
    first, _ = [record.getMessage() for record in caplog.records]
    assert (
        first == "a report on the state topic is wrong: several senders contradict each other about at; expected names of its own from each"
    )
