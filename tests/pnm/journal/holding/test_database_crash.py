"""A PostgreSQL that crashes, whose commits are not durable: what was acknowledged is there all the same, each record once."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from random import Random
from typing import Any

import pytest

from pnm.files.database.database import Database
from pnm.files.database.place import Place, place_of
from pnm.journal.kept import Damaged, Durability, Fenced, JournalError, Row
from pnm.journal.store import JournalFile, KeptJournal
from pnm.journal.tables import LAYOUT
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import until

CRASHES = 6
"""Of each kind; `python -m tests.pnm.journal.holding --crashes 100` has more."""


def kill(server: PostgresServer) -> None:
    server.kill_a_backend()
    server.wait_ready()


def stop(server: PostgresServer) -> None:
    server.stop_at_once()
    server.start_again()


class Holder:
    """A process that keeps records in random portions. The mutable state is what was acknowledged, and what was not."""

    def __init__(self, place: Place, seed: int) -> None:
        self.random = Random(seed)
        self.file = JournalFile(place, Durability.PROCESS_CRASH, 0.0, 1000.0)
        self.kept: list[str] = []
        self.waiting: list[str] = []

    def work(self, commits: int) -> None:
        """Keep records, and renew the lease at times."""
        for _ in range(commits):
            number = len(self.kept) + len(self.waiting)
            self.waiting += [str(number + one) for one in range(self.random.randint(1, 4))]
            self.file.append([Row(0.0, text) for text in self.waiting], {f"part {number}": "whole"})
            self.kept, self.waiting = self.kept + self.waiting, []
            if self.random.random() < 0.1:
                self.file.renew()

    def reconnect(self) -> None:
        """Renew the lease until that succeeds."""

        def renewed() -> bool:
            with suppress(JournalError):
                self.file.renew()
                return True
            return False

        until(renewed)


def survive(place: Place, server: PostgresServer, crash: Callable[[PostgresServer], None], seed: int, crashes: int) -> int:
    """Crash a server several times, and check what is left each time; return how many records had to be written again."""
    holder, kept, lost = Holder(place, seed), KeptJournal(place), 0
    for number in range(crashes):
        holder.work(holder.random.randint(1, 30))
        crash(server)
        with suppress(JournalError):
            kept.last()  # over the connection of before
        lost += len(holder.kept) - kept.last()
        with suppress(JournalError):  # nobody knows whether that was committed
            holder.work(1)
        holder.reconnect()
        assert [(sequence, row.text) for sequence, row in kept.rows()] == [*enumerate(holder.kept, 1)], f"crash {number} of seed {seed}"
        assert kept.part("part 0") == "whole"
    holder.file.close()
    kept.close()
    return lost


@pytest.mark.parametrize("crash", [kill, stop])
def test_what_was_acknowledged_outlives_crashes_of_the_server(crash: Callable[[PostgresServer], None], postgres: PostgresServer) -> None:
    assert survive(place_of(postgres.database()), postgres, crash, seed=1, crashes=CRASHES) > 0, "it has lost what was not durable"


def test_the_lease_outlives_a_crash_that_comes_right_after_it(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    file = JournalFile(place, Durability.PROCESS_CRASH, 0.0, 1000.0)
    stop(postgres)
    kept = KeptJournal(place)
    assert kept.holding().epoch == file.epoch
    assert kept.holding().left > 900.0
    kept.close()
    file.close()


def execute(place: Place, sql: str) -> None:
    database = Database(place, LAYOUT)
    driver: Any = database._driver
    driver.run(sql, {})
    database.close()


def test_a_holder_whose_records_were_lost_for_good_ends_by_name_and_writes_nothing(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    holder = Holder(place, seed=2)
    holder.work(3)
    holder.reconnect()  # from here on they are durable, and not remembered
    holder.work(1)
    execute(place, "DELETE FROM records WHERE sequence > 2")  # as in a copy that was behind
    for attempt in (lambda: holder.work(1), holder.file.renew):
        with pytest.raises(Fenced, match=r"has lost the records 3 to \d+: .* Nothing is sent any more"):
            attempt()
    kept = KeptJournal(place)
    assert [row.text for _, row in kept.rows()] == holder.kept[:2]
    kept.close()
    holder.file.close()


def test_a_journal_in_which_records_are_missing_says_so(place: Place) -> None:
    file = JournalFile(place, Durability.PROCESS_CRASH, 0.0)
    file.append([Row(0.0, str(number)) for number in range(9)], {})
    file.close()
    execute(place, "DELETE FROM records WHERE sequence IN (1, 4, 5)")
    kept = KeptJournal(place)
    rows = kept.rows()
    assert [number for number, _ in islice(rows, 2)] == [2, 3], "those at the beginning were dropped"
    with pytest.raises(Damaged, match=r"is damaged: the records 4 to 5 are missing; its database has lost them"):
        next(rows)
    kept.close()
