"""Journals that this version cannot go on with: what is said, and that no node is stuck for ever because of it."""

from __future__ import annotations

import json
import logging
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from pnm.clock import run_async
from pnm.errors import InputError
from pnm.journal.kept import JournalChoice
from pnm.journal.resume import summaries, take_up
from pnm.tasks import Wanted
from tests.support.e2e.command_line import pnm
from tests.support.pddl.problems import fleet
from tests.support.processes import Program
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.forged_journal import forged

GOAL = Wanted(UUID(int=1), "(in p0 a2)")


def changed(text: str, change: Callable[[dict[str, object]], None]) -> str:
    record = json.loads(text)
    change(record)
    return json.dumps(record)


def other_firings(record: dict[str, object]) -> None:
    """Have a run fire what it would not fire in this version."""
    if record["@"] == "Happened" and record.get("fired"):
        record["fired"] = [0]


def other_class(record: dict[str, object]) -> None:
    """Have a value of a class that this version does not know."""
    if record["@"] == "RunMade":
        record["@"] = "RunForged"


def journal_of_another_version(path: Path, deaths: list[int], change: Callable[[dict[str, object]], None]) -> None:
    """Write a journal as a version would have that does something else; its process dies unless there are no deaths."""
    survive(fleet(), [GOAL], Settings(improve=0.0), path, deaths)
    with forged(path) as connection:
        if deaths:  # as if no other process had gone on
            (last,) = connection.execute("SELECT min(sequence) FROM records WHERE text LIKE '%\"Restarted\"%'").fetchone()
            connection.execute("DELETE FROM records WHERE sequence >= ?", (last,))
            (text,) = connection.execute("SELECT text FROM tasks").fetchone()
            record = json.loads(text)
            record.pop("ending")
            connection.execute("UPDATE tasks SET is_over = 0, text = ?", (json.dumps(record),))
        for number, text in connection.execute("SELECT sequence, text FROM records").fetchall():
            connection.execute("UPDATE records SET text = ? WHERE sequence = ?", (changed(text, change), number))


def content(path: Path) -> list[str]:
    """All that a journal says; its file changes besides whenever the log beside it is written back."""
    with closing(sqlite3.connect(path)) as connection:
        return [*connection.iterdump()]


@pytest.mark.parametrize("change", [other_firings, other_class])
def test_unfinished_tasks_of_another_version_are_named_with_what_to_do(tmp_path: Path, change: Callable[[dict[str, object]], None]) -> None:
    path = tmp_path / "tasks.journal"
    journal_of_another_version(path, [14], change)
    before = content(path)
    with pytest.raises(InputError) as error:
        take_up(JournalChoice(path), TASKS, "")
    said = str(error.value)
    assert "tasks that are not finished cannot go on in this version: (in p0 a2)" in said
    assert "Go on with the version that has begun them" in said
    assert f"`pnm journal move {path} FILE` moves this one (`pnm history {path}` lists its tasks)" in said
    assert content(path) == before
    history = pnm("history", str(path))
    assert history.returncode == 0, history.stderr
    assert "(in p0 a2)" in history.stdout
    assert "not over" in history.stdout


def test_with_nothing_unfinished_a_node_begins_anew_and_the_past_is_still_listed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "tasks.journal"
    journal_of_another_version(path, [], other_firings)
    with caplog.at_level(logging.WARNING):
        taken = take_up(JournalChoice(path), TASKS, "")
    assert taken.replay is None
    assert "begins anew with the world as its files have it" in caplog.text

    async def begin() -> None:
        taken.write().close()

    run_async(begin(), virtual=True)
    assert [summary.accepted.wanted for summary in summaries(path, TASKS)] == [GOAL]
    replay = pnm("replay", str(path))
    assert replay.returncode == 1
    assert "the journal says" in replay.stderr


FULL = ["sh", "-c", 'ulimit -f 1; exec "$@"', "sh"]
"""What a command begins with for which every disk is full."""


def test_a_journal_that_cannot_be_made_is_an_error_before_anything_is_done(root: Path, tmp_path: Path) -> None:
    run = ["run", str(root / "domains/delivery/domain.pddl"), str(root / "problems/delivery/p01.pddl"), "--journal"]
    for place in (tmp_path / "nowhere" / "j", tmp_path, Path("/dev/full")):
        refused = pnm(*run, str(place))
        assert (refused.returncode, refused.stdout) == (2, ""), place
        assert str(place) in refused.stderr
    full = Program(["-m", "planner_bridge", *run, str(tmp_path / "j")], {}, FULL)
    assert (full.ended(), full.out) == (2, []), str(full)
    assert str(tmp_path / "j") in full.err[-1]
