"""Reports about the world: those that cannot be so, or cannot be read, and silence."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

import pytest

from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN
from pnm.knowledge.state_reports import PERIOD, Complaints, StalenessWatchdog, StateReports
from tests.support.pddl.sensed_world import KNOWN, PROBLEM

HALL, KITCHEN = ("at", "r1", "hall"), ("at", "r1", "kitchen")
Scene = Callable[[KnowledgeBase, StateReports], Awaitable[None]]


def reporting(scene: Scene, problems=None, stale=None, known=KNOWN) -> None:
    """Have a scene take place where r1 is in the hall at first, in virtual time."""

    async def main():
        world = KnowledgeBase({HALL: True, ("dark",): True}, objects=PROBLEM.objects_by_type)
        reports = StateReports(world, problems or {}, 1.0, stale, known)
        await scene(world, reports)
        reports.close()
        await asyncio.sleep(50.0)

    run_async(main(), virtual=True)


WRONG = {
    "of an object that is not declared": ({("at", "R1", "kitchen"): True}, "there is no object 'R1' in the domain; "),
    "with too many arguments": ({("at", "r1"): True}, "(at r1) has 1 arguments; expected 2"),
    "of another type": ({("at", "kitchen", "r1"): True}, "kitchen is a place"),
    "of another kind": ({KITCHEN: 3.0}, "at is a predicate"),
    "of a name that is not among those of the report": ({("open", "door1"): True}, "does not name open"),
    "in capitals, so that nothing of the name is left": ({("AT", "r1", "kitchen"): True}, "does not name AT"),
}


@pytest.mark.parametrize(("facts", "said"), WRONG.values(), ids=WRONG)
def test_a_report_that_cannot_be_so_makes_unknown_what_it_is_about_and_is_told_once_with_a_count(caplog, facts, said):
    async def scene(world, reports):
        for _ in range(1000):
            reports.record({"at"}, facts)
        assert world.value(HALL) is UNKNOWN
        assert world.is_sensed(HALL), "there is a sensor: nothing about it is assumed"
        reports.record({"at"}, {KITCHEN: True})
        assert (world.value(KITCHEN), world.value(HALL)) == (True, False)

    reporting(scene)
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


def test_what_cannot_be_read_or_is_not_finite_is_unknown_and_not_assumed(caplog):
    async def scene(world, reports):
        reports.refuse({"at", "nonsense"}, "not a fact: 'at r1 hall'")
        reports.record({"battery"}, {("battery", "r1"): math.inf})
        assert world.value(HALL) is world.value(("battery", "r1")) is UNKNOWN
        assert (world.is_sensed(HALL), world.is_sensed(("nonsense",))) == (True, False)

    reporting(scene)
    assert "a report on the state topic is wrong: not a fact: 'at r1 hall'" in caplog.text


def test_senders_that_contradict_each_other_are_told_of_and_restarted_ones_are_not(caplog):
    async def scene(_, reports):
        for _ in range(10):
            for sequence, place in enumerate((HALL, KITCHEN, HALL), 1):
                reports.record({"at"}, {place: True}, sequence)
        for sequence in range(101, 110):
            reports.record({"at"}, {HALL: True}, sequence)
            reports.record({"at"}, {HALL: True}, sequence - 50)
        assert not caplog.records
        for sequence in range(201, 210):
            reports.record({"at"}, {HALL: True}, sequence)
            reports.record({"at"}, {KITCHEN: True}, sequence - 50)

    reporting(scene)
    first, _ = [record.getMessage() for record in caplog.records]
    said = "several senders contradict each other about at; expected names of its own from each"
    assert first == f"a report on the state topic is wrong: {said}"


# --- silence ---


def test_what_nobody_reports_for_too_long_falls_silent_once_and_again():
    fallen = []

    async def main():
        loop = asyncio.get_running_loop()
        watchdog = StalenessWatchdog(10.0, lambda: fallen.append(loop.time()))
        forever = StalenessWatchdog(None, lambda: fallen.append("never"))
        for _ in range(3):
            await asyncio.sleep(9.0)
            watchdog.reset()
            forever.reset()
        for _ in range(2):
            await asyncio.sleep(50.0)
            watchdog.reset()
        watchdog.close()
        await asyncio.sleep(50.0)
        forever.close()

    run_async(main(), virtual=True)
    assert fallen == [37.0, 87.0]


def test_what_is_no_longer_reported_is_unknown_until_it_is_reported_again(caplog):
    async def scene(world, reports):
        names = {"at", "battery", "location", "ready", "spam"}
        reports.record(names, {KITCHEN: True, ("battery", "r1"): 3.0, ("location", "r1"): "hall", ("ready", "r1"): True})
        assert world.facts() == {KITCHEN: True, ("battery", "r1"): 3.0, ("location", "r1"): "hall", ("dark",): True}
        await asyncio.sleep(4.0)
        reports.record({"battery"}, {("battery", "r1"): 2.0})
        await asyncio.sleep(3.0)
        places = [("at", robot, place) for robot in ("r1", "r-2", "a1") for place in ("kitchen", "hall")]
        assert {world.value(fluent) for fluent in [*places, ("location", "r1"), ("location", "a1")]} == {UNKNOWN}
        assert (world.value(("battery", "r1")), world.value(("dark",))) == (2.0, True)
        await asyncio.sleep(5.0)
        assert world.value(("battery", "r1")) is UNKNOWN
        reports.record(names, {HALL: True})
        assert [place for place in places if world.value(place) is not False] == [HALL]
        assert world.value(("location", "r1")) == UNDEFINED
        worlds.append(world)

    worlds: list[KnowledgeBase] = []
    reporting(scene, {"ready": "its facts follow from rules", "spam": ""}, stale=5.0)
    assert worlds[0].value(HALL) is True, "nothing falls silent once the reports are closed"
    assert caplog.text.count("reports about ready are ignored: its facts follow from rules") == 1
    assert "spam" not in caplog.text
    assert "nothing was reported about battery for 5 s; it is unknown now" in caplog.text


def test_of_names_that_nobody_knows_more_about_what_was_recorded_is_unknown():
    async def scene(world, reports):
        reports.record({"at"}, {KITCHEN: True})
        await asyncio.sleep(6.0)
        assert (world.value(KITCHEN), world.value(("at", "a1", "hall"))) == (UNKNOWN, None)
        reports.record({"at"}, {})
        assert world.value(KITCHEN) is False

    reporting(scene, stale=5.0, known=None)
