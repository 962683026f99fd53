"""Following a journal: one that is not there yet, grows, ends, is damaged; and browsers that are slow, or were away."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from planner_bridge.tasks.result import TASKS
from planner_bridge.view import follow
from planner_bridge.view.app import frame
from planner_bridge.view.follow import Feed, Reader
from planner_bridge.view.story import View, view_of
from pnm.errors import PnmError
from pnm.journal.kept import JournalError
from pnm.journal.records import RunRetired
from tests.support.e2e.page.journals import GrowingJournal, steps
from tests.support.e2e.page.serving import Stream, page_of
from tests.support.runs.simulated import on_a_loop


def test_a_journal_that_is_not_there_yet_is_waited_for(growing: GrowingJournal, tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no database")
    assert "cannot be opened" in Reader(tmp_path / "text").newest().problem
    reader = Reader(tmp_path / "later.journal")
    assert "there is no such file" in reader.newest().problem
    growing.grow(growing.longest)
    (tmp_path / "later.journal").symlink_to(growing.place)
    assert (reader.newest().number, reader.newest().problem) == (growing.longest, "")


def test_a_journal_that_grows_is_followed_and_nothing_new_is_the_same_view(growing: GrowingJournal) -> None:
    reader = Reader(growing.place)
    for length in (4, 5, 40, growing.longest):
        assert reader.at(length, view_of) is None, "it is not there yet"
        growing.grow(length)
        view = reader.newest()
        assert view.number == length
        assert reader.newest() is view


def test_a_record_that_is_damaged_is_named_and_what_was_before_it_is_shown(growing: GrowingJournal) -> None:
    growing.grow(30)
    growing.add("{damaged")
    reader = Reader(growing.place)
    view = reader.newest()
    assert (view.number, view.problem.startswith("after record 30: ")) == (30, True)
    assert reader.newest() is view, "it is not read again and again"
    assert reader.at(30, view_of) is not None
    with pytest.raises(PnmError):
        reader.at(31, view_of)


def test_a_record_that_cannot_be_replayed_is_named_and_leaves_nothing_of_itself(delivery: Path, growing: GrowingJournal) -> None:
    growing.grow(30)
    before = Reader(growing.place).newest()
    unknown = next(step.record.run for step in steps(delivery) if isinstance(step.record, RunRetired))
    growing.add(TASKS.text(RunRetired(unknown)).replace(unknown.hex[:8], "0" * 8))
    reader = Reader(growing.place)
    view = reader.newest()
    assert (view.number, view.tasks, view.calls) == (30, before.tasks, before.calls)
    assert "damaged behind record 30" in view.problem
    assert reader.newest() is view, "it is not replayed again and again"
    with pytest.raises(JournalError, match="damaged behind record 30"):
        reader.at(31, view_of)


def test_a_journal_of_which_records_were_taken_away_is_read_anew(growing: GrowingJournal) -> None:
    growing.grow(30)
    reader = Reader(growing.place)
    assert reader.newest().number == 30
    with closing(sqlite3.connect(growing.place)) as connection, connection:  # as a server does that was cut off in a commit
        connection.execute("DELETE FROM records WHERE sequence > 20")
    assert reader.newest().number == 20


@on_a_loop
async def test_a_slow_browser_gets_what_is_so_now_and_no_backlog(growing: GrowingJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "PERIOD", 0.0)
    monkeypatch.setattr(follow, "_IDLE", 0.0)
    growing.grow(2)
    feed = Feed(Reader(growing.place))
    quick, slow = feed.views(), feed.views()
    seen_quick, seen_slow = [await anext(quick)], [await anext(slow)]
    for length in range(3, 40):
        growing.grow(length)
        seen_quick.append(await anext(quick))
    seen_slow.append(await anext(slow))
    await feed.close()
    assert [view async for view in slow] == []
    assert [view.number for view in seen_quick] == list(range(2, 40))
    assert [view.number for view in seen_slow] == [2, 39]
    assert frame(*seen_slow)["parts"] == frame(seen_quick[0], seen_quick[-1])["parts"]


@on_a_loop
async def test_nobody_reads_while_nobody_watches(growing: GrowingJournal) -> None:
    reads = []

    class Counting(Reader):
        def newest(self) -> View:
            reads.append(None)
            return super().newest()

    growing.grow(5)
    feed = Feed(Counting(growing.place))
    views = feed.views()
    assert not reads
    await anext(views)
    await views.aclose()  # type: ignore[attr-defined]
    before = len(reads)
    growing.grow(6)
    for _ in range(100):
        await asyncio.sleep(0)
    assert len(reads) == before


def test_a_browser_that_was_away_gets_what_has_changed_since_and_what_changes_then(growing: GrowingJournal) -> None:
    growing.grow(40)
    with page_of(growing.place) as url:
        stream = Stream(url)
        number, whole = stream.next()
        assert (number, whole["is_whole"], whole["number"]) == ("40", True, 40)
        stream.close()
        growing.grow(60)
        back = Stream(url, f"/events?of={whole['journal']}&after=1", {"Last-Event-ID": number})
        number, change = back.next()
        assert (number, change["is_whole"]) == ("60", False)
        growing.grow(70)
        assert back.next()[0] == "70"
        back.close()
        reader = Reader(growing.place)
        before, after = reader.at(40, view_of), reader.at(60, view_of)
        assert after is not None
        assert change["parts"].keys() == frame(before, after)["parts"].keys()
        assert set(change["parts"]["requests"]) == set(frame(before, after)["parts"]["requests"])


def test_a_browser_that_has_seen_something_else_gets_the_whole_state(growing: GrowingJournal) -> None:
    growing.grow(40)
    with page_of(growing.place) as url:
        stream = Stream(url)
        key = stream.next()[1]["journal"]
        stream.close()
        for of, last in (("another", "20"), ("", "20"), (key, "4711"), (key, "x")):
            other = Stream(url, f"/events?of={of}", {"Last-Event-ID": last})
            assert other.next()[1]["is_whole"], (of, last)
            other.close()


@on_a_loop
async def test_a_second_browser_takes_nothing_away_from_the_first(growing: GrowingJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "PERIOD", 1000.0)
    monkeypatch.setattr(follow, "_IDLE", 1000.0)
    growing.grow(2)
    feed = Feed(Reader(growing.place))
    first, second = feed.views(), feed.views()
    seen = [(await anext(first)).number]
    waiting = asyncio.ensure_future(anext(first))
    await asyncio.sleep(0)
    growing.grow(7)
    seen += [(await anext(second)).number, (await waiting).number]
    await feed.close()
    assert seen == [2, 7, 7]


@on_a_loop
async def test_a_fault_of_ours_ends_with_a_message_on_the_page_and_in_the_log(
    growing: GrowingJournal, caplog: pytest.LogCaptureFixture
) -> None:
    is_faulty = False

    class Faulty(Reader):
        def newest(self) -> View:
            if is_faulty:
                raise ZeroDivisionError("nobody has thought of that")
            return super().newest()

    growing.grow(5)
    feed = Feed(Faulty(growing.place))
    views = feed.views()
    before = await anext(views)
    is_faulty = True
    after = await anext(views)
    await feed.close()
    assert (after.number, after.tasks) == (before.number, before.tasks)
    assert after.problem == "the journal cannot be followed any more: ZeroDivisionError: nobody has thought of that"
    assert [record.message for record in caplog.records] == ["the journal cannot be followed any more"]
    assert caplog.records[0].exc_info is not None
