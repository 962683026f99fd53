"""Resuming: whose turn it is to write, files that a process has left behind at its very beginning, and limits of requests."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.core.execution.events import Restarted, Tick
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.requests import Accepted
from pnm.core.resources import Resources
from pnm.journal.codec import Codec
from pnm.journal.kept import Fenced, JournalChoice, Row
from pnm.journal.records import KnowledgeDelta, SharedBegan
from pnm.journal.replay import Replay
from pnm.journal.resume import take_up
from pnm.journal.store import JournalFile
from tests.support.runs.commands import begun, cancelled
from tests.support.runs.plan_graphs import plan


def left(path: Path, codec: Codec = TASKS) -> Replay | None:
    """Return the replay of what a process takes up, and dies with at once."""
    taken = take_up(JournalChoice(path), codec, "here")
    taken.hold.release()
    taken.file.close()
    return taken.replay


@pytest.mark.parametrize("made", ["nothing", "the file", "its mode"])
def test_a_process_that_died_while_it_made_the_journal_leaves_an_empty_one(tmp_path: Path, made: str) -> None:
    file = tmp_path / "journal"
    if made == "the file":
        file.touch()
    elif made == "its mode":
        with closing(sqlite3.connect(file)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
    assert left(file) is None
    assert left(file) is None, "and another one may die before its first record"


def test_what_another_process_adds_until_its_journal_is_taken_is_replayed_and_nothing_can_be_added_then(tmp_path: Path) -> None:
    async def begin() -> None:
        journal = take_up(JournalChoice(tmp_path / "journal"), TASKS, "here").write()
        journal.begin(KnowledgeBase({("at", "hall"): True}), Resources(), began=SharedBegan({}, origin="here"))
        journal.close()

    asyncio.run(begin())
    other = JournalFile(tmp_path / "journal", 0.0)
    added = []

    class Interrupted(Codec):
        """Has the other process write between the first record that is read and the second."""

        def value(self, text: str) -> Any:
            if not added:
                added.append(text)
                other.append([Row(0.0, TASKS.text(KnowledgeDelta(0, {("at", "kitchen"): True}, {})))], {})
            return TASKS.value(text)

    replay = left(tmp_path / "journal", Interrupted(()))
    with pytest.raises(Fenced):
        other.append([Row(0.0, TASKS.text(None))], {})
    assert replay is not None
    assert replay.world.facts() == {("at", "hall"): True, ("at", "kitchen"): True}


def test_the_limit_for_the_acceptance_of_a_request_begins_anew_in_another_process() -> None:
    run, _ = begun(plan(1), Bindings({"a0": Binding(accept=15.0)}))
    (request,) = run.open_requests
    for now in (10.0, 20.0, 30.0):  # each process dies before it has found the server
        assert not cancelled(run.handle(Restarted(), now))
        assert not cancelled(run.handle(Tick(), now + 5.0))
    assert cancelled(run.handle(Tick(), 45.0)) == [request]


def test_the_limit_of_a_request_that_was_accepted_does_not() -> None:
    run, _ = begun(plan(1), Bindings({"a0": Binding(timeout=20.0)}))
    (request,) = run.open_requests
    run.handle(Accepted(request), 1.0)
    assert not cancelled(run.handle(Restarted(), 15.0))
    assert cancelled(run.handle(Tick(), 21.0)) == [request]
